"""Beyond the paper: the best possible detector."""
