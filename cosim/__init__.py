"""Co-simulation: plants, sensors, faults, sources, diagrams and the engines that run them.

Everything public is importable from here and loaded on first use.
"""

import lazy_loader

# The public names stand in __init__.pyi. The full name keeps a bare `import cosim` at the root on the same classes.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub("bayesftc.cosim", __file__)
