"""FMUs in separate processes (crash isolation)."""
