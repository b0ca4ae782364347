"""Convert blocks and diagrams to systems of python-control."""
