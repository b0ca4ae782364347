"""Groups of coupled blocks in a run: iterated, and with steps of their own."""
