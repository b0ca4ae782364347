"""A nonlinear controller for plants of which nothing but the FMU is known."""
