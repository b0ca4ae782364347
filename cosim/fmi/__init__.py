"""FMUs as blocks."""
