"""Check that an FMU writes all its outputs, and nothing else: unwritten zeros would look like values."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.guards import Guarded
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.running.port_values import PortValues, StopError
from bayesftc.cosim.types import Floats

UNWRITTEN = 0x7FF8_5AFE_C0DE_0001
"""The bits of a NaN that no computation produces."""

Read = Callable[[Floats], None]


def check_written(
    fmu: str, name: str, component: int, ports: PortValues, read: Read, more: Iterable[tuple[str, int, Read]] = ()
) -> None:
    """Refuse an FMU that returns OK but does not write all values, or writes too many.

    In compiled runs an FMU writes next to the values of other blocks, so an array that is too long must be detected before.

    Parameters
    ----------
    fmu, name : str
        Names of the FMU and of its instance.
    component : int
        The instance's address.
    ports : PortValues
        Its ports.
    read : callable
        Reads all outputs.
    more : iterable of (str, int, callable)
        Further values to check: name, size, and the function that reads them.

    Raises
    ------
    FMUError
        If the check fails.
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
            continue  # the run will report this error
        overrun = ports.beyond(component)
        if overrun or not guarded.intact:
            raise FMUError(
                f"The FMU {fmu!r} writes beyond the memory for {overrun or what} of {name!r}, which would damage other data: its "
                "binary and its model description do not agree. Export it again."
            )
        missing += [what or names[place] for place in np.flatnonzero(values == UNWRITTEN)]
    places = (group.unwritten(component) for group in ports.groups[1] if group.kind.code and not group.clocks)
    missing = list(dict.fromkeys([*missing, *(names[place] for place in places if place >= 0)]))
    if missing:
        raise FMUError(
            f"The FMU {fmu!r} returns OK, but has not written {', '.join(missing[:3])}{' and more' if missing[3:] else ''} of "
            f"{name!r}: its binary and its model description do not agree. Export it again."
        )
