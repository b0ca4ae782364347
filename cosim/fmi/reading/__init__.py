"""The file of an FMU: checked, unpacked, and what its description says."""
