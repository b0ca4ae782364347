"""Four plants, each given only by an FMU, and a fault-tolerant controller for each in one call."""
