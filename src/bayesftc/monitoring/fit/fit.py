"""A model from nothing but a recording of redundant sensors: how the quantity moves, and how each sensor errs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesftc.controllers.switching.fault_modes import HEALTHY_REPEATS
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.columns import SensorErrors
from bayesftc.monitoring.fit.bias import biases, wander
from bayesftc.monitoring.fit.checks import check_recording
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.motion import Motion, common
from bayesftc.monitoring.fit.noise import Noise, awake, decompose, disagreement, groups, share_out
from bayesftc.monitoring.fit.settings import FIT
from bayesftc.monitoring.models import ConstantRate, RandomWalk
from bayesftc.monitoring.recording import Recording


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
        Share of its samples that equal the one before, while it changes at all; at least what is believed where nobody says it.
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
    moves : bool
        Whether it moves by more than noise would hide.
    level, spread : float
        Mean and standard deviation of the quantity.
    rate : float
        Standard deviation of its rate.
    """

    plant: RandomWalk | ConstantRate
    sensors: dict[str, FittedSensor]
    errors: tuple[SensorErrors, ...]
    moves: bool
    level: float
    spread: float
    rate: float


def fit_model(recording: Recording, stretch: slice = slice(None)) -> FittedModel:
    """Fit a model to a recording of sensors that measure the same quantity; faults may be in a part of it.

    What the sensors have in common is the quantity's motion, what they differ by is noise. Both are moments of differences over
    several lags, in many short windows. Of noise the median over the windows counts, so that a fault in fewer than half of them
    does no harm. Of motion an upper quantile of those windows counts in which anything moves, so that a calm part does none.
    Where a sensor does not change at all it says nothing: it is frozen, or the car is parked.

    Parameters
    ----------
    recording : Recording
        Of two sensors or more, at least 200 samples of each.
    stretch : slice
        Steps in which the sensors are healthy; by default all. Biases are taken from it. Motion is taken from the whole
        recording: a calm stretch does not show it, and no fault of a single sensor looks like it. So are the noise, up to twice
        that of the stretch, and wandering biases, up to the size of the noise.

    Raises
    ------
    RecordingError
        If there are fewer sensors or samples, or a sensor does not follow the others.
    """
    check_recording(recording, recording.y[stretch])
    dt, bias = float(recording.dt), biases(recording.y[stretch])
    whole = awake(recording.y - bias)
    y = awake(recording.y[stretch] - bias)
    widths = [_width(recording.y[:, i], resolution) for i, resolution in enumerate(recording.resolution)]
    floor = float(np.median(widths)) ** 2 / 12
    apart = {lag: disagreement(whole, lag) for lag in _lags(whole)}
    noise = {lag: max(_half(pairs), floor) for lag, (pairs, _) in apart.items()}
    plant, motion, rate = _plant(whole, noise, dt)
    own, shared = _errors(apart)
    if len(y) < len(whole):
        of_stretch, _ = _errors({lag: disagreement(y, lag) for lag in _lags(y)})
        own = [
            everywhere.within(here.variance, FIT.louder**2) for everywhere, here in zip(own, of_stretch, strict=True)
        ]
    slow, times = _wandering(y, whole, own)
    sensors, errors = {}, []
    for i, name in enumerate(recording.sensors):
        std = float(max(own[i].white, widths[i] ** 2 / 12)) ** 0.5
        sensors[name] = FittedSensor(
            std,
            float(bias[i]),
            recording.resolution[i],
            max(_repeats(y[:, i], widths[i]), HEALTHY_REPEATS),
            _typical(np.isnan(recording.y[stretch, i])),
        )
        lasting = [*own[i].lasting, *([(slow[i], times[i])] if slow[i] > FIT.wanders * own[i].variance else [])]
        errors += [SensorErrors(float(variance) ** 0.5, constant * dt, [name]) for variance, constant in lasting]
    for pair, of_pair in shared.items():
        names = [recording.sensors[i] for i in pair]
        errors += [SensorErrors(float(v) ** 0.5, constant * dt, names, common=True) for v, constant in of_pair.lasting]
    level = median(whole, 1)
    middle, spread = float(np.nanmedian(level)), float(np.nanstd(level))
    return FittedModel(plant, sensors, tuple(errors), motion.seen, middle, spread, rate)


def _half(apart: Floats) -> float:
    """Return the variance of the difference of a typical sensor, from those of all pairs in all windows."""
    apart = median(apart, 0)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) / 2 if len(known) else 0.0


