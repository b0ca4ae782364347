"""Translation of step functions from Python to C."""
