"""``bayesftc inspect``: what an FMU or an SSP has, and what works with it."""
