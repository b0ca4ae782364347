"""How numba compiles what the engine calls: a step function and all below it, as one C function.

numba's own way is made for Python functions. For step functions of a few states this one takes a third less time a step, and
less time to compile:

- The sections of memory that a function gets do not overlap. Nobody can tell LLVM so from Python, and without it every number
  is loaded again after every store.
- LLVM unrolls nested loops late, when it looks no more for what the copies have in common. A quick pass before the full one has
  them unrolled by then; numba's own first pass only inlines, into functions also that nobody calls.
- numba's C function is a shell around the one with Python's exceptions, and not to be inlined. Step functions raise none.
- With AVX-512, LLVM compares into mask registers for each `select`. The way there and back is several cycles long, and a step of
  a controller is one long chain of such operations.
"""

from __future__ import annotations

import re
from typing import Any

from llvmlite import ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """The LLVM text of one entry, whose name begins with ``cfunc.``, and of all that it calls."""

    def add_ir_module(self, ir_module: Any) -> None:
        features = str(self._codegen._tm_features)
        without = re.sub(r"\+(?=avx512|avx10)", "-", features)
        for function in ir_module.functions:
            for block in function.blocks:
                for instruction in block.instructions:
                    if isinstance(instruction, ir.CallInstr):
                        instruction.attributes.discard("noinline")
            if function.is_declaration:
                continue
            for argument in function.args:
                if isinstance(argument.type, ir.PointerType):
                    argument.add_attribute("noalias")
            if without != features:  # an attribute with a value, of which llvmlite's set does not know
                set.add(function.attributes, f'"target-features"="{without}"')
        super().add_ir_module(ir_module)

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and not function.name.startswith("cfunc."):
                function.linkage = "internal"
        for level in (1, 3):
            passes, builder = self._codegen._module_pass_manager(opt=level)
            passes.run(self._final_module, builder)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """numba's own, into our library."""

    _name = "entry_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


class Entry(CompilerBase):  # type: ignore[misc]
    """numba's pipeline for functions without Python objects, with our last pass.

    The pointers among the function's arguments must lead to memory that does not overlap.
    """

    def define_pipelines(self) -> list[Any]:
        """Return the one pipeline; see numba's documentation of custom pipelines."""
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state)
        pipeline.passes = [(_Lowering if made is NativeLowering else made, text) for made, text in pipeline.passes]
        pipeline.finalize()
        return [pipeline]
