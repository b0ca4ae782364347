"""Groups of coupled blocks: iterated, and with steps of their own."""
