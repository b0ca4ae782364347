"""Instances of an FMU for a prediction, with their tables for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from bayesftc._interrupt import import_whole
from bayesftc.cosim.fmi.binaries.groups import element_names
from bayesftc.cosim.fmi.binaries.library import Beginning, Library
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.prediction import words
from bayesftc.cosim.fmi.prediction.by_exchange import work_size
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.running.instance import Instance
from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Layout:
    """The sizes and numbers of a prediction that its instances need.

    Attributes
    ----------
    controls, loads : int
        Number of the inputs, the first ones, that are controls; of the loads on them that are states.
    order : tuple of int
        For each sensor the number of its output.
    step : Fraction
        Seconds of a step.
    parts : int
        Number of parts into which the integrator of model exchange divides it.
    held : ndarray
        Values of the inputs at rest.
    scales : ndarray
        Sizes of states and controls, for differences.
    """

    controls: int
    loads: int
    order: tuple[int, ...]
    step: Fraction
    parts: int
    held: Floats
    scales: Floats


class _Tabled:
    """An instance's table; it keeps the arrays to which the table refers."""

    def __init__(self, layout: Layout, states: int, outputs: int):
        n, p, loads, sensors = states, layout.controls, layout.loads, len(layout.order)
        c = n + p
        self.table = np.zeros(words.WORDS, dtype=np.int64)
        self._kept: list[Any] = []
        numbers = {
            words.PLANT_STATES: n,
            words.DRIVEN: p,
            words.LOADS: loads,
            words.INPUTS: len(layout.held),
            words.OUTPUTS: outputs,
            words.PARTS: layout.parts,
        }
        arrays = {
            words.HELD: layout.held.copy(),
            words.VALUES: layout.held.copy(),
            words.SHOWN: np.zeros(n + outputs),
            words.SCALES: layout.scales.copy(),
            words.ORDER: np.array(layout.order, dtype=np.int64),
            words.WORK: np.zeros(work_size(n, c, outputs)),
            words.SLOPES: np.zeros((n + outputs) * c),
            words.MOVED: np.zeros(3 * (n + loads) + p + 2 * sensors),
        }
        for place, number in numbers.items():
            self.table[place] = number
        for place, array in arrays.items():
            self.point(place, array)
        self.table.view(np.float64)[words.STEP] = float(layout.step)

    def point(self, place: int, array: np.ndarray[Any, Any]) -> None:
        """Write the address of an array, and keep the array."""
        self._kept.append(array)
        self.table[place] = array.ctypes.data


def _references(variables: Sequence[FMUVariable]) -> np.ndarray[Any, np.dtype[np.uint32]]:
    return np.array([v.reference for v in variables], dtype=np.uint32)


class ExchangePlaced(_Tabled):
    """A model exchange FMU."""

    def __init__(self, library: Any, name: str, beginning: Beginning, outputs: Sequence[FMUVariable], layout: Layout):
        self.model = ExchangeModel(library, name, beginning, outputs)
        self.model.expect_return()
        super().__init__(layout, self.model.nx, len(element_names(outputs)))
        table, info = self.table, library.description.exchange
        table[words.EXCHANGE], table[words.OWN] = 1, self.model.table.ctypes.data
        if info.directional:
            controls = list(beginning.inputs)[: layout.controls]
            table[words.DIRECTIONAL], table[words.MAJOR] = library.address("directional"), library.description.fmi_major
            for place, variables in (
                (words.KNOWNS, [*info.states, *controls]),
                (words.RATES, info.derivatives),
                (words.SEEN, outputs),
            ):
                self.point(place, _references(variables))
                table[place + 1] = len(variables)

    def messages(self) -> str:
        """See `bayesftc.cosim.fmi.prediction.pool.Placed`."""
        return self.model.messages.quoted()

    def close(self, *, healthy: bool) -> None:
        """See `bayesftc.cosim.fmi.prediction.pool.Placed`."""
        self.model.healthy = self.model.healthy and healthy
        self.model.close()


class _Held(Instance):
    """An instance whose state in initialization mode is saved."""

    def _initializing(self) -> None:
        self._at_start = self._states.save()

    @property
    def start_address(self) -> int:
        """Address of the saved state, in the memory of the FMU."""
        return self._at_start.place_in(self._states)

    def last_messages(self) -> str:
        """Return the last messages of the FMU, as a sentence."""
        return self._messages.quoted()

    def release(self, *, healthy: bool) -> None:
        """Free the instance."""
        self._healthy = self._healthy and healthy
        self.close()


class StepPlaced(_Tabled):
    """A co-simulation FMU."""

    def __init__(
        self,
        library: Library,
        name: str,
        beginning: Beginning,
        outputs: Sequence[FMUVariable],
        layout: Layout,
        starts: Sequence[FMUVariable],
    ):
        self._instance = instance = _Held(library, name, layout.step, "plant", beginning, outputs)
        instance.expect_return()
        super().__init__(layout, len(starts), len(outputs) - len(starts))
        table, major = self.table, library.description.fmi_major
        setter = library.function_address("fmi2SetReal" if major == 2 else "fmi3SetFloat64")
        component = int(instance.table[0])
        table[words.OWN], table[words.MAJOR], table[words.COMPONENT] = instance.table.ctypes.data, major, component
        table[words.RESTORE], table[words.SAVED] = library.state_addresses[1], instance.start_address
        table[words.SET_STARTS] = setter
        table[words.EXIT] = library.function_address(f"fmi{major}ExitInitializationMode")
        table[words.UPDATE], table[words.OUTPUT] = instance.update_address, instance.output_address
        self.point(words.STARTS, _references(starts))

    def messages(self) -> str:
        """See `bayesftc.cosim.fmi.prediction.pool.Placed`."""
        return self._instance.last_messages()

    def close(self, *, healthy: bool) -> None:
        """See `bayesftc.cosim.fmi.prediction.pool.Placed`."""
        self._instance.release(healthy=healthy)


@cache
def compiled(role: str) -> Any:
    """Return a compiled function of `bayesftc.cosim.fmi.prediction.kernels`."""
    import_whole("bayesftc.cosim.stepping.compiler")
    from bayesftc.cosim.fmi.prediction.kernels import FUNCTIONS, SIGNATURE
    from bayesftc.cosim.stepping.compiler import compile_callback

    function: Any = FUNCTIONS[role]
    return compile_callback(function, SIGNATURE)
