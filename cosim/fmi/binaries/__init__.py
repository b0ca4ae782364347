"""The binary of an FMU: loaded, its functions called, memory lent to them."""
