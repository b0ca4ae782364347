"""Measure speed, start-up, memory and compilation of this package, compared with alternatives without it.

``bayesftc bench`` prints a table, ``bayesftc bench --json`` one JSON object. All candidates of a comparison run in turns on
the same machine, because only ratios are valid on another machine.
"""

from bayesftc.bench._run import SECTIONS, main, measure

__all__ = ["SECTIONS", "main", "measure"]
