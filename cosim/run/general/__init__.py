"""The compiled loop for all diagrams: its tables, and its functions."""
