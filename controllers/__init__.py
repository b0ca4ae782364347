"""Bayesian controllers, precision learners and baselines, as co-simulation blocks.

Everything public is importable from here and loaded on first use.
"""

from bayesftc._public import public_names

# The public names stand in __init__.pyi. The full name keeps a bare `import controllers` at the root on the same classes.
__getattr__, __dir__, __all__ = public_names("bayesftc.controllers", __file__)
