"""Check that a model can be fitted to a recording, with messages that name the column."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.bias import changes, unmoved
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.settings import FIT
from bayesftc.monitoring.recording import Recording


def check_recording(recording: Recording, y: Floats) -> None:
    """Raise an error if no model can be fitted to a recording.

    Parameters
    ----------
    recording : Recording
        Gives the names of the sensors.
    y : ndarray, steps x sensors
        Samples of the stretch.

    Raises
    ------
    RecordingError
        If there are too few sensors or samples, or if a sensor does not change, is a copy, or measures another quantity.
    """
    names = recording.sensors
    if len(names) < 2:
        raise RecordingError(
            f"A fit needs two or more sensors of the same quantity, but there is only {names[0]!r}. With one sensor, noise and "
            "the quantity's motion cannot be separated. Write a model file (bayesftc example model)."
        )
    for name, count in zip(names, np.isfinite(y).sum(axis=0), strict=True):
        if count < FIT.fewest:
            raise RecordingError(
                f"The sensor {name!r} has {count} samples in the stretch; a fit needs {FIT.fewest}. Choose a longer stretch, or "
                "leave out the sensor."
            )
    changing = [float(np.mean(np.diff(column[np.isfinite(column)]) != 0)) for column in y.T]
    if max(changing) == 0:
        raise RecordingError("No sensor changes in the stretch, so there is nothing to fit. Choose another stretch.")
    for name, share in zip(names, changing, strict=True):
        if share <= FIT.still and max(changing) >= FIT.lively:
            raise RecordingError(
                f"The sensor {name!r} does not change in the stretch, but others do. Choose another stretch, or leave it out."
            )
    _refuse_pairs(_without_changes(y), names)


def _without_changes(y: Floats) -> Floats:
    """Return samples without those of each sensor that has long followed the others, and then moved away for good."""
    noise = [float(np.median(np.abs(np.diff(column[np.isfinite(column)])))) for column in y.T]
    late = {i: change for i, change in changes(y, noise).items() if change.begin >= FIT.followed * len(y)}
    return unmoved(y, late, slice(0, None))


def _refuse_pairs(y: Floats, names: tuple[str, ...]) -> None:
    """Raise an error for a copied column, a sensor without common samples, or one that does not follow the others."""
    sensors = len(names)
    apart = np.full((sensors, sensors), np.nan)
    for i, j in combinations(range(sensors), 2):
        a, b = y[np.isfinite(y[:, i]) & np.isfinite(y[:, j])][:, [i, j]].T
        if not len(a):
            continue
        lively = np.append(False, (np.diff(a) != 0) | (np.diff(b) != 0))
        if lively.any() and np.mean((a == b)[lively]) >= FIT.copied:
            raise RecordingError(
                f"The columns {names[i]!r} and {names[j]!r} have the same samples. Leave out one of them."
            )
        apart[i, j] = apart[j, i] = np.median(np.abs(a - b - np.median(a - b)))
    for i, name in enumerate(names):
        others = apart[i][np.isfinite(apart[i])]
        if not len(others):
            raise RecordingError(
                f"The sensor {name!r} cannot be compared: at no step do it and another sensor both have a sample. Leave it out, "
                "or write a model file."
            )
    typical = np.array([np.quantile(row[np.isfinite(row)], 0.5, method="lower") for row in apart])
    level = median(y, 1)
    moved = float(np.nanquantile(np.abs(level - np.nanmedian(level)), FIT.far_quantile))
    worst = int(np.argmax(typical))
    column = y[np.isfinite(y[:, worst]), worst]
    noise = float(np.median(np.abs(np.diff(column))))
    if typical[worst] > moved and typical[worst] > FIT.far * noise:
        sums = y[:, worst] + median(np.delete(y, worst, axis=1), 1)
        constant = float(np.nanmedian(sums))
        if np.nanmedian(np.abs(sums - constant)) < moved / 2.0:
            raise RecordingError(
                f"The column {names[worst]!r} moves the other way than the others. Fit these (name them with --sensor), and then "
                f"add it to the model file as [sensors.{names[worst]!r}] with gain = -1.0, bias = {constant:.4g}, and its std."
            )
        raise RecordingError(
            f"The column {names[worst]!r} does not follow the others: it differs from them by {typical[worst]:.3g}, but they "
            f"move by {moved:.3g}. If it has failed in this recording, fit to a stretch without the fault: --from and --to, in "
            "seconds. If it measures another quantity, leave it out: name the others with --sensor."
        )
