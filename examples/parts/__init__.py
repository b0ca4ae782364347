"""Diagrams and a scenario of the smaller blocks: filters, limits, tables, logic, test signals."""
