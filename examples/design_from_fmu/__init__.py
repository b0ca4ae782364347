"""Four plants, each nothing but an FMU, and a fault-tolerant controller for each in one call."""
