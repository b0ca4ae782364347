"""Co-simulation: plants, sensors, faults, sources, diagrams and the engines that run them.

All public names can be imported from here. Each is loaded on first use.
"""

from bayesftc._public import public_names

# __init__.pyi lists the public names. With the full name, a bare `import cosim` at the root gets the same classes.
__getattr__, __dir__, __all__ = public_names("bayesftc.cosim", __file__)
