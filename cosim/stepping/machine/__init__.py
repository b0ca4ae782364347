"""Machine code of step functions, compiled by LLVM from their C."""
