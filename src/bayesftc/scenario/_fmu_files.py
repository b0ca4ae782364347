"""FMUs in scenario files: shipped ones by name, and files relative to the scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from bayesftc.cosim.block import Block
from bayesftc.cosim.errors import FMUError
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import build


@dataclass(frozen=True)
class Shipped:
    """An FMU: a shipped one by name and version of FMI, or a file.

    Attributes
    ----------
    fmu : str
        Name of a shipped FMU, or a file, relative to the scenario.
    fmi : str, optional
        Version of a shipped FMU.
    """

    fmu: str
    fmi: Literal["2.0", "3.0"] | None = None


def fmu_of(table: dict[str, Any], place: Place, folder: Path) -> Block:
    """Return the FMU of a table with the key ``fmu`` and the settings of `bayesftc.cosim.FMU`."""
    from bayesftc import fmus
    from bayesftc.cosim.fmi.fmu import FMU

    chosen: Shipped = build(Shipped, taken(table, Shipped), place)
    is_file = chosen.fmu.lower().endswith(".fmu") or Path(chosen.fmu).name != chosen.fmu
    if is_file and chosen.fmi is not None:
        raise (place / "fmi").error("chooses the version of a shipped FMU, but 'fmu' is a file. Leave out 'fmi'.")
    try:
        path = folder / chosen.fmu if is_file else fmus.path(chosen.fmu, fmi=chosen.fmi or "2.0")
    except (ValueError, FileNotFoundError) as error:
        raise FMUError(f"{place / 'fmu'}: {error} The name of an FMU file must end with .fmu.") from None
    for side in ("inputs", "outputs"):  # all else that ports have is read from the FMU
        for i, port in enumerate(items if isinstance(items := table.get(side), list) else ()):
            if isinstance(port, Mapping):
                (place / side / i).refuse_unknown(port, ("name", "unit"))
    return build(FMU, table, place, given={"path": path})  # type: ignore[no-any-return]


def taken(table: dict[str, Any], cls: type[Any]) -> Mapping[str, Any]:
    """Remove from the table the entries that are fields of `cls`, and return them."""
    return {f.name: table.pop(f.name) for f in fields(cls) if f.name in table}
