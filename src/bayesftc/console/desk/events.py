"""The events of a session at the console, in the order in which they happened."""

from __future__ import annotations

import csv
import io
from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

MOST = 20_000
"""Number of events that are kept; older ones are dropped."""

What = Literal["action", "alarm", "branch", "run", "viewer"]
COLUMNS = ("clock", "time", "branch", "what", "event")
FORMULA = ("=", "+", "-", "@")
"""Beginnings of a text that a spreadsheet would compute."""


@dataclass(frozen=True)
class Event:
    """One event.

    Attributes
    ----------
    clock : datetime
        When it happened.
    what : str
        ``"action"`` of the operator, ``"alarm"`` of a controller, ``"branch"``, ``"run"`` (continue, pause, pace), ``"viewer"``.
    words : str
        What happened.
    branch : str
        The branch that ran.
    time : float or None
        The time of the run in seconds; None while no run is loaded.
    """

    clock: datetime
    what: What
    words: str
    branch: str = ""
    time: float | None = None


class Events:
    """The last events of a session. Any thread may add to them and read them."""

    def __init__(self) -> None:
        self._kept: deque[Event] = deque(maxlen=MOST)

    def add(self, what: What, words: str, branch: str = "", time: float | None = None) -> None:
        """Add an event that happens now."""
        self._kept.append(Event(datetime.now(UTC), what, words, branch, time))

    def all(self) -> tuple[Event, ...]:
        """Return the events."""
        return tuple(self._kept.copy())


def as_csv(events: tuple[Event, ...]) -> str:
    """Return events as the text of a CSV file, with the time of the clock in UTC."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for each in events:
        time = "" if each.time is None else repr(each.time)
        rows.writerow(
            (each.clock.isoformat(timespec="milliseconds"), time, *map(_harmless, (each.branch, each.what, each.words)))
        )
    return text.getvalue()


def _harmless(text: str) -> str:
    return f"'{text}" if text.startswith(FORMULA) else text


__all__ = ["Event", "Events", "What", "as_csv"]
