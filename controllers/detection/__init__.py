"""Residuals, thresholds and classifiers that make fault detectors, and what these can find."""
