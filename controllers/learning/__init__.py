"""Learning fault modes from recorded runs."""
