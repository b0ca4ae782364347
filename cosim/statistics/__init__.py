"""Statistics of campaigns: of tables with a row for each run, and of signals of many runs.

All public names can be imported from here. Each is loaded on first use.
"""

from bayesftc._public import public_names

# __init__.pyi lists the public names.
__getattr__, __dir__, __all__ = public_names("bayesftc.cosim.statistics", __file__)
