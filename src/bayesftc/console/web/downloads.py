"""The files of a run that a page can download. Signals and figure come from one more run of the same scenario."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.console.desk.events import Event, as_csv
from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError, SimulationError, brief
from bayesftc.scenario._scenario import scenario_of
from bayesftc.scenario._written import toml

if TYPE_CHECKING:
    from bayesftc.console.desk.desk import Desk
    from bayesftc.cosim.run.result import Result


PART = 10_000
"""Rows of a CSV file between two looks whether anybody waits for it."""


@dataclass(frozen=True)
class Kept:
    """What downloads are made of.

    Attributes
    ----------
    name : str
        Beginning of the names of files.
    content : mapping
        The scenario up to the present step.
    file : Path
        The scenario's file, for messages.
    events : tuple of Event
        The events of the session.
    is_over : callable
        Returns whether nobody waits for the file any more.
    """

    name: str
    content: Mapping[str, Any]
    file: Path
    events: tuple[Event, ...]
    is_over: Callable[[], bool]

    def run(self) -> Result:
        """Run once more, with all signals at all steps; a run that stops has its signals up to there."""
        try:
            return scenario_of(self.content, self.file).simulate(record=["*"], decimation=1, progress=self.check)
        except SimulationError as error:
            if error.result is None:
                raise
            return error.result

    def check(self, *progress: int) -> None:
        """Stop the work if nobody waits for it.

        Raises
        ------
        ModelError
            If that is so.
        """
        if self.is_over():
            raise ModelError("The console has ended.")


def kept_of(desk: Desk, lane: str, is_over: Callable[[], bool]) -> Kept:
    """Return what there is to download of one controller; call it in the engine's thread.

    Raises
    ------
    ModelError
        If there is no such lane.
    """
    lanes = desk.branch.lanes
    if lane not in map(str, range(len(lanes))):
        raise ModelError(f"There is no controller {brief(lane)}; use lane=0 to lane={len(lanes) - 1}.")
    number = int(lane)
    name = f"{desk.name}_{lanes[number].name}" if number else desk.name
    return Kept(name, desk.scenario_content(number), desk.file, desk.events.all(), is_over)


def _toml(kept: Kept) -> bytes:
    head = (
        f"# The scenario {kept.name} with what was done by hand. The same run once more:\n#\n#   bayesftc run FILE\n\n"
    )
    return (head + toml(kept.content)).encode()


def _csv(kept: Kept) -> bytes:
    table = kept.run().to_pandas()
    text = io.StringIO()
    for begin in range(0, len(table), PART):
        kept.check()
        table[begin : begin + PART].to_csv(text, header=begin == 0)
    return text.getvalue().encode()


def _parquet(kept: Kept) -> bytes:
    extra("pyarrow.parquet", "A Parquet file")
    data = io.BytesIO()
    kept.run().to_pandas().to_parquet(data)
    return data.getvalue()


def _figure(kept: Kept) -> bytes:
    data = io.BytesIO()
    kept.run().plot().savefig(data, dpi=150, format="png")
    return data.getvalue()


def _events(kept: Kept) -> bytes:
    return as_csv(kept.events).encode()


EVENTS = "events.csv"

DOWNLOADS: Mapping[str, tuple[str, Callable[[Kept], bytes]]] = {
    "scenario.toml": ("application/toml", _toml),
    "signals.csv": ("text/csv; charset=utf-8", _csv),
    "signals.parquet": ("application/vnd.apache.parquet", _parquet),
    "figure.png": ("image/png", _figure),
    EVENTS: ("text/csv; charset=utf-8", _events),
}
"""For each file its type, and the function that returns its content."""


def file_name(name: str, of: str) -> str:
    """Return the name of a downloaded file of a scenario."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in name)[:80]
    return f"{plain}_{of}"


__all__ = ["DOWNLOADS", "EVENTS", "Kept", "file_name", "kept_of"]
