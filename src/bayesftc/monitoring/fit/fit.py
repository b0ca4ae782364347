"""Fit a model to a recording of redundant sensors: the motion of the quantity, and the errors of each sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayesftc.controllers.switching.fault_modes import HEALTHY_REPEATS
from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.columns import SensorErrors
from bayesftc.monitoring.fit.bias import Change, biases, changes, parting, steady_gains, unmoved, wander
from bayesftc.monitoring.fit.checks import check_recording
from bayesftc.monitoring.fit.codes import without_codes
from bayesftc.monitoring.fit.following import strangers
from bayesftc.monitoring.fit.moments import median, weighted_median
from bayesftc.monitoring.fit.motion import Motion, common
from bayesftc.monitoring.fit.noise import Noise, awake, decompose, disagreement, groups, share_out
from bayesftc.monitoring.fit.settings import FIT
from bayesftc.monitoring.models import ConstantRate, RandomWalk
from bayesftc.monitoring.recording import Recording


@dataclass(frozen=True)
class FittedSensor:
    """A sensor's properties, estimated from a recording.

    Attributes
    ----------
    std : float
        Standard deviation of its white noise, in its unit, after the division by the gain.
    bias : float
        Its constant difference from the typical sensor, in its unit, before the division by the gain.
    resolution : float
        Its samples are multiples of this, before the division by the gain; 0 if they are not.
    repeats : float
        Share of its samples that equal the one before, without parts of the recording with far more of them, such as a freeze;
        at least the default of `Sensor`.
    missing : float
        Share of the steps without a sample, without parts with far more of them, such as a gap.
    gain : float
        How far it moves while the others move by 1; 1 if nothing shows that it moves otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
    >>> level = 20.0 + np.cumsum(0.05 * rng.standard_normal(1000))
    >>> noise = 0.1 * rng.standard_normal((1000, 3)) + [0.0, 0.0, 2.0]
    >>> signals = {name: monitoring.Signal(t, level + noise[:, i]) for i, name in enumerate("abc")}
    >>> sensor = monitoring.fit_model(monitoring.recorded(signals)).sensors["c"]
    >>> round(sensor.std, 1), round(sensor.bias), sensor.missing
    (0.1, 2, 0.0)
    """

    std: float
    bias: float
    resolution: float
    repeats: float
    missing: float
    gain: float = 1.0


@dataclass(frozen=True)
class FittedModel:
    """A monitor's model from a recording; see `fit_model`.

    Attributes
    ----------
    plant : RandomWalk or ConstantRate
        Model of the quantity's motion.
    sensors : dict of str to FittedSensor
        By name.
    errors : tuple of SensorErrors
        Lasting errors.
    moves : bool
        Whether the motion is visible above the noise.
    strangers : dict of str to float
        Sensors that do not follow the others, and how far each moves while the others move by 1. They have no effect on
        the motion, or on the noise of the others. If there are two sensors that do not agree, both are listed.
    changes : dict of str to Change
        Sensors that have moved away from the others and not returned, with the size, the first step, and whether the change is
        sudden. Their biases and lasting errors are those before the change, or after it if the stretch lies there.
    parted : Change or None
        How two sensors have moved apart and not returned, if they have, as a change of the first. Biases and lasting errors come
        from the time before. Which of the two has moved is not known.
    outside : SensorErrors or None
        Wandering biases that show only outside of the stretch: they are in `errors`, but may be faults there.
    coded : bool
        Whether samples were left out, because a value that repeats seems to stand for no sample.
    borrows : bool
        Whether errors come from outside of the stretch, too, because it is short, or the quantity moves far less in it.
    level, spread : float
        Mean and standard deviation of the quantity, in its unit.
    rate : float
        Standard deviation of its rate, per second.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
    >>> level = 20.0 + np.cumsum(0.05 * rng.standard_normal(1000))
    >>> noise = 0.1 * rng.standard_normal((1000, 3))
    >>> recording = monitoring.recorded({name: monitoring.Signal(t, level + noise[:, i]) for i, name in enumerate("abc")})
    >>> fitted = monitoring.fit_model(recording)
    >>> type(fitted.plant).__name__, round(fitted.plant.std, 2), fitted.moves  # 0.05 in 0.1 s are 0.16 in 1 s
    ('RandomWalk', 0.15, True)
    """

    plant: RandomWalk | ConstantRate
    sensors: dict[str, FittedSensor]
    errors: tuple[SensorErrors, ...]
    moves: bool
    level: float
    spread: float
    rate: float
    strangers: Mapping[str, float] = field(default_factory=dict)
    changes: Mapping[str, Change] = field(default_factory=dict)
    parted: Change | None = None
    outside: SensorErrors | None = None
    coded: bool = False
    borrows: bool = False

    @property
    def joint(self) -> bool:
        """Whether sensors are better judged together: then healthy ones are blamed less often.

        True for two sensors or more, with or without lasting errors, including shared ones. The numbers are in the tutorial on
        recorded sensors. False if a sensor does not follow the others. Also false if samples were left out: for the monitor they
        are long faults, and the joint form blames other sensors for them.
        """
        return bool(self.changes) or not (self.strangers or self.coded)

    @property
    def belief(self) -> tuple[list[float], list[float]] | None:
        """Mean and standard deviation of quantity and rate before the first sample; None if the first samples tell them."""
        if not isinstance(self.plant, ConstantRate):
            return None
        least = self.plant.std
        return [self.level, 0.0], [max(FIT.uncertain * self.spread, least), max(self.rate, least)]


def fit_model(recording: Recording, stretch: slice = slice(None), *, gains: bool = True) -> FittedModel:
    """Fit a model to a recording of sensors of the same quantity; a part of it may have faults.

    The common part of the sensors' changes is the quantity's motion, the rest is noise. Both are estimated from moments of
    differences over several lags, in many short windows. Noise is the median over the windows, so a fault in fewer than half of
    them has no effect. Motion is an upper quantile over the windows with motion, so a calm part has no effect. Windows where a
    sensor does not change at all are left out: it is frozen, or the car is parked. So are samples of a value that a sensor
    repeats exactly while the others are far from it: it seems to stand for no sample.

    Parameters
    ----------
    recording : Recording
        Two or more sensors, with at least 200 samples each.
    stretch : slice
        Steps in which the sensors are healthy; by default all. Errors and biases come from it. Motion comes from the whole
        recording, because no fault of a single sensor looks like it. A stretch of less than 1000 steps, or one in which the
        quantity hardly moves, is not enough to estimate errors. Then noise and wandering biases also come from the whole
        recording (`FittedModel.borrows`). The noise is at most twice that of the stretch. The biases are at most as large as the
        noise, and as those of most sensors.
    gains : bool
        Whether a sensor may have a gain other than 1. A sensor has such a gain if it moves more or less than the others in both
        halves of the stretch, and all others follow each other. With two sensors, the second one gets the gain. For angles give
        False.

    Returns
    -------
    FittedModel
        The motion, the sensors and their lasting errors; `as_model_file` writes it as text.

    Raises
    ------
    RecordingError
        If there are fewer sensors or samples, or if a sensor does not follow the others.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
    >>> level = 20.0 + np.cumsum(0.05 * rng.standard_normal(1000))
    >>> noise = rng.standard_normal((1000, 3)) * [0.1, 0.1, 0.3]
    >>> recording = monitoring.recorded({name: monitoring.Signal(t, level + noise[:, i]) for i, name in enumerate("abc")})
    >>> fitted = monitoring.fit_model(recording)
    >>> {name: round(sensor.std, 1) for name, sensor in fitted.sensors.items()}, type(fitted.plant).__name__
    ({'a': 0.1, 'b': 0.1, 'c': 0.3}, 'RandomWalk')
    """
    fitted = _fit_once(recording, stretch)
    if not gains or fitted.strangers or fitted.changes or fitted.coded:
        return fitted
    slopes = steady_gains(recording.y[stretch], [sensor.std for sensor in fitted.sensors.values()])
    if not slopes:
        return fitted
    # A gain error lets two sensors part while the quantity rises. What still parts after the division has moved.
    divided = _fit_divided(recording, stretch, slopes)
    return fitted if fitted.parted and divided.parted else divided


def _fit_divided(recording: Recording, stretch: slice, slopes: Mapping[int, float]) -> FittedModel:
    """Fit a model to samples that are divided by their sensors' gains; biases and resolutions are those before the division."""
    gains = np.array([1.0 + slopes.get(i, 0.0) for i in range(len(recording.sensors))])
    resolution = tuple((np.array(recording.resolution) / gains).tolist())
    fitted = _fit_once(replace(recording, y=recording.y / gains, resolution=resolution), stretch)
    sensors = {
        name: replace(sensor, gain=float(gain), bias=float(gain) * sensor.bias, resolution=given)
        for (name, sensor), gain, given in zip(fitted.sensors.items(), gains, recording.resolution, strict=True)
    }
    return replace(fitted, sensors=sensors)


