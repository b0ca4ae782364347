"""One step of an FMU, and the reading of its outputs: the functions that both engines call, with the same numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.block import Floats

# The codes of bayesftc.cosim._fmi_kernels, repeated so that the interpreted engine does without numba; a test compares.
GET, SET, STEP = 100, 200, 300
EARLY, TERMINATED = 401, 402
_TOLERANCE = 1e-9
DISCARD, FATAL = 2, 4

_VALUES2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_VALUES3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t
)
_STEP2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
_STEP3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)


@cache
def _compiled(major: int, role: str) -> Any:
    from bayesftc.cosim import _fmi_kernels
    from bayesftc.cosim._compiler import compile_raw

    function: Any = _fmi_kernels.FUNCTIONS[major, role]
    return compile_raw(function)


class StepFunctions:
    """The FMI functions of one instance with reused buffers, for both engines.

    Parameters
    ----------
    major : int
        2 or 3: the version of FMI, which says how the functions are called.
    addresses : tuple of int
        Of the functions that read reals, set reals, and make a step.
    component : int
        The instance's address.
    inputs, outputs : sequence of int
        Value references.
    h : float
        Step size in seconds.
    timing : {"plant", "sampled"}
        Whether the outputs are read before the step, or after it.
    """

    def __init__(
        self,
        major: int,
        addresses: tuple[int, int, int],
        component: int,
        inputs: Sequence[int],
        outputs: Sequence[int],
        h: float,
        timing: Literal["plant", "sampled"],
    ):
        self._major, self._timing, self._h = major, timing, h
        self._component = component
        self._references = [np.array(r, dtype=np.uint32) for r in (inputs, outputs)]
        self._buffers = [np.zeros(max(len(r), 1)) for r in (inputs, outputs)]
        self._scratch = np.zeros(4, dtype=np.int64)
        in_refs, out_refs = (r.ctypes.data for r in self._references)
        size = int(np.float64(h).view(np.int64))
        words = [component, *addresses[:2], addresses[2], in_refs, len(inputs), out_refs, len(outputs), size]
        self.table = np.array([*words, self._scratch.ctypes.data], dtype=np.int64)
        self._addresses = addresses

    # What follows is for interpreted runs alone; compiled ones, of which there may be thousands, need not wait for it.
    @cached_property
    def _get(self) -> Any:
        return self._values(self._addresses[0])

    @cached_property
    def _set(self) -> Any:
        return self._values(self._addresses[1])

    @cached_property
    def _do_step(self) -> Any:
        return (_STEP2 if self._major == 2 else _STEP3)(self._addresses[2])

    @cached_property
    def _input_arguments(self) -> tuple[int, ...]:
        return self._arguments(0)

    @cached_property
    def _output_arguments(self) -> tuple[int, ...]:
        return self._arguments(1)

    @cached_property
    def _places(self) -> list[int]:
        return [self._scratch.ctypes.data + 8 * i for i in range(4)]

    @property
    def _values(self) -> Any:
        return _VALUES2 if self._major == 2 else _VALUES3

    def _arguments(self, side: int) -> tuple[int, ...]:
        references, buffer = self._references[side], self._buffers[side]
        again = (len(references),) if self._major == 3 else ()
        return self._component, references.ctypes.data, len(references), buffer.ctypes.data, *again

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return int(_compiled(self._major, "get" if self._timing == "plant" else "sampled").address)

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 where all is done in the output function."""
        return int(_compiled(self._major, "advance").address) if self._timing == "plant" else 0

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        if self._timing == "sampled":
            status = self._advance(inputs, t)
            if status:
                return status
        return self._read(outputs)

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        return self._advance(inputs, t) if self._timing == "plant" else 0

    def _read(self, outputs: Floats) -> int:
        count = len(self._references[1])
        if count == 0:
            return 0
        buffer = self._buffers[1]
        buffer[:] = outputs  # what a failing FMU does not write stays as it is, as in compiled code
        status: int = self._get(*self._output_arguments)
        outputs[:] = buffer
        return _failed(GET, status)

    def _advance(self, inputs: Floats, t: float) -> int:
        if len(self._references[0]):
            self._buffers[0][:] = inputs
            status = _failed(SET, self._set(*self._input_arguments))
            if status:
                return status
        h = self._h
        if self._major == 2:
            return _failed(STEP, self._do_step(self._component, t, h, 1))
        status = _failed(STEP, self._do_step(self._component, t, h, True, *self._places))
        if status:
            return status
        _, terminate, early, _ = self._scratch
        if terminate:
            return TERMINATED
        if early and not self._scratch.view(np.float64)[3] >= t + h - _TOLERANCE * h:
            return EARLY
        return 0


def _failed(where: int, status: int) -> int:
    return where + status if status > 1 or status < 0 else 0
