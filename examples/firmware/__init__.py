"""The cruise controller as C, in a loop like that of firmware."""
