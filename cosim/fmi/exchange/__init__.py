"""FMUs for model exchange: their equations and events."""
