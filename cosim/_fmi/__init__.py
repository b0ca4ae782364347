"""FMUs for co-simulation: files, descriptions, binaries, values, and the steps of running instances."""
