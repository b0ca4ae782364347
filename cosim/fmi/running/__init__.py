"""Running FMUs for co-simulation: instances, steps, states."""
