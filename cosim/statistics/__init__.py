"""Statistics of campaigns: of tables with a row for each run, and of signals of many runs.

All public names can be imported from here. Each is loaded on first use.
"""

import lazy_loader

# __init__.pyi lists the public names.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub("bayesftc.cosim.statistics", __file__)