def _fit_once(given: Recording, stretch: slice) -> FittedModel:
    """Fit a model to samples as they are."""
    recording = without_codes(given)
    coded = bool(np.isfinite(given.y).sum() > np.isfinite(recording.y).sum())
    check_recording(recording, recording.y[stretch])
    strange = strangers(recording.y, stretch)
    slopes = {recording.sensors[i]: slope for i, slope in strange.items()}
    others = [i for i in range(len(recording.sensors)) if i not in strange]
    if not strange or len(others) < 2:  # nobody knows which of two sensors is wrong
        return replace(_fit(recording, stretch), strangers=slopes, coded=coded)
    fitted = _fit(recording.of_sensors(others), stretch)
    level = median(recording.y[:, others] - [fitted.sensors[recording.sensors[i]].bias for i in others], 1)
    apart = {i: _stranger(recording, i, level, stretch) for i in strange}
    sensors = {name: apart[i] if i in apart else fitted.sensors[name] for i, name in enumerate(recording.sensors)}
    return replace(fitted, sensors=sensors, strangers=slopes, coded=coded)


def _stranger(recording: Recording, i: int, level: Floats, stretch: slice) -> FittedSensor:
    """Return a sensor that does not follow the others: its whole distance from them counts as noise, so it has little weight."""
    apart = recording.y[:, i] - level
    bias = float(np.nanmedian(apart))
    std = float(np.sqrt(np.nanmean((apart - bias) ** 2)))
    return FittedSensor(std, bias, *_samples(recording, i, stretch, awake(recording.y[stretch])[:, i]))


