"""Foundations: time, units, numbers, archives, caches, processes."""
