"""Systems of FMUs in the SSP standard's form, read and written."""
