"""The cruise controller as C, in a loop as firmware has it."""
