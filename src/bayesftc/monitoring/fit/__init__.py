"""A monitor's model from a recording."""
