"""Thresholds for residuals, learned from healthy data."""
