"""Variables of an FMU that share a value reference, by which alone the binary knows them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import LAX, FMUError

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.reading.archive import Archive
    from bayesftc.cosim.fmi.reading.description import FMUVariable


def check_aliases(archive: Archive, variables: Iterable[FMUVariable]) -> None:
    """Check that no two variables that can be set are one and the same to the binary.

    FMI 2 lets variables of one type share a value reference, as an output that shows an input. Of two inputs or parameters that
    do, one would never arrive. FMI 3 forbids all sharing, which fmpy finds.

    Raises
    ------
    FMUError
        If there are two such variables.
    """
    seen: dict[tuple[str, int], str] = {}
    for variable in variables:
        if variable.settable and variable.causality in {"input", "parameter"}:
            key = ("Integer" if variable.type == "Enumeration" else variable.type), variable.reference
            if key in seen:
                raise FMUError(
                    f"The FMU {archive.path} gives {seen[key]!r} and {variable.name!r} one value reference, "
                    f"{variable.reference}, so that to set one would set the other. Ask its maker for a valid one, or "
                    f"{LAX}"
                )
            seen[key] = variable.name
