"""Loops compared with each other over many seeds."""
