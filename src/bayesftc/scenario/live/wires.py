"""Files of wires: which message of a bridge is which input of a live run, and which output goes where."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, is_dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, get_type_hints

from bayesftc.cosim.live.bridge import Bridge
from bayesftc.cosim.live.kinds import BRIDGES, own_bridge
from bayesftc.cosim.live.recorder import Recording
from bayesftc.cosim.live.run import FEWEST
from bayesftc.cosim.live.wires import Names, Wire
from bayesftc.scenario._files import find_scenario, read_toml
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build, choose, convert, settings

SECTIONS = ("watchdog", "recording", "bridge")


@dataclass(frozen=True)
class Pieces:
    """The pieces of the recording: see `bayesftc.cosim.live.Recording`.

    Attributes
    ----------
    seconds : float
        Length of a piece in seconds of the clock.
    rows : int, optional
        Largest number of steps in a piece.
    keep : int, optional
        Number of pieces to keep; the oldest ones are deleted.
    """

    seconds: float = 10.0
    rows: int | None = None
    keep: int | None = None


@dataclass(frozen=True)
class WireFile:
    """The content of a file of wires.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    wires : mapping of str to Wire
        The wires by name.
    watchdog : float
        Number of periods without a step after which the safe values are sent.
    pieces : Pieces
        The pieces of the recording.
    """

    path: Path
    wires: Mapping[str, Wire]
    watchdog: float
    pieces: Pieces

    def named(self) -> AbstractContextManager[None]:
        """Put the file before the message of any error of a wire."""
        return Place(str(self.path)).named()

    def recording(self, folder: str | os.PathLike[str] | None) -> Recording | None:
        """Return the settings of a recording in a folder; None without a folder."""
        if folder is None:
            return None
        with (Place(str(self.path)) / "recording").named():
            return Recording(folder, self.pieces.seconds, self.pieces.rows, self.pieces.keep)


def load_wires(path: str | os.PathLike[str]) -> WireFile:
    r"""Read a file of wires and check its content.

    Parameters
    ----------
    path : str or path
        A TOML file, or the name of a shipped one, such as ``"car_by_udp"``. Paths in it begin at its folder. A ``kind`` such as
        ``"my_bridges.py:CanBridge"`` names a class of a user's file, which is executed.

    Returns
    -------
    WireFile
        The wires, not yet open.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or if a key is unknown, missing or of a wrong type. The message names the key and its place.
    BayesFTCError
        If a bridge or wire rejects its settings. The message begins with the place in the file.
    """
    file = find_scenario(path, "wires")
    content, root = read_toml(file), Place(str(file))
    root.refuse_unknown(content, SECTIONS, "section")
    if not content.get("bridge"):
        raise root.error(
            "has no bridge. Add [bridge.<name>] with kind = ... and to = ... (an input) or from = ... (an output)."
        )
    tables = as_table(content["bridge"], root / "bridge")
    watchdog = convert(content.get("watchdog", FEWEST), float, root / "watchdog")
    if not 0 < watchdog < inf:
        raise (root / "watchdog").error(f"is {watchdog:g}; it must be a positive number of periods, and finite.")
    wires = {name: _wire(table, root / "bridge" / name, file.absolute().parent) for name, table in tables.items()}
    pieces: Pieces = build(Pieces, content.get("recording", {}), root / "recording")
    return WireFile(file, wires, float(watchdog), pieces)


def _wire(table: object, place: Place, folder: Path) -> Wire:
    rest = dict(as_table(table, place))
    if not isinstance(rest.get("password", ""), str):
        raise (place / "password").error("is no text; put it in quotes.")  # the usual message would print it
    kind = rest.get("kind")
    if isinstance(kind, str) and ":" in kind:
        with (place / "kind").named():
            cls: Any = own_bridge(kind, folder)
        del rest["kind"]
        _check(cls, place / "kind", kind)
    else:
        cls, rest = choose(BRIDGES, rest, place)
    of_wire = [name for name in settings(Wire) if name not in {"bridge", "source"}]
    place.refuse_unknown(rest, ["from", *of_wire, *settings(cls)])
    given: dict[str, Any] = {}
    if "from" in rest:
        given["source"] = convert(rest.pop("from"), Names, place / "from")
    wire = {name: rest.pop(name) for name in of_wire if name in rest}
    given["bridge"] = _at(build(cls, rest, place, of_kind=True), folder)
    return build(Wire, wire, place, given=given)  # type: ignore[no-any-return]


def _check(cls: type[Bridge], place: Place, kind: str) -> None:
    """Check that the settings of a user's class can be read."""
    if not is_dataclass(cls):
        raise place.error(f"is {kind!r}, which is no dataclass. Write @dataclass(eq=False) above the class.")
    try:
        get_type_hints(cls)
    except NameError as error:
        raise place.error(
            f"is {kind!r}, whose annotations cannot be evaluated ({error}). Import what they name outside of TYPE_CHECKING."
        ) from None


def _at(bridge: Bridge, folder: Path) -> Bridge:
    """Return a bridge whose paths begin at a folder."""
    paths = [f.name for f in fields(bridge) if f.metadata.get("path")]  # type: ignore[arg-type]
    changed = {name: str(folder / getattr(bridge, name)) for name in paths if getattr(bridge, name)}
    return replace(bridge, **changed) if changed else bridge  # type: ignore[type-var]
