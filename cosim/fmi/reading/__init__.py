"""The file of an FMU: checks, unpacking, and the model description."""
