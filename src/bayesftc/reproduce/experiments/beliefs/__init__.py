"""Beyond the paper: fault modes whose settings are wrong."""
