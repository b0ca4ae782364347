"""Bayesian controllers as co-simulation blocks."""
