"""Reports of campaigns: a stored campaign as one self-contained page.

The way of the data: `contents.py` decides what a campaign can say (which factor is compared, which signals are errors),
`pooling.py` and `levels.py` how sure means over several points are, `tables.py` and `comparisons.py` write, `bands.py`,
`grids.py` and `detection.py` read the store and draw, `page.py` puts text, tables and figures into the template ``page.html``.
"""
