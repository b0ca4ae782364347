"""Nonlinear models whose equations are those of an FMU."""
