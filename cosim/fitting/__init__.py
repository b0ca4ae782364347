"""Parameters of FMUs from recordings."""
