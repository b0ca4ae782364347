"""The commands of ``bayesftc``: a module for each, of its name."""
