"""Precision learners, baselines, and related learners from the literature."""
