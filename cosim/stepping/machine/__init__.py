"""Machine code of step functions: the C that is written of them, as LLVM takes it."""
