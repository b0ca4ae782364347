"""A model from nothing but a recording of redundant sensors: how the quantity moves, and how each sensor errs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import RecordingError
from bayesftc.monitoring._columns import SensorErrors
from bayesftc.monitoring._fit_bias import biases, wander
from bayesftc.monitoring._fit_checks import FEWEST, check_recording
from bayesftc.monitoring._fit_motion import Motion, common
from bayesftc.monitoring._fit_noise import TELLS, Noise, alone, decompose, disagreement, groups, share_out
from bayesftc.monitoring._models import ConstantRate, RandomWalk
from bayesftc.monitoring._moments import median
from bayesftc.monitoring._recording import Recording

WANDERS = 0.1
"""A wandering bias counts where its variance is at least this share of that of the sensor's noise."""

SETTLED = 4
"""Lags, in the shortest one, from which on the noise of the sensors has about its full size."""

USUAL, RARE = 0.75, 0.9
"""Quantiles by which it is judged in the stretch, and in the whole recording, where it counts up to the size of the noise."""

SMOOTH = 0.7
"""Second differences of a random walk have twice the variance of its first ones; below this share it has a rate instead."""

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
    stretch_told : bool
        Whether the noise is that of the stretch; a stretch in which nothing moves does not show it, so that it is then that of
        the whole recording.
    """

    plant: RandomWalk | ConstantRate
    sensors: dict[str, FittedSensor]
    errors: tuple[SensorErrors, ...]
    moving: float
    level: float
    spread: float
    rate: float
    stretch_told: bool = True


def fit_model(recording: Recording, stretch: slice = slice(None)) -> FittedModel:
    """Fit a model to a recording of sensors that measure the same quantity; faults may be in a part of it.

    What the sensors have in common is the quantity's motion, what they differ by is noise. Both are moments of differences over
    several lags, in many short windows. Of noise the median over the windows counts, so that a fault in fewer than half of them
    does no harm. Of motion an upper quantile of those windows counts in which anything moves, so that a calm part does none.

    Parameters
    ----------
    recording : Recording
        Of two sensors or more, at least 200 samples of each.
    stretch : slice
        Steps from which the sensors' noise is taken; by default all. Motion is taken from the whole recording: a calm stretch
        does not show it, and no fault of a single sensor looks like it. So are wandering biases, up to the size of the noise.

    Raises
    ------
    RecordingError
        If there are fewer sensors or samples, or a sensor does not follow the others.
    """
    check_recording(recording, recording.y[stretch])
    dt, bias = float(recording.dt), biases(recording.y[stretch])
    whole = recording.y - bias
    y = whole[stretch]
    widths = [_width(whole[:, i], resolution) for i, resolution in enumerate(recording.resolution)]
    floor = float(np.median(widths)) ** 2 / 12
    apart, active, noise = _noise(y, floor)
    plant, motion, rate = _plant(whole, noise, dt)
    if motion.seen and not active.any():
        y = whole
        apart, active, noise = _noise(y, floor)
        plant, motion, rate = _plant(whole, noise, dt)
    own, shared = _errors(y, apart, active)
    slow, times = _wandering(y, whole, own)
    sensors, errors = {}, []
    for i, name in enumerate(recording.sensors):
        std = float(max(own[i].white, widths[i] ** 2 / 12)) ** 0.5
        sensors[name] = FittedSensor(
            std, float(bias[i]), recording.resolution[i], *_shares(y[:, i], active, recording.resolution[i])
        )
        lasting = [*own[i].lasting, *([(slow[i], times[i])] if slow[i] > WANDERS * own[i].variance else [])]
        errors += [SensorErrors(float(variance) ** 0.5, constant * dt, [name]) for variance, constant in lasting]
    for pair, of_pair in shared.items():
        names = [recording.sensors[i] for i in pair]
        errors += [SensorErrors(float(v) ** 0.5, constant * dt, names, common=True) for v, constant in of_pair.lasting]
    level = median(whole, 1)
    return FittedModel(
        plant, sensors, tuple(errors), float(active.mean()), float(np.nanmedian(level)),
        float(np.nanstd(level)), rate, len(y) == len(recording.y[stretch]),
    )  # fmt: skip


def _noise(y: Floats, floor: float) -> tuple[dict[int, Floats], np.ndarray, dict[int, float]]:
    """Return for each lag how far the sensors differ in each window, where they move, and a typical sensor's noise.

    First noise is taken from all windows; by it those are found that move, where noise shows as it is.
    """
    lags, everywhere = _lags(y), np.full(len(y), True)
    rough = {lag: max(_half(disagreement(y, lag, everywhere)), floor) for lag in lags}
    active = np.any([common(y, lag, 1, of_lag).active for lag, of_lag in rough.items()], axis=0)
    apart = {lag: disagreement(y, lag, active) for lag in lags}
    return apart, active, {lag: max(_half(of_lag), floor) for lag, of_lag in apart.items()}


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
    noise = {lag: noise.get(lag, noise[max(noise)]) for lag in sorted({*noise, *_lags(y)})}
    lag, motion = _motion(y, noise, 1)
    rate = motion.variance**0.5 / (lag * dt)
    walk = RandomWalk(float(motion.variance / (lag * dt)) ** 0.5)
    if not motion.seen:
        return walk, motion, rate
    lag, bend = _motion(y, noise, 2)
    if bend.variance >= SMOOTH * common(y, lag, 1, noise[lag]).variance:
        return walk, motion, rate
    return ConstantRate(float(1.5 * bend.variance / (lag * dt) ** 3) ** 0.5), motion, rate


def _errors(
    y: Floats, apart: dict[int, Floats], active: np.ndarray
) -> tuple[list[Noise], dict[tuple[int, int], Noise]]:
    """Return the errors of each sensor, and those that pairs of sensors share."""
    m = y.shape[1]
    shared = groups(
        median(np.array([median(of_lag, 0) for of_lag in list(apart.values())[: max(4, len(apart) // 2)]]), 0), m
    )
    parts = np.array([share_out(of_lag, alone(y, lag, active), shared) for lag, of_lag in apart.items()])
    times = np.array(list(apart), dtype=np.float64)
    sizes = np.array([_size(times, column) for column in parts.T])
    shape = decompose(times, median(parts[:, :m] / np.maximum(sizes[:m], 1e-300), 1), white=True)
    own = [shape.times(size) for size in sizes[:m]]
    together = {pair: decompose(times, parts[:, m + g], white=False) for g, pair in enumerate(shared)}
    return own, {
        pair: noise for pair, noise in together.items() if noise.variance > TELLS * min(own[i].variance for i in pair)
    }


def _size(lags: Floats, variances: Floats) -> float:
    """Return the variance of differences over lags beyond which it hardly grows."""
    lags, variances = lags[np.isfinite(variances)], variances[np.isfinite(variances)]
    return float(np.median(variances[lags >= min(SETTLED * lags[0], lags[-1])])) if len(lags) else 0.0


def _wandering(y: Floats, whole: Floats, own: Sequence[Noise]) -> tuple[list[float], list[float]]:
    """Return the variance and time constant (steps) of each sensor's wandering bias; at least those of a typical sensor.

    A sensor that alone is believed to have none would be blamed for what the others do.
    """
    (inside, _), (everywhere, times) = wander(y, USUAL), wander(whole, RARE)
    found = np.maximum(inside, np.minimum(everywhere, [noise.variance for noise in own]))
    typical = float(np.median(found))
    return np.maximum(found, typical).tolist(), [float(np.median(times[found >= typical]))] * len(own)


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
