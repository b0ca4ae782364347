"""A run without the samples of blamed sensors: they may be all that is wrong, or a wrong model makes them look so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.best import sets_without
from bayesftc.controllers.diagnosis.finding import ModelFinding
from bayesftc.controllers.diagnosis.healthy_stretches import WINDOW
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.judging.metrics import periods
from bayesftc.cosim.judging.signals import ALARM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.cosim.types import Floats

OF_FAULTS = {"offset", "noise"}
"""Kinds that several faulty sensors look like."""

RARELY = 0.01
"""Share of the samples up to which a sensor counts as never blamed, and in which all may be while some are said to be faulty."""

MOSTLY = 0.5
"""Share of a run from which on a blamed sensor is left out of all of it."""

OFTEN = 0.2
"""Least share of the time for which the most blamed sensor is blamed, for another one to be faulty as well."""


def of_faults(
    result: ModelFinding,
    model: LinearModel,
    samples: Floats,
    probability: Floats,
    found: Callable[..., ModelFinding | None],
    words: Callable[..., str],
) -> ModelFinding | None:
    """Return the finding without the samples of blamed sensors, where these may be all that is wrong; else None.

    `probability` has the fault probability of each sensor, if it was recorded; `words` are those of `faulty_sensors`.
    """
    blamed = _blamed(model, probability, samples, together=result.kind in {"unknown", *OF_FAULTS})
    left = None if blamed is None else _without_blamed(model, samples, blamed, found, words)
    if left is None or (result.kind != "unknown" and left.kind != "sensors"):
        return None
    return left if result.kind == "unknown" else replace(left, others=(result.kind, *result.others))


def _blamed(model: LinearModel, probability: Floats, samples: Floats, *, together: bool) -> NDArray[np.bool_] | None:
    """Return which samples the controller blames, if of several sensors, but hardly ever of all; else None.

    One faulty sensor beside others of its quantity is no evidence against the model, because the others agree with it. The only
    one of its quantity is, because each set needs it. Without all sensors there is no evidence at all. Several sensors count if
    another one is hardly ever blamed, or, with `together`, also if several are blamed at once.
    `_without_blamed` decides whether they are all that is wrong.
    """
    if not len(probability):
        return None
    blamed = probability.reshape(len(probability), -1) >= ALARM
    if blamed.shape != np.shape(samples):
        return None
    count = blamed.sum(axis=1)
    every = count == blamed.shape[1]
    often = blamed.mean(axis=0) > RARELY
    several = 1 < np.sum(often) < len(often) or (together and np.any((count > 1) & ~every))
    return blamed if (several or _only(model, blamed) is not None) and np.mean(every) < RARELY else None


def _only(model: LinearModel, blamed: NDArray[np.bool_]) -> int | None:
    """Return the sensor that alone is blamed for long, if no other one measures its quantity."""
    often = tuple(np.flatnonzero(blamed.mean(axis=0) > RARELY).tolist())
    return often[0] if len(often) == 1 and often in model.proportional else None


def _without_blamed(
    model: LinearModel,
    samples: Floats,
    blamed: NDArray[np.bool_],
    found: Callable[..., ModelFinding | None],
    words: Callable[..., str],
) -> ModelFinding | None:
    """Return the finding without the samples of the sensors that are blamed for long, or else of all; None if it is no better.

    Sensors that are blamed for a moment beside one that is blamed for long may be healthy: they are not named. Without the only
    sensor of a quantity, all samples of the others must count while it is blamed: else a load that acts then would be hidden.
    Its own are left out for a `WINDOW` more on both sides: it is blamed only after some faulty samples.
    """
    only = {} if _only(model, blamed) is None else {"each": True}
    margin = WINDOW if only else 0
    shares = blamed.mean(axis=0)
    named = np.flatnonzero(shares > OFTEN * shares.max()).tolist()
    for chosen in dict.fromkeys((tuple(named), tuple(np.flatnonzero(shares).tolist()))):
        trusted = _trusted(model, samples, _wider(blamed, margin) & np.isin(np.arange(len(shares)), chosen))
        left = None if trusted is None else found(trusted, **only)
        if trusted is not None and left is None:
            count = blamed[:, named].sum(axis=1)
            together = int(np.median(count[count > 0]))
            partner = not any(group == tuple(named) for group in model.alike)
            others = bool(np.count_nonzero(shares) > len(named))
            times = _times(model, blamed[:, named[0]]) if only else ()
            alone = len(chosen) == len(named)
            said = words(
                named, together=together, alone=alone, partner=partner, others=others, times=times, names=model.names
            )
            return ModelFinding("sensors" if len(named) > 1 or not partner else "unknown", said)
        if left is not None and left.kind != "unknown":
            return left
    return None


def _times(model: LinearModel, blamed: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return from when to when a sensor is blamed for long, in seconds after the first sample; infinity: to the last one."""
    found = periods(blamed)
    least = OFTEN * max(end - begin for begin, end in found)
    step = float(model.step)
    return [(begin * step, end * step if end < len(blamed) else np.inf) for begin, end in found if end - begin >= least]


def _wider(flags: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Return flags (T x m) that are also true up to `margin` samples before and after each true one."""
    wider = flags.copy()
    for j, column in enumerate(flags.T):
        for begin, end in periods(column):
            wider[max(begin - margin, 0) : end + margin, j] = True
    return wider


def _trusted(model: LinearModel, samples: Floats, blamed: NDArray[np.bool_]) -> Floats | None:
    """Return the samples that the controller does not blame; None if the sensors that are left cannot be compared with the model.

    A sensor that is blamed for most of the run is left out of all of it, because a few samples would leave its set no evidence;
    but not if the others do not see the plant.
    """
    bank = observers(model)
    if bank is None:
        return None
    gone = np.flatnonzero(blamed.mean(axis=0) > MOSTLY).tolist()
    if observers(model, sets_without(bank.sensors, gone)) is None:
        gone = []
    return np.where(blamed | np.isin(np.arange(blamed.shape[1]), gone), np.nan, samples)


__all__ = ["OF_FAULTS", "of_faults"]
