"""Pictures of the shipped plants: the outlines of a car, an arm, a shaft, two masses, a pendulum and a turbine in a given state.

A picture is a list of lines in the plane. It has the same number of lines in each state, so that an animation moves them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesftc.cosim.types import Floats

Line = tuple[Floats, Floats]
"""The horizontal and the vertical coordinates of the points of a line."""


@dataclass(frozen=True)
class Picture:
    """How to draw one model.

    Attributes
    ----------
    variables : tuple of str
        The outputs that the picture needs.
    moving : callable
        Returns the lines of one state, given the variables, the lengths, and ``size``: the largest distance from zero in the run.
    fixed : callable
        Returns the lines that do not move, given the lengths and ``size``.
    window : callable or None
        Returns the limits of the axes, given the lengths and ``size``: left, right, bottom, top. If it is None, all true states
        of the run fit into the axes.
    lengths : mapping of str to float
        Parameters of the model that the picture needs, with their start values.
    compared : bool
        Whether the state of the belief and the readings of the sensors are drawn as well.
    turning : str or None
        A variable whose integral moves something, such as a speed. ``moving`` gets it as ``turned``, scaled so that it changes
        by at most 1 between two pictures.
    sized : tuple of str
        The variables that ``size`` is about.
    """

    variables: tuple[str, ...]
    moving: Callable[[Mapping[str, float]], list[Line]]
    fixed: Callable[[Mapping[str, float]], list[Line]]
    window: Callable[[Mapping[str, float]], tuple[float, float, float, float]] | None
    lengths: Mapping[str, float] = field(default_factory=dict)
    compared: bool = True
    turning: str | None = None
    sized: tuple[str, ...] = ()


def _line(*points: tuple[float, float]) -> Line:
    x, y = np.array(points, dtype=np.float64).T
    return x, y


def _box(x: float, y: float, width: float, height: float) -> Line:
    """Return a rectangle around a point."""
    a, b = 0.5 * width, 0.5 * height
    return _line((x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b), (x - a, y - b))


def _circle(x: float, y: float, radius: float) -> Line:
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    return x + radius * np.cos(angle), y + radius * np.sin(angle)


def _spoke(x: float, y: float, radius: float, angle: float, inner: float = 0.0) -> Line:
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return _line((x + inner * c, y + inner * s), (x + radius * c, y + radius * s))


def _spring(start: float, end: float, y: float, height: float, coils: int = 7) -> Line:
    """Return a zigzag between two places."""
    x = np.linspace(start, end, 2 * coils + 2)
    zigzag = np.array([0.0, *[height * (-1.0) ** k for k in range(2 * coils)], 0.0])
    return x, y + zigzag


def _car(v: Mapping[str, float]) -> list[Line]:
    body = _line(
        (-2.2, 0.35),
        (2.2, 0.35),
        (2.2, 0.9),
        (1.3, 1.0),
        (0.7, 1.6),
        (-1.0, 1.6),
        (-1.7, 1.0),
        (-2.2, 0.95),
        (-2.2, 0.35),
    )
    angle = -0.6 * v["turned"]
    wheels = [part for x in (-1.3, 1.3) for part in (_circle(x, 0.35, 0.35), _spoke(x, 0.35, 0.35, angle, -0.35))]
    begin = -4.0 - (0.6 * v["turned"]) % 2.0
    marks = [_line((begin + 2.0 * k, -0.25), (begin + 2.0 * k + 0.8, -0.25)) for k in range(5)]
    return [body, *wheels, *marks]


def _arm(v: Mapping[str, float]) -> list[Line]:
    elbow = v["L1"] * np.cos(v["q1"]), v["L1"] * np.sin(v["q1"])
    whole = v["q1"] + v["q2"]
    end = elbow[0] + v["L2"] * np.cos(whole), elbow[1] + v["L2"] * np.sin(whole)
    return [_line((0.0, 0.0), elbow, end), _circle(*elbow, 0.05), _circle(*end, 0.05)]


def _masses(v: Mapping[str, float]) -> list[Line]:
    w = v["size"]
    first, second = v["x1"] - 1.5 * w, v["x2"] + 1.5 * w
    spring = _spring(first + 0.5 * w, second - 0.5 * w, 0.5 * w, 0.2 * w)
    return [_box(first, 0.5 * w, w, w), _box(second, 0.5 * w, w, w), spring]


def _pendulum(v: Mapping[str, float]) -> list[Line]:
    x, rod = v["position"], 2.0 * v["l"]
    end = x + rod * np.sin(v["angle"]), 0.16 + rod * np.cos(v["angle"])
    return [
        _box(x, 0.11, 0.3, 0.1),
        _circle(x - 0.09, 0.03, 0.03),
        _circle(x + 0.09, 0.03, 0.03),
        _line((x, 0.16), end),
        _circle(*end, 0.04),
    ]


def _turbine(v: Mapping[str, float]) -> list[Line]:
    opened = 0.4 * max(min(v["gate"], 1.0), 0.0)
    half = 0.16 * max(min(v["flow"], 1.2), 0.02)
    water = _line((3.0, 0.4 - half), (3.55, 0.4 - half), (3.55, 0.4 + half), (3.0, 0.4 + half), (3.0, 0.4 - half))
    gate = _line((2.7, 0.2 + opened), (2.7, 1.1))
    wheel = [_spoke(4.0, 0.1, 0.45, 0.25 * np.pi * k - 0.4 * v["turned"]) for k in range(8)]
    return [gate, water, *wheel]


PICTURES: dict[str, Picture] = {
    "CruiseControl": Picture(
        variables=("v",),
        moving=_car,
        fixed=lambda v: [_line((-3.6, 0.0), (3.6, 0.0))],
        window=lambda v: (-3.4, 3.4, -0.6, 2.2),
        compared=False,
        turning="v",
    ),
    "TwoLinkArm": Picture(
        variables=("q1", "q2"),
        moving=_arm,
        fixed=lambda v: [_box(0.0, -0.04, 0.3, 0.08)],
        window=None,
        lengths={"L1": 1.0446, "L2": 1.0111},
    ),
    "PositionServo": Picture(
        variables=("angle",),
        moving=lambda v: [_spoke(0.0, 0.0, 1.0, 0.5 * np.pi + v["angle"]), _circle(0.0, 0.0, 0.08)],
        fixed=lambda v: [_circle(0.0, 0.0, 1.08), *(_spoke(0.0, 0.0, 1.18, np.pi * k / 6, 1.08) for k in range(12))],
        window=lambda v: (-1.3, 1.3, -1.3, 1.3),
    ),
    "TwoMasses": Picture(
        variables=("x1", "x2"),
        moving=_masses,
        fixed=lambda v: [_line((-4.5 * v["size"], 0.0), (4.5 * v["size"], 0.0))],
        window=lambda v: (-3.6 * v["size"], 3.6 * v["size"], -0.4 * v["size"], 1.8 * v["size"]),
        sized=("x1", "x2"),
    ),
    "CartPendulum": Picture(
        variables=("position", "angle"),
        moving=_pendulum,
        fixed=lambda v: [_line((-v["size"] - 2.0, 0.0), (v["size"] + 2.0, 0.0))],
        window=lambda v: (-v["size"] - 0.4, v["size"] + 0.4, -0.1, 2.0 * v["l"] + 0.3),
        lengths={"l": 0.3},
        sized=("position",),
    ),
    "HydroTurbine": Picture(
        variables=("gate", "flow"),
        moving=_turbine,
        fixed=lambda v: [
            _line(
                (-1.0, 3.0), (-1.0, 1.6), (0.0, 1.6), (2.2, 0.2), (3.0, 0.2)
            ),  # a reservoir, and the penstock below it
            _line((0.0, 3.0), (0.0, 2.1), (2.3, 0.6), (3.0, 0.6)),
            _line((-1.0, 2.8), (0.0, 2.8)),
            _circle(4.0, 0.1, 0.45),
        ],
        window=lambda v: (-1.2, 4.7, -0.5, 3.1),
        compared=False,
        turning="flow",
    ),
}
"""The picture of each shipped plant, by the name of its model."""

__all__ = ["PICTURES", "Line", "Picture"]
