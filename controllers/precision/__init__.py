"""Precision learners, and the baselines and relatives that they are compared with."""
