"""Reports of campaigns: a stored campaign as one self-contained page.

`contents.py` chooses the content (the compared factor, the error signals). `pooling.py` and `levels.py` compute means over
several points with their intervals. `tables.py` and `comparisons.py` write tables and sentences. `scores.py` reads scores and
true faults from the store. `bands.py`, `grids.py` and `detection.py` draw figures. `page.py` puts all into the template
``page.html``.
"""
