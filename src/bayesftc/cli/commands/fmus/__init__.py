"""Commands for FMUs."""
