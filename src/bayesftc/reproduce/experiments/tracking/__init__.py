"""Experiment 2: a car whose speed sensor fails."""
