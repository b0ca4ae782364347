"""The step of an FMU: the table for its compiled functions, and their addresses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.fmi.binaries.addresses import Addresses
from bayesftc.cosim.fmi.binaries.codes import DUE, NO_RETURN, SCRATCH_WORDS
from bayesftc.cosim.fmi.binaries.groups import Group
from bayesftc.cosim.fmi.running.by_address import ByAddress


def _address(major: int, role: str, plain: bool) -> int:
    from bayesftc.cosim.stepping.machine.services import service_address

    version = max(major, 2)  # the functions of FMI 1 are called as those of FMI 2

    def find() -> Any:
        if plain:
            from bayesftc.cosim.fmi.running.kernels import FUNCTIONS
        else:
            from bayesftc.cosim.fmi.running.typed_kernels import FUNCTIONS
        return FUNCTIONS[version, role]

    return service_address(f"fmi{version}_{role}_{'plain' if plain else 'typed'}", find)


class StepFunctions(ByAddress):
    """The step functions of one instance, for both engines.

    Parameters
    ----------
    major : int
        1, 2 or 3: the version of FMI, which determines how the functions are called.
    addresses : Addresses
        Addresses of the functions of a step.
    component : int
        The instance's address.
    inputs, outputs : sequence of Group
        Groups to set and to read.
    step : Fraction
        Step size in seconds.
    timing : {"plant", "sampled"}
        Whether the outputs are read before the step, or after it.
    grid : float
        Size of the parts into which a step of FMI 3 may be cut: 0 for any, infinity for none, else multiples of this.
    """

    def __init__(
        self,
        major: int,
        addresses: Addresses,
        component: int,
        inputs: Sequence[Group],
        outputs: Sequence[Group],
        step: Fraction,
        timing: Literal["plant", "sampled"],
        grid: float = math.inf,
    ):
        self._major, self._timing, self._step, self._grid = major, timing, step, grid
        self._component, self._addresses = component, addresses
        self._groups = tuple(inputs), tuple(outputs)
        self._scratch = np.zeros(SCRATCH_WORDS, dtype=np.int64)
        self._scratch[NO_RETURN], self._scratch.view(np.float64)[DUE] = 1, math.inf
        sides = (inputs, outputs)
        self._plain = not addresses.enter_event_mode and all(
            len(s) <= 1 and all(g.kind.plain for g in s) for s in sides
        )
        ins = outs = 0, 0, 0, 0
        if self._plain:
            ins, outs = (side[0].place() if side else (0, 0, 0, 0) for side in sides)
            counts = 0, 0, 0, 0
        else:
            self._rows = [np.array([g.words() for g in side], dtype=np.int64) for side in sides]
            counts = self._rows[0].ctypes.data, len(inputs), self._rows[1].ctypes.data, len(outputs)
        a = addresses
        size, parts = np.array([float(step), grid]).view(np.int64)
        self.table = np.array(
            [
                component,
                outs[0],
                ins[0],
                a.do_step,
                ins[1],
                ins[2],
                outs[1],
                outs[2],
                size,
                self._scratch.ctypes.data,
                ins[3],
                outs[3],
                a.real_status,
                a.boolean_status,
                a.enter_event_mode,
                a.update_discrete,
                a.enter_step_mode,
                *counts,
                parts,
                0,
            ],
            dtype=np.int64,
        )

    def expect_return(self) -> None:
        """Stop promising at each step that no earlier state will be restored (noSetFMUStatePriorToCurrentPoint)."""
        if self._major != 1:  # in FMI 1 this word is newStep
            self._scratch[NO_RETURN] = 0

    #: The word of the table that holds the step size.
    step_word = 8

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return _address(self._major, "get" if self._timing == "plant" else "sampled", self._plain)

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 if the output function does everything."""
        return _address(self._major, "advance", self._plain) if self._timing == "plant" else 0
