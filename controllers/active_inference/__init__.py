"""The unbiased active inference controller."""
