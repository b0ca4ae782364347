"""Blocks and diagrams as FMUs and as C."""