def _samples(recording: Recording, i: int, stretch: slice, changing: Floats) -> tuple[float, float, float]:
    """Return the resolution of a sensor, its share of repeated samples while it changes, and that of missing ones."""
    repeats = _repeats(changing, _width(recording.y[:, i], recording.resolution[i]))
    return recording.resolution[i], max(repeats, HEALTHY_REPEATS), _usual(np.isnan(recording.y[stretch, i]))


def _fit(recording: Recording, stretch: slice) -> FittedModel:
    """Fit a model to all sensors."""
    dt, whole, y = float(recording.dt), awake(recording.y), awake(recording.y[stretch])
    widths = [_width(recording.y[:, i], resolution) for i, resolution in enumerate(recording.resolution)]
    floor = float(np.median(widths)) ** 2 / 12
    apart = {lag: disagreement(whole, lag) for lag in _lags(whole)}
    noise = {lag: max(_half(pairs), floor) for lag, (pairs, _) in apart.items()}
    plant, motion, rate = _plant(whole, noise, dt)
    part = len(y) < len(whole)
    alone = part and len(y) >= FIT.enough and not _calm(y, whole, noise)
    single, shared = _errors({lag: disagreement(y, lag) for lag in _lags(y)} if alone else apart)
    if part and not alone:
        of_stretch, _ = _errors({lag: disagreement(y, lag) for lag in _lags(y)})
        single = [
            everywhere.within(here.variance, FIT.louder**2) for everywhere, here in zip(single, of_stretch, strict=True)
        ]
    sizes = [of.variance**0.5 for of in single]
    moved, parted = changes(whole, sizes), parting(whole, sizes)
    kept = unmoved(whole, moved if parted is None else {0: parted, 1: parted}, stretch)
    y = np.where(np.isfinite(kept[stretch]), y, np.nan)
    bias = biases(y)
    slow, times, outside = _wandering(y - bias, (y if alone else kept) - bias, single)
    counted = [i for i in range(len(single)) if slow[i] > FIT.wanders * single[i].variance]
    sensors, errors = {}, []
    for i, name in enumerate(recording.sensors):
        std = float(max(single[i].white, widths[i] ** 2 / 12)) ** 0.5
        sensors[name] = FittedSensor(std, float(bias[i]), *_samples(recording, i, stretch, y[:, i]))
        lasting = [*single[i].lasting, *([(slow[i], times[i])] if i in counted else [])]
        lasting += _rounding(recording.resolution[i], single[i].white, plant, rate, dt, len(whole))
        errors += [
            SensorErrors(float(variance) ** 0.5, constant * dt, [name]) for variance, constant in lasting if variance
        ]
    for pair, of_pair in shared.items():
        names = [recording.sensors[i] for i in pair]
        errors += [
            SensorErrors(float(v) ** 0.5, constant * dt, names, common=True) for v, constant in of_pair.lasting if v
        ]
    level = median(kept - bias, 1)
    middle, spread = float(np.nanmedian(level)), float(np.nanstd(level))
    by_name = {recording.sensors[i]: change for i, change in moved.items()}
    elsewhere = (
        SensorErrors(outside**0.5, times[0] * dt) if outside and any(slow[i] == outside for i in counted) else None
    )
    return FittedModel(
        plant,
        sensors,
        tuple(errors),
        motion.seen,
        middle,
        spread,
        rate,
        changes=by_name,
        outside=elsewhere,
        parted=parted,
        borrows=part and not alone,
    )


