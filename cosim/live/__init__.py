"""Live: bridges between a running controller and real sensors and actuators, paced by the clock.

All public names can be imported from here. Each is loaded on first use. The packages that some bridges need come with
``pip install 'bayesftc[live]'``.
"""

from bayesftc._public import public_names

# The public names stand in __init__.pyi.
__getattr__, __dir__, __all__ = public_names("bayesftc.cosim.live", __file__)
