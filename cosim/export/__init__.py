"""Export of blocks and diagrams as FMUs and as C."""
