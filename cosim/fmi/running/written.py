"""Whether an FMU gives what it says it has given, and no more: zeros would look like values."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.guards import Guarded
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.running.port_values import PortValues, StopError
from bayesftc.cosim.types import Floats

UNWRITTEN = 0x7FF8_5AFE_C0DE_0001
"""The bits of a NaN that no computation makes."""

Read = Callable[[Floats], None]


def check_written(
    fmu: str, name: str, component: int, ports: PortValues, read: Read, more: Iterable[tuple[str, int, Read]] = ()
) -> None:
    """Refuse an FMU that says OK and does not write, as an array of fewer elements, or writes too much.

    Compiled runs have it write among the values of other blocks, so that an array of more elements must be seen before.

    Parameters
    ----------
    fmu, name : str
        What the FMU and its instance are called.
    component : int
        The instance's address.
    ports : PortValues
        Its ports.
    read : callable
        Reads all outputs.
    more : iterable of (str, int, callable)
        What else is to be read: what it is called, how many numbers, and how.

    Raises
    ------
    FMUError
        If it does not.
    """
    names = [repr(output) for output in ports.names[1]]
    missing: list[str] = []
    for what, size, reads in (*more, ("", len(names), read)):
        guarded = Guarded(size, np.dtype(np.int64))
        values = guarded.values
        values[:] = UNWRITTEN
        try:
            reads(values.view(np.float64))
        except (CallError, StopError):
            continue  # the run will say so
        too_far = ports.beyond(component)
        if too_far or not guarded.intact:
            raise FMUError(
                f"The FMU {fmu!r} writes beyond the memory that it is given for {too_far or what} of {name!r}, where it would "
                "damage what belongs to others: its binary and its model description do not agree. Export it again."
            )
        missing += [what or names[place] for place in np.flatnonzero(values == UNWRITTEN)]
    places = (group.unwritten(component) for group in ports.groups[1] if group.kind.code and not group.clocks)
    missing = list(dict.fromkeys([*missing, *(names[place] for place in places if place >= 0)]))
    if missing:
        raise FMUError(
            f"The FMU {fmu!r} says OK, but has not written {', '.join(missing[:3])}{' and more' if missing[3:] else ''} of "
            f"{name!r}: its binary and its model description do not agree. Export it again."
        )
