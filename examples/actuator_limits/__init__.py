"""Actuators with limits: controllers that wind up at them, and controllers that do not."""
