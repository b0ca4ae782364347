"""What this package costs: speed, start-up, memory and compilation, beside what one would do without it.

``bayesftc bench`` prints a table, ``bayesftc bench --json`` one JSON object. All that is compared runs in turns in one go
on one machine, because only ratios carry over to another.
"""

from bayesftc.bench._run import SECTIONS, main, measure

__all__ = ["SECTIONS", "main", "measure"]
