"""Faults of sensors and actuators, as blocks."""
