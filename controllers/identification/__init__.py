"""Linear models from recordings."""
