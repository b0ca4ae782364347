"""Beyond the paper: whether fault probabilities are true."""
