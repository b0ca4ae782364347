"""Switching between fault modes of sensors, actuators and process."""
