"""Reading and writing systems of FMUs in the format of the SSP standard."""
