"""The inputs and outputs of a model exchange FMU: set and read from here, and described to compiled code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesftc.cosim.fmi.binaries.groups import element_names, groups
from bayesftc.cosim.fmi.binaries.guards import beyond
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.binaries.model_library import ModelLibrary
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.running.refusals import function_of, misfit
from bayesftc.cosim.fmi.running.rounding import Rounding
from bayesftc.cosim.types import Floats


class StopError(Exception):
    """Why an instance cannot go on, as a sentence."""


class EndError(StopError):
    """The FMU itself ends the simulation, which is no failure."""


class PortValues:
    """The groups of one type in which inputs and outputs lie.

    Parameters
    ----------
    library : ModelLibrary2 or ModelLibrary3
        The binary.
    inputs, outputs : sequence of FMUVariable
        What is set (tunable parameters, too) and what is read.

    Attributes
    ----------
    groups : tuple of list of Group
        Of inputs and outputs.
    rows : tuple of ndarray
        The same, as compiled functions see them.
    names : tuple of tuple of str
        Of their elements.
    rounding : Rounding
        What is known of outputs that no double holds.
    """

    def __init__(self, library: ModelLibrary, inputs: Sequence[FMUVariable], outputs: Sequence[FMUVariable]):
        self._major, find = library.description.fmi_major, library.function_address
        self.groups = groups(inputs, self._major, "Set", find), groups(outputs, self._major, "Get", find)
        self.rows = tuple(np.array([g.words() for g in side], dtype=np.int64) for side in self.groups)
        self._elements = element_names(inputs), element_names(outputs)
        self.rounding = Rounding(self.groups[1], self._elements[1])
        into, out = (tuple(name for name, _ in side) for side in self._elements)
        self.names = into, out

    def write(self, component: int, values: Floats) -> None:
        """Set the inputs.

        Raises
        ------
        StopError
            If a type does not hold a value.
        CallError
            If the FMU refuses them.
        """
        for group in self.groups[0]:
            status, unfit = group.put(component, values)
            if unfit >= 0:
                raise StopError(self.misfit(unfit, is_input=True))
            self._check(group.begin, status, is_input=True)

    def read(self, component: int, values: Floats) -> None:
        """Read the outputs; errors are as of `write`."""
        for group in self.groups[1]:
            status, unfit = group.take(component, values)
            if unfit >= 0:
                raise StopError(self.misfit(unfit, is_input=False))
            self._check(group.begin, status, is_input=False)

    def beyond(self, component: int) -> str | None:
        """Return which outputs the FMU has written beyond the memory that it was given for them, or None."""
        return beyond(self.groups[1], component, self._elements[1])

    def _check(self, begin: int, status: int, *, is_input: bool) -> None:
        if status > 1 or status < 0:
            raise CallError(self.function_of(begin, is_input=is_input), status)

    def function_of(self, begin: int, *, is_input: bool) -> str:
        """Return which function failed to set inputs or read outputs, and of which, by where they begin."""
        side = 0 if is_input else 1
        return function_of(self.groups[side], self._elements[side], begin)

    def misfit(self, place: int, *, is_input: bool) -> str:
        """Return which input its type does not hold, or which output no double, without a full stop."""
        return misfit(self._elements[0 if is_input else 1], place, self._major, is_input=is_input).removesuffix(".")
