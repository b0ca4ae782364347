"""An FMU as a prediction: functions of state and control that step functions may call."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.prediction.instances import ExchangePlaced, Layout, StepPlaced, compiled
from bayesftc.cosim.fmi.prediction.pool import Placed, Pool
from bayesftc.cosim.fmi.prediction.words import MOST
from bayesftc.cosim.fmi.running.values import resolved
from bayesftc.cosim.stepping.foreign import Foreign

_ROLES = {
    "move": (("x", "u", "x_next"), ("x_next",)),
    "move_slopes": (("x", "u", "F", "B"), ("F", "B")),
    "read": (("x", "y"), ("y",)),
    "read_slopes": (("x", "C"), ("C",)),
}
"""The arguments of each function, and those that it writes."""

_pools: dict[str, Pool] = {}
_addresses: dict[str, int] = {}
_lock = threading.RLock()


@dataclass(frozen=True, eq=False)
class Prediction:
    """An FMU whose state is set before each step.

    Parameters
    ----------
    fmu : FMU
        The block; its first inputs are the controls. For co-simulation its first outputs are the states.
    states : tuple of str
        Names of the states, element by element.
    starts : tuple of str
        For co-simulation: the variables that set them before initialization.
    controls, loads : int
        Numbers of the inputs that are controls; of the loads on them that are states after those of the plant (all or none).
    order : tuple of int
        For each sensor the number of its output.
    step : Fraction
        Seconds of a step.
    parts : int
        For model exchange: number of Runge-Kutta steps in it.
    held : tuple of float
        Values of all inputs at rest.
    scales : tuple of float
        Sizes of states and controls, for derivatives by differences.
    """

    fmu: FMU
    states: tuple[str, ...]
    starts: tuple[str, ...]
    controls: int
    loads: int
    order: tuple[int, ...]
    step: Fraction
    parts: int
    held: tuple[float, ...]
    scales: tuple[float, ...] = field(default=())

    @cached_property
    def digest(self) -> str:
        """A hash of everything that the functions depend on, the file's content included."""
        archive, _ = self.fmu._read()
        given: Mapping[str, Any] = self.fmu.parameters or {}
        ports = [[port.name for port in side] for side in self.fmu._sides]
        own = [getattr(self, name) for name in self.__dataclass_fields__ if name != "fmu"]
        text = repr((archive.digest, sorted(given.items()), ports, self.fmu.kind, self.fmu.rtol, own))
        return hashlib.sha256(text.encode()).hexdigest()[:24]

    @property
    def pool(self) -> Pool:
        """The instances, the same for equal predictions."""
        with _lock:
            if self.digest not in _pools:
                exchange = self.fmu.description.exchange
                once = (
                    exchange is not None and exchange.once
                    if self.fmu.kind == "model exchange"
                    else self.fmu.description.capabilities.get("canBeInstantiatedOnlyOncePerProcess")
                )
                sizes = len(self.states) + self.loads, self.controls, len(self.order)
                _pools[self.digest] = Pool(f"the FMU {self.fmu.path}", self._open, sizes, 1 if once else MOST)
            return _pools[self.digest]

    def function(self, role: str) -> PredictionFunction:
        """Return ``move(x, u, x_next)``, ``move_slopes(x, u, F, B)``, ``read(x, y)`` or ``read_slopes(x, C)``."""
        return PredictionFunction(self, role)

    @contextmanager
    def briefly(self, role: str) -> Iterator[PredictionFunction]:
        """Return a function whose instances are freed at the end of the body, unless something else uses them.

        Raises
        ------
        FMUError
            If the FMU cannot be instantiated or initialized.
        """
        with self.pool.briefly():
            yield PredictionFunction(self, role, kept=False)

    def _open(self) -> Placed:
        archive, description = self.fmu._read()
        beginning, outputs = self.fmu._variables()
        layout = Layout(
            self.controls,
            self.loads,
            self.order,
            self.step,
            self.parts,
            np.array(self.held, dtype=np.float64),
            np.array(self.scales, dtype=np.float64),
        )
        name = f"{self.fmu.default_name} as model"
        if self.fmu.kind == "model exchange":
            from bayesftc.cosim.fmi.binaries.model_library import load_model

            return ExchangePlaced(load_model(archive, description), name, beginning, outputs, layout)
        from bayesftc.cosim.fmi.binaries.loading import load_library

        variables = resolved(archive, description, self.fmu._given)
        starts = [variables[n] for n in self.starts]
        return StepPlaced(load_library(archive, description), name, beginning, outputs, layout, starts)

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


class PredictionFunction(Foreign):
    """One of the functions of a prediction.

    Parameters
    ----------
    prediction : Prediction
        The FMU and the choice of its variables.
    role : str
        See `Prediction.function`.
    kept : bool
        Whether the instances stay until the process ends.
    """

    def __init__(self, prediction: Prediction, role: str, *, kept: bool = True):
        self.prediction, self.role, self.kept = prediction, role, kept
        names, stored = _ROLES[role]
        n, p, m = len(prediction.states) + prediction.loads, prediction.controls, len(prediction.order)
        sizes = {"x": n, "u": p, "x_next": n, "F": n * n, "B": n * p, "y": m, "C": m * n}
        self.arguments = {name: sizes[name] for name in names}
        self.stored = frozenset(stored)
        self.symbol = f"bayesftc_{role}_{prediction.digest}"
        self.title = f"the FMU {prediction.fmu.path}"

    def defined(self) -> int:
        """See `Foreign.defined`."""
        with _lock:
            pool = self.prediction.pool
            if self.kept:
                pool.keep()
            if self.symbol not in _addresses:
                _addresses[self.symbol] = _bound(
                    self.symbol, int(compiled(self.role).address), pool.words.ctypes.data, list(self.arguments)
                )
            return _addresses[self.symbol]


def _bound(symbol: str, function: int, pool: int, arguments: Sequence[str]) -> int:
    """Define a symbol: the compiled function with the address of the pool as its first argument."""
    from bayesftc.cosim.stepping.foreign import MOST_ARGUMENTS
    from bayesftc.cosim.stepping.machine.code import load, machine_code

    names = [f"ptr %a{i}" for i, _ in enumerate(arguments)]
    given = ", ".join([f"i64 {pool}", *names, *["ptr null"] * (MOST_ARGUMENTS - len(names))])
    text = (
        f"define void @{symbol}({', '.join(names)}) {{\n"
        f"  %f = inttoptr i64 {function} to ptr\n  call void %f({given})\n  ret void\n}}\n"
    )
    return load(machine_code(text), symbol)


__all__ = ["Prediction", "PredictionFunction"]
