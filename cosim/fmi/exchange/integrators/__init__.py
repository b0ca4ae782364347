"""Integrators with events that make blocks of model exchange FMUs."""
