"""The blocks that come with this package: sources, sensors, mathematics, linear systems."""
