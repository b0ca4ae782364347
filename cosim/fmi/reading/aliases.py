"""Variables of an FMU that share a value reference; the binary cannot tell them apart."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from bayesftc.cosim.errors import LAX, FMUError

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.reading.archive import Archive
    from bayesftc.cosim.fmi.reading.description import FMUVariable


def check_aliases(archive: Archive, variables: Iterable[FMUVariable]) -> None:
    """Check that no two settable variables share a value reference.

    FMI 2 allows variables of one type to share a value reference: an output may show an input. If two inputs or parameters
    share one, the value of one of them is lost. FMI 3 forbids all sharing, which fmpy checks.

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
                    f"{variable.reference}, so that setting one would set the other. Ask its maker for a valid FMU, or "
                    f"{LAX}"
                )
            seen[key] = variable.name
