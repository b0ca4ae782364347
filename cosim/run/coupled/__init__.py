"""Groups of coupled blocks in a run: iteration and substeps."""