def _calm(y: Floats, whole: Floats, noise: dict[int, float]) -> bool:
    """Return whether the quantity moves far less in the stretch than elsewhere, so that it shows no errors that motion causes."""
    lag, motion = _motion(whole, noise, 1)
    return motion.seen and (2 * lag >= len(y) or common(y, lag, 1, noise[lag]).variance < FIT.calm * motion.variance)


def _rounding(
    resolution: float, white: float, plant: RandomWalk | ConstantRate, rate: float, dt: float, steps: int
) -> list[tuple[float, float]]:
    """Return variance and time constant in steps of a rounding error, which lasts until the quantity has moved by a step.

    Noise of more than half a step makes it white.
    """
    if not resolution or white >= (0.25 + 1 / 12) * resolution**2:
        return []
    seconds = (resolution / plant.std) ** 2 if isinstance(plant, RandomWalk) else resolution / rate
    lasts = min(seconds / dt, float(steps))
    return [(resolution**2 / 12, lasts)] if lasts > FIT.lasting else []


def _half(apart: Floats) -> float:
    """Return the variance of a typical sensor's differences, from those of all pairs in all windows."""
    apart = median(apart, 0)
    finite = apart[np.isfinite(apart)]
    return float(np.median(finite)) / 2 if len(finite) else 0.0


