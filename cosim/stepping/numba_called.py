"""How functions of the engine that only other compiled ones call are marked: machine code is made of their callers alone."""

from numba.extending import register_jitable

from bayesftc.cosim.stepping.numba_ops import OPTIONS

inlined = register_jitable(**OPTIONS)
"""Marks what is inlined wherever it is called."""

callee = register_jitable(**{**OPTIONS, "forceinline": False})
"""Marks what is inlined where LLVM finds that it pays."""
