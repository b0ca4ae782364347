"""Linear algebra and special functions in step functions."""
