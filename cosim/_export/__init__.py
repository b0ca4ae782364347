"""From step functions to C, and from there to FMUs and firmware."""
