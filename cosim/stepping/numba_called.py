"""Decorators for the engine's functions that only compiled functions call: machine code is generated for their callers only."""

from numba.extending import register_jitable

from bayesftc.cosim.stepping.numba_ops import OPTIONS

inlined = register_jitable(**OPTIONS)
"""Marks a function that is always inlined."""

callee = register_jitable(**{**OPTIONS, "forceinline": False})
"""Marks a function that LLVM inlines if it is worth while."""
