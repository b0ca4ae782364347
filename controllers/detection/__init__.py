"""Residuals, thresholds and classifiers for fault detection, and the faults that they can detect."""
