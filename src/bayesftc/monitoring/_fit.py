"""A model from nothing but a recording of redundant sensors: how the quantity moves, and how each sensor errs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import RecordingError
from bayesftc.monitoring._columns import SensorErrors
from bayesftc.monitoring._fit_motion import SMOOTH, Motion, common
from bayesftc.monitoring._fit_noise import Noise, alone, decompose, disagreement, groups, share_out
from bayesftc.monitoring._models import ConstantRate, RandomWalk
from bayesftc.monitoring._moments import median
from bayesftc.monitoring._recording import Recording

FEWEST = 200
"""Samples of each sensor that a fit needs."""

PARTS = 64
"""Lags reach up to this part of the recording."""


@dataclass(frozen=True)
class FittedSensor:
    """What a recording says of a sensor.

    Attributes
    ----------
    std : float
        Standard deviation of its white noise.
    bias : float
        Its constant difference from the typical sensor.
    resolution : float
        Its samples are multiples of this; 0: of none.
    repeats : float
        Share of its samples that equal the one before, while the quantity moves.
    missing : float
        Share of the steps without a sample of it.
    """

    std: float
    bias: float
    resolution: float
    repeats: float
    missing: float


@dataclass(frozen=True)
class FittedModel:
    """A monitor's model from a recording; see `fit_model`.

    Attributes
    ----------
    plant : RandomWalk or ConstantRate
        How the quantity moves.
    sensors : dict of str to FittedSensor
        By name.
    errors : tuple of SensorErrors
        Errors that last.
    moving : float
        Share of the time in which it moves visibly.
    level, spread : float
        Mean and standard deviation of the quantity.
    rate : float
        Standard deviation of its rate.
    """

    plant: RandomWalk | ConstantRate
    sensors: dict[str, FittedSensor]
    errors: tuple[SensorErrors, ...]
    moving: float
    level: float
    spread: float
    rate: float


def fit_model(recording: Recording) -> FittedModel:
    """Fit a model to a recording of sensors that measure the same quantity; faults may be in a part of it.

    What the sensors have in common is the quantity's motion, what they differ by is noise. Both are moments of differences over
    several lags, in many short windows. Of noise the median over the windows counts, so that a fault in fewer than half of them
    does no harm. Of motion an upper quantile of those windows counts in which anything moves, so that a calm part does none.

    Parameters
    ----------
    recording : Recording
        Of two sensors or more, at least 200 samples of each.

    Raises
    ------
    RecordingError
        If there are fewer sensors or samples, or a sensor does not follow the others.
    """
    y, m, dt = recording.y, recording.y.shape[1], float(recording.dt)
    if m < 2:
        raise RecordingError(
            f"A fit needs two or more sensors of the same quantity, but there is only {recording.sensors[0]!r}; one alone does "
            "not tell its noise from the quantity's motion. Write a model file."
        )
    for name, count in zip(recording.sensors, np.isfinite(y).sum(axis=0), strict=True):
        if count < FEWEST:
            raise RecordingError(
                f"The sensor {name!r} has {count} samples in the stretch; a fit needs {FEWEST}. Take a longer stretch, or leave "
                "the sensor out."
            )
    bias = _biases(y)
    y = y - bias
    _refuse_strangers(y, recording.sensors)
    floor = float(np.median([_repeats_width(y[:, i], r) for i, r in enumerate(recording.resolution)])) ** 2 / 12
    lags = _lags(y)
    everywhere = np.full(len(y), True)
    rough = {lag: max(_half(disagreement(y, lag, everywhere)), floor) for lag in lags}
    active = _motion(y, lags, rough, 1)[1].active
    apart = [disagreement(y, lag, active) for lag in lags]
    noise = {lag: max(_half(of_lag), floor) for lag, of_lag in zip(lags, apart, strict=True)}
    plant, motion, rate = _plant(y, lags, noise, dt)
    own, shared = _errors(y, lags, apart, active)
    sensors, errors = {}, []
    for i, name in enumerate(recording.sensors):
        resolution = recording.resolution[i]
        std = float(np.sqrt(max(own[i].white, resolution**2 / 12, 1e-12 * float(np.nanvar(y[:, i])), 1e-300)))
        sensors[name] = FittedSensor(std, float(bias[i]), resolution, *_shares(y[:, i], motion.active, resolution))
        errors += [SensorErrors(variance**0.5, constant * dt, [name]) for variance, constant in own[i].lasting]
    for pair, of_pair in shared.items():
        names = [recording.sensors[i] for i in pair]
        errors += [SensorErrors(v**0.5, constant * dt, names, common=True) for v, constant in of_pair.lasting]
    level = median(y, 1)
    return FittedModel(
        plant, sensors, tuple(errors), motion.share, float(np.nanmedian(level)), float(np.nanstd(level)), rate
    )


def _half(apart: Floats) -> float:
    """Return the variance of the difference of a typical sensor, from those of all pairs in all windows."""
    apart = median(apart, 0)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) / 2 if len(known) else 0.0


def _lags(y: Floats) -> list[int]:
    """Return lags in steps, each about twice the one before: multiples of the slowest sensor's interval are among them."""
    longest = max(len(y) // PARTS, 2)
    intervals = {int(np.median(np.diff(np.flatnonzero(np.isfinite(column))))) for column in y.T}
    return sorted({n * 2**k for n in intervals for k in range(32) if n * 2**k <= max(longest, 2 * n)})


def _biases(y: Floats) -> Floats:
    """Return the constant difference of each sensor from the typical one; their median is 0."""
    middle = median(y, 1)
    together = np.isfinite(y).sum(axis=1) > 1
    bias = median((y - middle[:, None])[together], 0)
    return np.asarray(bias - np.median(bias))


def _refuse_strangers(y: Floats, names: Sequence[str]) -> None:
    """Refuse a sensor that differs from the others by as much as they all move: it measures something else."""
    middle = median(y, 1)
    for i, name in enumerate(names):
        others = median(np.delete(y, i, axis=1), 1)
        known = np.isfinite(others) & np.isfinite(y[:, i])
        apart, moved = (
            np.median(np.abs((y[:, i] - others)[known])),
            np.nanquantile(np.abs(middle - np.nanmedian(middle)), 0.9),
        )
        noise = np.sqrt(np.nanmedian(np.diff(y[known, i]) ** 2))
        if apart > moved and apart > 10 * noise:
            raise RecordingError(
                f"The column {name!r} does not follow the others: it differs from them by {apart:.3g}, and they move by "
                f"{moved:.3g}. Leave it out: name the sensors that measure the same quantity."
            )


def _repeats_width(samples: Floats, resolution: float) -> float:
    return max(resolution, 1e-9 * float(np.nanmax(np.abs(samples))))


def _motion(y: Floats, lags: Sequence[int], noise: dict[int, float], order: int) -> tuple[int, Motion]:
    """Return the shortest lag over which the quantity moves by more than the noise, or the best one, and the motion over it."""
    best: tuple[float, int, Motion] | None = None
    for lag in lags:
        level = noise[lag] * (1 if order == 1 else 3)
        found = common(y, lag, order, level)
        if found.seen and found.variance >= level:
            return lag, found
        if best is None or not best[2].seen or (found.seen and found.variance / level > best[0]):
            best = found.variance / level, lag, found  # the longest lag where none is seen
    if best is None:
        raise RecordingError("The stretch is too short for a fit; take a longer one.")
    return best[1], best[2]


def _plant(
    y: Floats, lags: Sequence[int], noise: dict[int, float], dt: float
) -> tuple[RandomWalk | ConstantRate, Motion, float]:
    """Return how the quantity moves, the motion by which it is judged, and the standard deviation of its rate."""
    lag, motion = _motion(y, lags, noise, 1)
    rate = motion.variance**0.5 / (lag * dt)
    walk = RandomWalk((motion.variance / (lag * dt)) ** 0.5)
    if not motion.seen:
        return walk, motion, rate
    later = common(y, 2 * lag, 1, noise.get(2 * lag, noise[lag]))
    if np.log2(max(later.variance, 1e-300) / motion.variance) < SMOOTH:
        return walk, motion, rate
    lag, bend = _motion(y, lags, noise, 2)
    if not bend.seen:
        return walk, motion, rate
    return ConstantRate((1.5 * bend.variance / (lag * dt) ** 3) ** 0.5), motion, rate


def _errors(
    y: Floats, lags: Sequence[int], apart: Sequence[Floats], active: np.ndarray
) -> tuple[list[Noise], dict[tuple[int, int], Noise]]:
    """Return the errors of each sensor, and those that pairs of sensors share."""
    m = y.shape[1]
    shared = groups(median(np.array([median(of_lag, 0) for of_lag in apart[: max(4, len(apart) // 2)]]), 0), m)
    parts = np.array(
        [share_out(of_lag, alone(y, lag, active), shared) for lag, of_lag in zip(lags, apart, strict=True)]
    )
    times = np.array(lags, dtype=np.float64)
    own = [decompose(times, parts[:, i], white=True) for i in range(m)]
    return own, {pair: decompose(times, parts[:, m + g], white=False) for g, pair in enumerate(shared)}


def _shares(samples: Floats, active: np.ndarray, resolution: float) -> tuple[float, float]:
    """Return the shares of repeated and of missing samples: typical ones, so that a frozen or silent part does no harm."""
    there = np.isfinite(samples)
    values = samples[there]
    same = (np.abs(np.diff(values)) <= max(0.25 * resolution, 1e-12 * float(np.abs(values).max()))).astype(np.float64)
    moving = active[there][1:]
    same = same[moving] if moving.sum() >= FEWEST else same
    shares = [
        float(median(x[: len(x) // n * n].reshape(-1, n).mean(1)[:, None], 0)[0])
        for x, n in ((same, max(len(same) // 50, 20)), ((~there).astype(np.float64), max(len(there) // 50, 20)))
    ]
    return shares[0], shares[1]
