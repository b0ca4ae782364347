"""What viewers get: for each, the rows since the last frame, and once for all the state of the desk."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from math import inf, isfinite
from time import monotonic
from typing import Any

import numpy as np

from bayesftc.console.desk.actions import time_of
from bayesftc.console.desk.desk import Desk
from bayesftc.console.desk.engine import Engine
from bayesftc.console.desk.history import Recorded, Rows
from bayesftc.console.desk.live import LiveRun
from bayesftc.console.shown.frames import packed, thinned
from bayesftc.console.shown.layout import AnyLane, layout
from bayesftc.console.shown.moving import Scene
from bayesftc.console.shown.words import cards
from bayesftc.cosim.types import Floats

MOST_NEW, MOST_OLD = 256, 3000
"""Most rows of a frame, for rows that are new and for all rows at the beginning."""
MOST_EXTRA = 12
"""Most signals that a viewer can add to those of the strips."""
PAUSE = 0.5
"""Seconds between two choices of further signals by a viewer."""
KEPT = 8


@dataclass(frozen=True, eq=False)
class View:
    """The lanes at one epoch, with their layout; made in the engine's thread, read by others."""

    epoch: int
    lanes: tuple[AnyLane, ...]
    layout: dict[str, Any]
    scenes: tuple[Scene, ...]
    shown: tuple[str, ...]


class Broadcast:
    """Makes the frames of all viewers.

    Parameters
    ----------
    engine : Engine
        The engine, whose desk is shown.
    """

    def __init__(self, engine: Engine | LiveRun):
        self._engine = engine
        self._header: tuple[Any, dict[str, Any]] = (None, {})
        self._frames: OrderedDict[Any, bytes] = OrderedDict()

    def frame(self, view: View, cursor: Cursor) -> bytes | None:
        """Return the next frame of a viewer; None if nothing has changed for it."""
        cursor.choose()
        if cursor.epoch != view.epoch:
            cursor.begin(view)
        engine, rows = self._engine, [lane.rows for lane in view.lanes]  # once: the engine goes on meanwhile
        running = [each.last for each, lane in zip(rows, view.lanes, strict=True) if lane.stopped is None]
        last = min(running) if running else max(each.last for each in rows)
        key = (view.epoch, last, engine.running, engine.pace, engine.busy, len(running))
        if cursor.key == key and not cursor.is_new:
            return None
        whole = (key, cursor.is_new, cursor.sent, cursor.extra)
        if whole not in self._frames:
            begin = max(cursor.sent + 1, rows[0].first)
            chosen = self._chosen(view, cursor, rows, begin, last)
            frame = thinned(Rows(chosen, begin), MOST_OLD if cursor.is_new else MOST_NEW)
            names = [[i, name] for i in range(len(view.lanes)) for name in self._names(view, cursor, i)]
            more = {"reset": True, "columns": names} if cursor.is_new else {}
            self._frames[whole] = packed({**self._state(view, key), **more}, *frame)
            while len(self._frames) > KEPT:
                self._frames.popitem(last=False)
        cursor.key, cursor.is_new, cursor.sent = key, False, last
        return self._frames[whole]

    def _names(self, view: View, cursor: Cursor, lane: int) -> list[str]:
        return [name for name in (*view.shown, *cursor.extra) if name in view.lanes[lane].place]

    def _chosen(self, view: View, cursor: Cursor, rows: list[Recorded], begin: int, last: int) -> Floats:
        """Return the shown columns of all lanes side by side; missing (NaN) where a lane has no row."""
        parts = []
        for i, (lane, each) in enumerate(zip(view.lanes, rows, strict=True)):
            new = each.of(begin, last, [lane.place[name] for name in self._names(view, cursor, i)])
            values = new.values
            if len(values) != max(last - begin + 1, 0):
                padded = np.full((max(last - begin + 1, 0), values.shape[1]), np.nan)
                padded[new.first - begin : new.first - begin + len(values)] = values
                values = padded
            parts.append(values)
        return np.concatenate(parts, axis=1)

    def _state(self, view: View, key: Any) -> dict[str, Any]:
        """Return the state of the desk, once for all viewers."""
        if self._header[0] != key:
            engine, lane, k = self._engine, view.lanes[0], key[1]
            step = float(lane.step)
            self._header = (
                key,
                {
                    "type": "rows",
                    "epoch": view.epoch,
                    "k": k,
                    "t": time_of(k, lane.step),
                    "furthest": max(k, engine.desk.branch.furthest if engine.desk is not None else 0),
                    "running": engine.running,
                    "pace": engine.pace if isfinite(engine.pace) else None,
                    "late": engine.late,
                    "busy": engine.busy,
                    "wires": engine.wires(),
                    "actions": engine.actions(),
                    "cards": cards(lane),
                    "scenes": [scene.lines() for scene in view.scenes],
                    "stopped": [each.stopped for each in view.lanes],
                    "alarms": [
                        {"t": a.k * step, "device": a.device, "number": a.number, "begins": a.begins}
                        for a in lane.alarms[-100:]
                    ],
                },
            )
        return self._header[1]


class Cursor:
    """What one viewer has got."""

    def __init__(self) -> None:
        self.epoch = -1
        self.sent = -1
        self.is_new = True
        self.key: Any = None
        self.extra: tuple[str, ...] = ()
        self.wanted: tuple[str, ...] = ()
        self._chosen = -inf

    def choose(self) -> None:
        """Begin anew with the further signals that the viewer wants, but not too often: all rows are sent again then."""
        now = monotonic()
        if self.wanted != self.extra and now - self._chosen >= PAUSE:
            self.extra, self._chosen, self.epoch = self.wanted, now, -1

    def begin(self, view: View) -> None:
        """Begin anew with the rows of a view."""
        self.epoch, self.is_new, self.sent = view.epoch, True, -1


def view_of(desk: Desk) -> View:
    """Return the present view of a desk; call it in the engine's thread."""
    plan = layout(desk)
    lanes = (*desk.branch.lanes, *((desk.compared.lanes[0],) if desk.compared else ()))
    names = [series["column"] for strip in plan["strips"] for series in strip["series"]]
    names += [each["column"] for each in (*plan["devices"], *plan["goals"]) if each["column"]]
    names += [f"{fault['name']}.active" for fault in plan["faults"]]
    return View(desk.epoch, lanes, plan, tuple(Scene(lane) for lane in lanes), tuple(dict.fromkeys(names)))


__all__ = ["MOST_EXTRA", "Broadcast", "Cursor", "View", "view_of"]
