"""Runs of a diagram: engines, sessions, recordings, results."""
