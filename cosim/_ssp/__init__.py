"""Reading and writing systems of FMUs in the SSP standard's form."""
