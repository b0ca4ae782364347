"""The inputs and outputs of an FMU: set and read from Python, and described for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from bayesftc.cosim.fmi.binaries.groups import Group, element_names, groups
from bayesftc.cosim.fmi.binaries.guards import beyond
from bayesftc.cosim.fmi.binaries.library import CallError, Library
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.running.refusals import function_of, misfit
from bayesftc.cosim.fmi.running.rounding import Rounding
from bayesftc.cosim.types import Floats


class StopError(Exception):
    """Why an instance cannot continue, as a sentence."""


class EndError(StopError):
    """The FMU itself ends the simulation, which is no failure."""


class PortValues:
    """The inputs and outputs of an instance, in groups of one type.

    Parameters
    ----------
    library : Library
        The binary.
    inputs, outputs : sequence of FMUVariable
        Variables to set (including tunable parameters) and to read.
    events : bool
        Whether inputs that are not continuous may only change at events.

    Attributes
    ----------
    groups : tuple of list of Group
        The groups of the inputs and of the outputs.
    names : tuple of tuple of str
        The names of their elements.
    rounding : Rounding
        Which outputs may be rounded, and were.
    """

    def __init__(
        self, library: Library, inputs: Sequence[FMUVariable], outputs: Sequence[FMUVariable], *, events: bool = False
    ):
        major, find = library.description.fmi_major, library.function_address
        input_groups = groups(inputs, major, "Set", find, events=events)
        self._major, self.groups = major, (input_groups, groups(outputs, major, "Get", find))
        self._elements = element_names(inputs), element_names(outputs)
        self.rounding = Rounding(self.groups[1], self._elements[1])
        self.names = tuple(tuple(name for name, _ in side) for side in self._elements)

    @cached_property
    def rows(self) -> tuple[np.ndarray[Any, np.dtype[np.int64]], ...]:
        """The groups in the layout of compiled functions."""
        return tuple(np.array([g.words() for g in side], dtype=np.int64) for side in self.groups)

    def write(self, component: int, values: Floats) -> None:
        """Set the inputs.

        Raises
        ------
        StopError
            If a value does not fit its type.
        CallError
            If the FMU returns an error.
        """
        for group in self.groups[0]:
            self.put(component, group, values)

    def read(self, component: int, values: Floats) -> None:
        """Read the outputs; errors are those of `write`."""
        for group in self.groups[1]:
            self.take(component, group, values)

    def put(self, component: int, group: Group, values: Floats) -> None:
        """Set one group of inputs; errors are those of `write`."""
        self._check(group, *group.put(component, values), is_input=True)

    def take(self, component: int, group: Group, values: Floats) -> None:
        """Read one group of outputs; errors are those of `write`."""
        self._check(group, *group.take(component, values), is_input=False)

    def beyond(self, component: int) -> str | None:
        """Return which outputs the FMU has written beyond their buffers, or None."""
        return beyond(self.groups[1], component, self._elements[1])

    def _check(self, group: Group, status: int, unfit: int, *, is_input: bool) -> None:
        if unfit >= 0:
            raise StopError(self.misfit(unfit, is_input=is_input))
        if status > 1 or status < 0:
            raise CallError(self.function_of(group.begin, is_input=is_input), status)

    def function_of(self, begin: int, *, is_input: bool) -> str:
        """Return which function failed, and for which variables, by the first element of their group."""
        side = 0 if is_input else 1
        return function_of(self.groups[side], self._elements[side], begin)

    def misfit(self, place: int, *, is_input: bool) -> str:
        """Return which input does not fit its type, or which output does not fit a double, without a full stop."""
        return misfit(self._elements[0 if is_input else 1], place, self._major, is_input=is_input).removesuffix(".")
