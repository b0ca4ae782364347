"""Offsets and delays of all sensors of a quantity, as of gyros, which no comparison of these sensors with each other shows.

An offset is a further constant state of the model (`LinearModel.with_sensor_errors`). Innovations are linear in the samples, so
that a fit to their responses gives its size. Samples that are late belong to an earlier state of the plant.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.judge import EVIDENCE, Explanation, Judge
from bayesftc.controllers.diagnosis.slow_sensors import Presence
from bayesftc.controllers.models.disturbances import error_variances

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

LATEST = 40
"""Longest delay of sensors to try, in samples."""

VISIBLE = 1e-6
"""Share of the response to an offset that must not look like another start of the plant; else it is a shift of the state."""


def offsets(judge: Judge) -> list[Explanation]:
    """Return the best explanation by offsets, of the sensors of as few quantities as possible; none if no offset is visible.

    Quantities with a sensor whose error the model estimates already are left out.
    """
    rows = np.eye(judge.model.sensors)
    responses = np.stack([judge.offset(row) for row in rows], axis=1)
    seen = [_visible(judge, responses[:, i : i + 1]) for i in range(len(rows))]
    errors = judge.model.moving.matrix("C")[:, error_variances(judge.model) > 0.0]
    left = [group for group in judge.model.alike if all(seen[i] and not errors[i].any() for i in group)]
    found: list[Explanation] = []
    chosen: tuple[Floats, ...] = ()
    while left:
        tried = [
            (_fitted(judge, responses, (*chosen, shape)), group, shape)
            for group in left
            for shape in _shapes(rows[list(group)])
        ]
        best, group, shape = max(tried, key=lambda each: each[0].total)
        if found and best.total < found[0].total + EVIDENCE:
            break
        found, chosen = [best], (*chosen, shape)
        left.remove(group)
    return found


def late_sensors(judge: Judge) -> list[Explanation]:
    """Return the best delay of all sensors of a quantity, or of all quantities but one; none of a single quantity.

    If all sensors are late, all controls act late. Only a recording that is ten times as long as a delay is judged with it.
    """
    groups, most = judge.model.alike, min(LATEST, len(judge.recording.y) // 10)
    sizes = {1, len(groups) - 1} if len(groups) > 1 and most else set()
    late = [sum(chosen, ()) for size in sorted(sizes) for chosen in combinations(groups, size)]
    if not late:
        return []

    @cache
    def loss(sensors: tuple[int, ...], steps: int) -> float:
        """Return the loss of a sample: with a delay, fewer samples have a partner."""
        early = _judge(judge, _within(_earlier(judge.recording.y, sensors, steps), steps))
        return float((early.first[:, 0] / early.rows).sum())

    coarse = sorted({round(1.5**k) for k in range(most) if 1.5**k <= most})
    sensors, steps = min(product(late, coarse), key=lambda each: loss(*each))
    for width in (8, 4, 2, 1):
        near = [k for k in (steps - width, steps, steps + width) if 0 < k <= most]
        steps = min(near, key=lambda k: loss(sensors, k))
    early = _judge(judge, _within(_earlier(judge.recording.y, sensors, steps), steps))
    seconds = steps * float(judge.model.step) * np.isin(np.arange(judge.model.sensors), sensors)
    costs = early.first, early.first_squares
    return _judge(judge, _within(judge.recording.y, steps)).of("late_sensors", [tuple(map(float, seconds))], costs)


def _judge(judge: Judge, y: Floats) -> Judge:
    """Return a judge of other samples."""
    presence = None if judge.recording.presence is None else Presence(np.isfinite(y))
    return Judge(judge.model, judge.bank, replace(judge.recording, y=y, presence=presence))


def _within(y: Floats, steps: int) -> Floats:
    """Return samples without the first and the last ones: with and without a delay, the same instants are compared."""
    inner = y.copy()
    inner[:steps] = inner[len(y) - steps :] = np.nan
    return inner


def _earlier(y: Floats, sensors: tuple[int, ...], steps: int) -> Floats:
    """Return samples of which those of some sensors are of earlier instants; the last ones are missing."""
    earlier = y.copy()
    earlier[:, sensors] = np.nan
    earlier[: len(y) - steps, sensors] = y[steps:, sensors]
    return earlier


def _shapes(of_group: Floats) -> list[Floats]:
    """Return the offsets that a quantity's sensors may have: a common one, or, of several sensors, one each."""
    common = of_group.sum(axis=0)[np.newaxis]
    return [common] if len(of_group) == 1 else [common, of_group]


def _visible(judge: Judge, response: Floats) -> bool:
    """Return whether the sensors tell an offset from another start of the plant."""
    sets = range(len(judge.bank))
    whole = [np.sum(judge.part(response, k) ** 2) for k in sets]
    rest = [np.sum(judge.free(response, k, judge.begin) ** 2) for k in sets]
    return bool(np.sum(rest) > VISIBLE**2 * np.sum(whole))


def _fitted(judge: Judge, responses: Floats, shapes: tuple[Floats, ...]) -> Explanation:
    """Fit offsets, each of some sensors; the values are those of all sensors, zero for the others."""
    together = np.concatenate(shapes)
    without = -np.tensordot(responses, together, axes=(1, 1)).transpose(0, 3, 1, 2)  # the readings less an offset of 1
    return judge.fitted("offset", without, together)


__all__ = ["late_sensors", "offsets"]
