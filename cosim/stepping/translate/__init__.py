"""From step functions in Python to functions in C."""
