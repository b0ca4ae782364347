"""Beyond the paper: whether fault probabilities are correct."""
