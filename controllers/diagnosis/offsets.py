"""Constant offsets of all sensors of a quantity, as of gyros, which no comparison of these sensors with each other shows.

An offset is a further constant state of the model (`LinearModel.with_sensor_errors`). Innovations are linear in the samples, so
that a fit to their responses gives its size.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.judge import EVIDENCE, Explanation, Judge
from bayesftc.controllers.models.disturbances import error_variances

if TYPE_CHECKING:
    from bayesftc.cosim.types import Floats

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


__all__ = ["offsets"]
