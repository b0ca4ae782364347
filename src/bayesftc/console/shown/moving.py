"""The moving picture of a shipped plant, as lines for the page; the outlines are those of animations of runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.console.shown.layout import AnyLane
from bayesftc.cosim.judging.figures.pictures import PICTURES, Line, Picture
from bayesftc.cosim.types import Floats


class Scene:
    """The picture of one lane's plant: its true state, and the state of the belief where the picture compares them.

    Parameters
    ----------
    lane : Lane
        The lane.
    """

    def __init__(self, lane: AnyLane):
        self._lane = lane
        self._block, self._picture, lengths = "", None, {}
        for block, plant in lane.plants.items():
            picture = PICTURES.get(plant["model"])
            if picture and all(f"{block}.{name}" in lane.place for name in picture.variables):
                self._block, self._picture, lengths = block, picture, plant["parameters"]
        self._constants: dict[str, float] = {}
        if self._picture is not None:
            known = self._picture.lengths
            self._constants = {
                **known,
                **{name: value for name, value in lengths.items() if name in known},
                "size": 0.1,
            }
        self._seen = 0
        self._angle = 0.0

    @property
    def exists(self) -> bool:
        """Whether there is a picture of this plant."""
        return self._picture is not None

    def lines(self) -> dict[str, Any] | None:
        """Return the lines at the present step, and the window that they fit into; None without a picture or rows."""
        picture, row = self._picture, self._lane.rows.newest
        if picture is None or row is None:
            return None
        state = {name: float(row[self._lane.place[f"{self._block}.{name}"]]) for name in picture.variables}
        if not all(map(np.isfinite, state.values())):
            return None
        size = max([abs(state[name]) for name in picture.sized], default=0.0)
        self._constants["size"] = max(self._constants["size"], size)
        if picture.turning:
            self._turn(picture)
            state["turned"] = self._angle
        layers = {"truth": picture.moving({**state, **self._constants})}
        if picture.compared and (belief := self._belief(picture, state, row)):
            layers["belief"] = picture.moving({**belief, **self._constants})
        fixed = picture.fixed(self._constants)
        window = picture.window(self._constants) if picture.window else self._around()
        return {"window": window, "fixed": _plain(fixed), **{name: _plain(lines) for name, lines in layers.items()}}

    def _turn(self, picture: Picture) -> None:
        """Turn what turns: by the distance that was covered since the last picture."""
        rows, seen = self._lane.rows, self._seen
        column = self._lane.place[f"{self._block}.{picture.turning}"]
        self._angle += float(np.nansum(rows.of(seen + 1, rows.last, [column]).values)) * float(self._lane.step)
        self._angle %= 2e4 * np.pi
        self._seen = rows.last

    def _belief(self, picture: Picture, truth: dict[str, float], row: Floats) -> dict[str, float] | None:
        """Return the state with what the controller estimates in place of what is true."""
        lane, known = self._lane, {}
        for quantity in lane.roles.quantities:
            if quantity.belief is None or not quantity.truth or len(quantity.truth) != 1:
                continue
            name = quantity.truth[0][1][0].removeprefix(f"{self._block}.")
            terms = [
                (w, lane.place.get(f"{lane.roles.controller}.x_hat[{j}]")) for j, w in enumerate(quantity.belief) if w
            ]
            if name in picture.variables and all(place is not None for _, place in terms):
                known[name] = float(sum(w * row[place] for w, place in terms))
        return {**truth, **known} if known and all(map(np.isfinite, known.values())) else None

    def _around(self) -> tuple[float, float, float, float]:
        reach = 1.15 * sum(value for name, value in self._constants.items() if name != "size")
        return -reach, reach, -reach, reach


def _plain(lines: list[Line]) -> list[list[float]]:
    """Return each line as its coordinates, x and y in turn, rounded."""
    return [np.round(np.column_stack(line).ravel(), 4).tolist() for line in lines]


__all__ = ["Scene"]
