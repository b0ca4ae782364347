"""Statistics of campaigns: of tables with a row for each run, and of signals of many runs.

Everything public is importable from here and loaded on first use.
"""

import lazy_loader

# The public names stand in __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub("bayesftc.cosim.statistics", __file__)