def _lags(y: Floats) -> list[int]:
    """Return lags in steps, each about twice the one before: multiples of the slowest sensor's interval are among them."""
    longest = max(len(y) // FIT.parts, 2)
    intervals = {int(np.median(np.diff(np.flatnonzero(np.isfinite(column))))) for column in y.T}
    return sorted({n * 2**k for n in intervals for k in range(32) if n * 2**k <= max(longest, 2 * n)})


def _width(samples: Floats, resolution: float) -> float:
    """Return by how much two samples of a sensor differ at least, that of a very fine one too."""
    return max(resolution, 1e-9 * float(np.nanmedian(np.abs(samples))), 1e-150)


def _motion(y: Floats, noise: dict[int, float], order: int) -> tuple[int, Motion]:
    """Return the shortest lag over which the quantity moves by more than the noise, or the best one, and the motion over it."""
    best: tuple[float, int, Motion] | None = None
    for lag, of_lag in noise.items():
        level = of_lag * (1 if order == 1 else 3)
        found = common(y, lag, order, level)
        if not found.variance:
            continue
        if found.seen and found.variance >= level:
            return lag, found
        if best is None or not best[2].seen or (found.seen and found.variance / level > best[0]):
            best = found.variance / level, lag, found  # the longest lag where none is seen
    if best is None:
        raise RecordingError("The sensors have too few samples at the same steps for a fit; take a longer stretch.")
    return best[1], best[2]


def _plant(y: Floats, noise: dict[int, float], dt: float) -> tuple[RandomWalk | ConstantRate, Motion, float]:
    """Return how the quantity moves, the motion by which it is judged, and the standard deviation of its rate."""
    lag, motion = _motion(y, noise, 1)
    rate = motion.variance**0.5 / (lag * dt)
    walk = RandomWalk(float(motion.variance / (lag * dt)) ** 0.5)
    if not motion.seen:
        return walk, motion, rate
    lag, bend = _motion(y, noise, 2)
    if bend.variance >= FIT.smooth * common(y, lag, 1, noise[lag]).variance:
        return walk, motion, rate
    return ConstantRate(float(1.5 * bend.variance / (lag * dt) ** 3) ** 0.5), motion, rate


def _errors(apart: dict[int, tuple[Floats, Floats]]) -> tuple[list[Noise], dict[tuple[int, int], Noise]]:
    """Return the errors of each sensor, and those that pairs of sensors share.

    How noise lasts is taken to be the same for all sensors, which are of one kind more often than not: single ones would be
    blamed for what their own numbers happen to miss.
    """
    pairs = [pairs for pairs, _ in apart.values()]
    m = next(iter(apart.values()))[1].shape[1]
    shared = groups(median(np.array([median(of_lag, 0) for of_lag in pairs[: max(4, len(pairs) // 2)]]), 0), m)
    parts = np.array([share_out(*of_lag, shared) for of_lag in apart.values()])
    times = np.array(list(apart), dtype=np.float64)
    sizes = np.array([_size(times, column) for column in parts.T])
    shape = decompose(times, median(parts[:, :m] / np.maximum(sizes[:m], 1e-300), 1), white=True)
    own = [shape.times(size) for size in sizes[:m]]
    together = {pair: decompose(times, parts[:, m + g], white=False) for g, pair in enumerate(shared)}
    return own, {
        pair: noise
        for pair, noise in together.items()
        if noise.variance > FIT.tells * min(own[i].variance for i in pair)
    }


def _size(lags: Floats, variances: Floats) -> float:
    """Return the variance of differences over lags beyond which it hardly grows."""
    lags, variances = lags[np.isfinite(variances)], variances[np.isfinite(variances)]
    return float(np.median(variances[lags >= min(FIT.settled * lags[0], lags[-1])])) if len(lags) else 0.0


def _wandering(y: Floats, whole: Floats, own: Sequence[Noise]) -> tuple[list[float], list[float]]:
    """Return the variance and time constant (steps) of each sensor's wandering bias; at least those of a typical sensor.

    A sensor that alone is believed to have none would be blamed for what the others do.
    """
    (inside, _), (everywhere, times) = wander(y, FIT.usual), wander(whole, FIT.rare)
    found = np.maximum(inside, np.minimum(everywhere, [noise.variance for noise in own]))
    typical = float(np.median(found))
    return np.maximum(found, typical).tolist(), [float(np.median(times[found >= typical]))] * len(own)


def _repeats(samples: Floats, width: float) -> float:
    """Return the share of samples that equal the one before; of a typical part, so that a frozen one does no harm."""
    values = samples[np.isfinite(samples)]
    return _typical(np.abs(np.diff(values)) < 0.25 * width)


def _typical(happens: np.ndarray) -> float:
    """Return how often something happens in a typical part of the steps."""
    length = max(len(happens) // FIT.parts, FIT.least_part)
    parts = happens[: max(len(happens) // length, 1) * length].reshape(-1, min(length, len(happens)))
    return float(np.median(parts.mean(axis=1)))
