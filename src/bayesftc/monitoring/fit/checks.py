"""What a recording must have for a fit, with sentences that name the column."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.settings import FIT
from bayesftc.monitoring.recording import Recording


def check_recording(recording: Recording, y: Floats) -> None:
    """Refuse a recording that no model can be fitted to.

    Parameters
    ----------
    recording : Recording
        Whose sensors are named.
    y : ndarray, steps x sensors
        The stretch of it.

    Raises
    ------
    RecordingError
        If there are too few sensors or samples, one stands still or is a copy, or measures something else.
    """
    names = recording.sensors
    if len(names) < 2:
        raise RecordingError(
            f"A fit needs two or more sensors of the same quantity, but there is only {names[0]!r}; one alone does not tell its "
            "noise from the quantity's motion. Write a model file."
        )
    for name, count in zip(names, np.isfinite(y).sum(axis=0), strict=True):
        if count < FIT.fewest:
            raise RecordingError(
                f"The sensor {name!r} has {count} samples in the stretch; a fit needs {FIT.fewest}. Take a longer stretch, or "
                "leave the sensor out."
            )
    changing = [float(np.mean(np.diff(column[np.isfinite(column)]) != 0)) for column in y.T]
    if max(changing) == 0:
        raise RecordingError("No sensor changes in the stretch, so that there is nothing to fit; take another stretch.")
    for name, share in zip(names, changing, strict=True):
        if share <= FIT.still and max(changing) >= FIT.lively:
            raise RecordingError(
                f"The sensor {name!r} stands still in the stretch while others change; take another stretch, or leave it out."
            )
    _refuse_pairs(y, names)


def _refuse_pairs(y: Floats, names: tuple[str, ...]) -> None:
    """Refuse a copy of a column, sensors that have no samples in common, and one that does not follow the others."""
    sensors = len(names)
    apart = np.full((sensors, sensors), np.nan)
    for i, j in combinations(range(sensors), 2):
        a, b = y[np.isfinite(y[:, i]) & np.isfinite(y[:, j])][:, [i, j]].T
        if not len(a):
            continue
        lively = np.append(False, (np.diff(a) != 0) | (np.diff(b) != 0))
        if lively.any() and np.mean((a == b)[lively]) >= FIT.copied:
            raise RecordingError(
                f"The columns {names[i]!r} and {names[j]!r} are the same samples; leave one of them out."
            )
        apart[i, j] = apart[j, i] = np.median(np.abs(a - b - np.median(a - b)))
    for i, name in enumerate(names):
        others = apart[i][np.isfinite(apart[i])]
        if not len(others):
            raise RecordingError(
                f"The sensor {name!r} has no sample on a step on which another has one, so that they cannot be compared; leave "
                "it out, or write a model file."
            )
    typical = np.array([np.quantile(row[np.isfinite(row)], 0.5, method="lower") for row in apart])
    level = median(y, 1)
    moved = float(np.nanquantile(np.abs(level - np.nanmedian(level)), FIT.far_quantile))
    worst = int(np.argmax(typical))
    column = y[np.isfinite(y[:, worst]), worst]
    noise = float(np.median(np.abs(np.diff(column))))
    if typical[worst] > moved and typical[worst] > FIT.far * noise:
        raise RecordingError(
            f"The column {names[worst]!r} does not follow the others: it differs from them by {typical[worst]:.3g}, and they "
            f"move by {moved:.3g}. Leave it out: name the sensors that measure the same quantity by --sensor."
        )
