"""Experiment 3: which residual tells that a sensor is faulty."""
