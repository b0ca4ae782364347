"""Switching between fault modes: what is learned of sensors, actuators and process."""
