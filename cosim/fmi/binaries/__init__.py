"""The binary of an FMU: loading it, calling its functions, and their buffers."""
