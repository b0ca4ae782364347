"""Integrators with events, which run model exchange FMUs as blocks."""