def _lags(y: Floats) -> list[int]:
    """Return lags in steps, each about twice the one before, with multiples of each sensor's interval."""
    longest = max(len(y) // FIT.parts, 2)
    intervals = {int(np.median(np.diff(np.flatnonzero(np.isfinite(column))))) for column in y.T}
    return sorted({n * 2**k for n in intervals for k in range(32) if n * 2**k <= max(longest, 2 * n)})


def _width(samples: Floats, resolution: float) -> float:
    """Return the least difference of two samples of a sensor; it is positive also without a resolution."""
    return max(resolution, 1e-9 * float(np.nanmedian(np.abs(samples))), 1e-150)


def _motion(y: Floats, noise: dict[int, float], order: int) -> tuple[int, Motion]:
    """Return the shortest lag over which the quantity moves more than the noise, or else the best lag; and the motion."""
    best: tuple[float, int, Motion] | None = None
    for lag, of_lag in noise.items():
        level = of_lag * (1 if order == 1 else 3)
        motion = common(y, lag, order, level)
        if not motion.variance:
            continue
        if motion.seen and motion.variance >= level:
            return lag, motion
        if best is None or not best[2].seen or (motion.seen and motion.variance / level > best[0]):
            best = motion.variance / level, lag, motion  # the longest lag if no motion is seen
    if best is None:
        raise RecordingError("The sensors have too few samples at the same steps for a fit. Choose a longer stretch.")
    return best[1], best[2]


def _plant(y: Floats, noise: dict[int, float], dt: float) -> tuple[RandomWalk | ConstantRate, Motion, float]:
    """Return the model of the quantity's motion, the motion that it is based on, and the standard deviation of the rate."""
    lag, motion = _motion(y, noise, 1)
    rate = motion.variance**0.5 / (lag * dt)
    walk = RandomWalk(float(motion.variance / (lag * dt)) ** 0.5)
    if not motion.seen:
        return walk, motion, rate
    near = common(y, lag, 2, 3 * noise[lag])
    far, bend = _motion(y, noise, 2)
    turns = motion.variance >= noise[lag] and near.variance < FIT.smooth * motion.variance
    ratio = bend.variance / common(y, far, 1, noise[far]).variance
    if not turns and ratio >= FIT.smooth:
        return walk, motion, rate
    std = _bend(bend, far * dt)
    # A turn seems a random walk over lags as long as itself; noise may hide how fast its rate changes.
    return ConstantRate(max(std, _bend(near, lag * dt)) if ratio >= FIT.abrupt else std), motion, rate


def _bend(motion: Motion, seconds: float) -> float:
    """Return the standard deviation of the change of the rate in one second, from second differences over a lag."""
    return float(np.sqrt(1.5 * motion.variance / seconds**3))


def _errors(apart: dict[int, tuple[Floats, Floats]]) -> tuple[list[Noise], dict[tuple[int, int], Noise]]:
    """Return the errors of each sensor, and the common errors of pairs.

    All sensors get the same shape of the noise's correlation, because most are of one kind. With shapes of their own, sensors
    would be suspected because of errors of their estimates.
    """
    pairs = [pairs for pairs, _ in apart.values()]
    m = next(iter(apart.values()))[1].shape[1]
    shared = groups(median(np.array([median(of_lag, 0) for of_lag in pairs[: max(4, len(pairs) // 2)]]), 0), m)
    of_lags = [share_out(*of_lag, shared) for of_lag in apart.values()]
    parts, uncertain = (np.array(of) for of in zip(*of_lags, strict=True))
    times = np.array(list(apart), dtype=np.float64)
    sizes, shape = _sizes(parts[:, :m], uncertain[:, :m])
    of_all = decompose(times, shape, white=True)
    single = [of_all.times(size) for size in sizes]
    common_errors = {pair: decompose(times, parts[:, m + g], white=False) for g, pair in enumerate(shared)}
    return single, {
        pair: noise
        for pair, noise in common_errors.items()
        if noise.variance > FIT.tells * min(single[i].variance for i in pair)
    }


def _sizes(variances: Floats, uncertain: Floats) -> tuple[Floats, Floats]:
    """Return the size of each sensor's variance, and the shape over the lags that all have: variances are their products.

    Lags and sensors count by how certain their variances are. Over a lag at which a sparse sensor has no samples, the others give
    the shape; over a long one, in which the quantity moves much, the variance of a precise sensor is hardly known.

    Parameters
    ----------
    variances, uncertain : ndarray, lags x sensors
        Variances of the differences, and their errors up to a factor; NaN where a sensor has no samples.
    """
    # A few windows may agree by chance: no lag counts more than a shorter one.
    uncertain = np.fmax.accumulate(np.fmax(uncertain, max(1e-6 * float(np.nanmax(variances, initial=0.0)), 1e-150)))
    shape = np.where(np.isfinite(variances).any(axis=1), 1.0, np.nan)
    for _ in range(FIT.rounds):
        products = variances * shape[:, None] / uncertain**2
        squares = np.where(np.isfinite(products), shape[:, None] / uncertain, 0.0) ** 2
        sizes = np.nansum(products, axis=0) / np.maximum(squares.sum(axis=0), 1e-300)
        of_lags = zip(variances / np.maximum(sizes, 1e-300), (sizes / uncertain) ** 2, strict=True)
        shape = np.array([weighted_median(*of_lag) for of_lag in of_lags])
    return sizes, shape


def _wandering(y: Floats, whole: Floats, errors: Sequence[Noise]) -> tuple[list[float], list[float], float]:
    """Return the variance and time constant (steps) of each sensor's wandering bias; at least those of a typical sensor.

    The last number is the variance of a typical sensor if less than half of it shows in the stretch, else 0.
    A single sensor whose model has no wandering bias would be suspected when the others wander.
    """
    (inside, _), (everywhere, times) = wander(y, FIT.usual), wander(whole, FIT.seldom)
    most: Floats = np.array([noise.variance for noise in errors])
    if len(y) < len(whole):  # what only one sensor has outside the stretch is more likely its fault
        most = np.minimum(most, np.median(everywhere))
    variances = np.maximum(inside, np.minimum(everywhere, most))
    typical = float(np.median(variances))
    outside = typical if typical > 2.0 * float(np.median(inside)) else 0.0
    return (
        np.maximum(variances, typical).tolist(),
        [float(np.median(times[variances >= typical]))] * len(errors),
        outside,
    )


def _repeats(samples: Floats, width: float) -> float:
    """Return the share of samples that equal the one before, without frozen parts."""
    values = samples[np.isfinite(samples)]
    return _usual(np.abs(np.diff(values)) < 0.25 * width)


def _usual(happens: np.ndarray) -> float:
    """Return the share of true values, without parts in which all are true, or far more than in the median part.

    The median part alone does not tell a small share: of 40 samples, one or none is true.
    """
    parts = np.array_split(happens, min(max(len(happens) // FIT.least_part, 1), FIT.parts))
    shares, lengths = np.array([part.mean() for part in parts]), np.array([len(part) for part in parts])
    if (shares == 1).all():
        return 1.0
    shares, lengths = shares[shares < 1], lengths[shares < 1]
    typical = float(np.median(shares))
    for _ in range(FIT.rounds):
        by_chance = np.sqrt(np.maximum(typical, 1 / lengths) * (1 - typical) / lengths)
        spread = np.maximum(MAD * np.median(np.abs(shares - typical)), by_chance)
        usual = shares <= typical + FIT.clip * spread
        typical = float(np.average(shares[usual], weights=lengths[usual]))
    return typical
