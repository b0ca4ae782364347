"""The blocks of this package: sources, sensors, mathematics, linear systems."""
