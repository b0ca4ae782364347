"""Live: bridges between a running controller and real sensors and actuators, paced by the clock.

All public names can be imported from here. Each is loaded on first use. The packages that some bridges need come with
``pip install 'bayesftc[live]'``.
"""

import lazy_loader

# The public names stand in __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub("bayesftc.cosim.live", __file__)
