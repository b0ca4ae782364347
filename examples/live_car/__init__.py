"""A car in another process, whose sensors and engine are reached by UDP."""
