"""A numba pipeline for functions that only compiled functions call: they are not optimised separately.

numba optimises every function and generates its machine code, and does so again in each caller. All functions that a step
function calls are inlined into it, so the first pass is wasted. Without it, a controller compiles in half the time and runs as
fast.
"""

from __future__ import annotations

from typing import Any

from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, _LowerResult
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """LLVM text that is only linked into another library."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """numba's lowering without machine code."""

    _name = "callee_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        flags, state.flags = state.flags, state.flags.copy()
        state.flags.no_compile = True
        try:
            super().run_pass(state)
        finally:
            state.flags = flags
        state.library.finalize()
        described, call_helper, _, environment = state.cr
        # numba needs an entry for calls from Python; like every function without a wrapper, it has no address.
        entry = _dynfunc.make_function(
            described.lookup_module(), described.qualname, "", 0, environment, (state.library,)
        )
        state.targetctx.insert_user_function(entry, described, [state.library])
        state.cr = _LowerResult(described, call_helper, cfunc=entry, env=environment)
        return True


class Callee(CompilerBase):  # type: ignore[misc]
    """numba's pipeline for functions without Python objects, with another last pass."""

    def define_pipelines(self) -> list[Any]:
        """Return the one pipeline; see numba's documentation of custom pipelines."""
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [(_Lowering if made is NativeLowering else made, text) for made, text in pipeline.passes]
        pipeline.finalize()
        return [pipeline]
