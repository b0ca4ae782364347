"""Experiment 3: which residual detects a faulty sensor."""
