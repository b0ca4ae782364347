"""Experiment 1: a robot arm with a frozen encoder."""
