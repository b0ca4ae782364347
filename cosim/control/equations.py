"""A model exchange FMU as two pure functions of time, state and inputs, in continuous time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayesftc.cosim.control.hints import Hints
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

Elements = Sequence[tuple[Port, int]]


class Equations:
    """The derivatives and outputs of a model exchange FMU; its discrete states keep their values after initialization.

    Parameters
    ----------
    fmu : FMU
        The FMU.
    inputs, outputs : sequence of (Port, int)
        The elements of its ports that are inputs and outputs. Other inputs keep their start values.

    Attributes
    ----------
    initial, names, opaque, hints
        See `bayesftc.cosim.control.machine.Machine`.
    """

    def __init__(self, fmu: FMU, inputs: Elements, outputs: Elements):
        self._settings = fmu, inputs, outputs
        self._model = ModelEquations(fmu)
        self._in, self._out = (_places(ports, side) for ports, side in ((fmu.inputs, inputs), (fmu.outputs, outputs)))
        self._u = self._model.u0.copy()
        self.initial, self.names = self._model.x0.copy(), list(self._model.state_names)
        self.opaque: list[str] = []
        self.hints = Hints(self.names, self.initial, [fmu])

    def output(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the outputs at time `t`."""
        self.hints.params(params)
        values: Floats = self._model.outputs(np.asarray(x)[: len(self.names)], self._inputs(u), t)[self._out]
        return values

    def update(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the derivatives of the states at time `t`."""
        self.hints.params(params)
        state = np.asarray(x, dtype=np.float64)[: len(self.names)]
        if t == 0:
            self.hints.beginning(state)
        return self._model.derivatives(state, self._inputs(u), t)

    def _inputs(self, u: Any) -> Floats:
        self._u[self._in] = np.asarray(u, dtype=np.float64)[: len(self._in)]
        return self._u

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._settings


def _places(ports: Any, elements: Elements) -> np.ndarray[Any, np.dtype[np.int64]]:
    begins, total = {}, 0
    for port in ports:
        begins[port.name], total = total, total + port.size
    return np.array([begins[port.name] + i for port, i in elements], dtype=np.int64)
