"""A car under cruise control, whose two speed sensors fail (the paper's second experiment)."""
