"""Fit a monitor's model to a recording."""
