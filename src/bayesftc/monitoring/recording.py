"""Recorded samples of sensors and inputs, each with its own times, brought to the steps of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.controllers.models.checks import check_number
from bayesftc.cosim.base.announcing import inform
from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.invalid import invalid_values
from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.base.recordings.dates import span_text, time_text
from bayesftc.cosim.base.recordings.held import without_held
from bayesftc.cosim.base.recordings.intervals import first_step, typical_interval, usual_step
from bayesftc.cosim.base.recordings.order import without_repeats, wrong_order
from bayesftc.cosim.base.recordings.silences import Silence, silences
from bayesftc.cosim.base.recordings.turns import Turns
from bayesftc.cosim.base.timebase import rational_step, show, spoken
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.columns import check_gain
from bayesftc.monitoring.gaps import Gap, find_gaps

LATE = 0.02
"""Share of a recording before the first sample of the last sensor from which on there is a warning that it is not judged."""

MOST_STEPS = 20_000_000
"""Largest number of steps, two days at 100 samples per second: a longer recording more likely has a wrong unit of time."""

ROUNDING = 0.05
"""Share of a step by which an input's time stamp may differ from the step that it belongs to: times in files are rounded."""

LARGEST = 1e50
"""Largest size of a sample: the square of a much larger number is no number any more, and no quantity is so large."""

LEAST_LOSS, MOST_LOSS = 0.01, 0.999
"""Limits of a healthy sensor's share of steps without a sample."""


@dataclass(frozen=True, eq=False)
class Signal:
    """The recorded samples of one sensor or input.

    Parameters
    ----------
    time : array_like
        Time stamps in seconds, increasing. A sample that repeats time and value of the one before counts once.
    values : array_like
        One sample per time. Samples that are not finite, or above 1e50 in size, are missing.
    bias : float
        Known offset in the unit of the values, which is subtracted.
    delay : float
        Seconds by which the time stamps are late.
    smooth : float
        Seconds over which an input is averaged, up to the next step; at least one step.
    resolution : float
        Resolution of a sensor in its unit: its samples are whole multiples of it; 0 if it is too fine to matter. By default it is
        estimated from the samples: files have few decimals, and samples that are equal for this reason are no freeze.
    unit : str
        Unit of the values, for figures and tables.
    invalid : sequence of float
        Values that a device records in place of a sample, such as ``[-9999, 65535]``. They are left out.
    origin : datetime, optional
        The instant of time 0, if the times are known as dates.
    period : float
        Full turn of a sensor of an angle, such as 360 for a heading in degrees: its samples are then unwrapped, so that they
        continue beyond a full turn. 0 if it measures no angle. Sensors with the same period measure the same angle.
    gain : float
        How far the values move while the quantity moves by 1; negative if they move the other way. Values, less the bias, are
        divided by it.
    held : bool
        Whether a value that repeats the one before is no sample: the log is faster than the sensor and repeats its last value.

    Raises
    ------
    RecordingError
        If times and values do not have the same length, or times do not increase. The message distinguishes a clock that was set
        back from other causes.
    ModelError
        If a setting is no number, or is negative but must not be.

    Examples
    --------
    >>> import math
    >>> from bayesftc import monitoring
    >>> signal = monitoring.Signal([0.0, 0.1, 0.2, 0.3], [20.5, -9999, math.nan, 20.0], bias=0.5, invalid=[-9999])
    >>> [values.tolist() for values in signal.corrected]
    [[0.0, 0.3], [20.0, 19.5]]
    """

    time: ArrayLike
    values: ArrayLike
    bias: float = 0.0
    delay: float = 0.0
    smooth: float = 0.0
    resolution: float | None = None
    unit: str = ""
    invalid: Sequence[float] = ()
    origin: datetime | None = None
    period: float = 0.0
    gain: float = 1.0
    held: bool = False

    def __repr__(self) -> str:
        return short(self, delay="s", smooth="s")

    def __post_init__(self) -> None:
        given = np.asarray(self.time)
        if given.dtype.kind in "MUS" or any(hasattr(time, "isoformat") for time in given.ravel()[:1]):
            raise RecordingError(
                "A signal's times must be seconds, not dates or texts. From dates: (dates - start) / pandas.Timedelta('1 s'), "
                "with one start for all signals."
            )
        time, values = (np.asarray(given, dtype=np.float64) for given in (self.time, self.values))
        if time.ndim != 1 or time.shape != values.shape:
            raise RecordingError(f"A signal has {time.shape} times and {values.shape} values. Give one value per time.")
        for name in ("bias", "delay"):
            check_number(self, name)
        check_number(self, "smooth", least=0)
        check_number(self, "period", least=0)
        check_gain(self)
        check_number(self, "resolution", optional=True, least=0)
        usable = np.abs(values) <= LARGEST  # not if NaN
        kept = usable & ~np.isin(values, invalid_values("A signal", self.invalid, 1))
        if not np.isfinite(time[kept]).all():
            raise RecordingError("A signal has samples without a time. Remove them.")
        time, values = time[kept], values[kept]
        if not len(time) and (absurd := absurd_values(self.values)):
            raise RecordingError(f"A signal has no samples but {absurd}. Use a larger unit, or leave out the column.")
        if not len(time):
            raise RecordingError("A signal has no samples. Leave it out, or check its column.")
        time, values, repeated = without_repeats(time, values)
        if len(repeated):
            inform(_counted_once(repeated, self.origin))
        if problem := wrong_order(time, values, self.origin):
            raise RecordingError(problem)
        if self.held:
            time, values = without_held(time, values)
        if self.resolution is None:
            object.__setattr__(self, "resolution", find_resolution(values))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "values", values)

    @property
    def corrected(self) -> tuple[Floats, Floats]:
        """The samples' times in seconds without the delay, and their values without the bias and the gain."""
        return np.asarray(self.time) - self.delay, (np.asarray(self.values) - self.bias) / self.gain


def _counted_once(repeated: Floats, origin: datetime | None) -> str:
    """Return a message about samples that repeat the ones before, from their times."""
    first = time_text(repeated[0], origin)
    if len(repeated) == 1:
        return f"A sample at {first} repeats the time and the value of the one before. It counts once."
    return f"{len(repeated)} samples, the first at {first}, repeat time and value of the one before. Each counts once."


def _extremes(values: Floats) -> tuple[str, ...]:
    """Return the least value, the mean and the largest value, as texts."""
    present = values[np.isfinite(values)]
    return tuple(f"{of(present):.5g}" if len(present) else "–" for of in (np.min, np.mean, np.max))


def absurd_values(values: ArrayLike) -> str:
    """Return how many samples are too large in size, and the first of them; nothing if there is none."""
    given = np.asarray(values, dtype=np.float64)
    absurd = given[np.isfinite(given) & (np.abs(given) > LARGEST)]
    count = f"{len(absurd)} value{'s' if len(absurd) > 1 else ''}"
    return f"{count} above {LARGEST:g} in size, such as {absurd[0]:g}" if len(absurd) else ""


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples and inputs at the steps of a model; made by `align`.

    Attributes
    ----------
    start : float
        Time in seconds of the first step, at which every sensor has a sample already.
    dt : Fraction
        Seconds between two steps.
    sensors : tuple of str
        Their names.
    y : ndarray, steps x sensors
        Samples; NaN where there is none.
    u : ndarray, steps x inputs
        Inputs from each step to the next; NaN before their first sample.
    loss : tuple of float
        Share of the steps at which a healthy sensor has no sample, from its median interval.
    resolution : tuple of float
        Resolution of each sensor.
    replaced : tuple of int
        Number of samples of each sensor that were left out, because a later one belongs to the same step.
    units : tuple of str
        Unit of each sensor; empty if not known.
    inputs, input_units : tuple of str
        Names of the inputs, and the unit of each.
    origin : datetime or None
        The instant of time 0, if the times were dates.
    bias, gain : tuple of float
        What was subtracted from the samples of each sensor, and what they were divided by after that; empty if nothing was done.
    interval : tuple of float
        Seconds from one sample of each sensor to the next, if none is missing; empty if not known.
    better : Fraction or None
        Seconds between two steps with which fewer samples are left out, by their number; None if none are, or none is known.
    left_out : int
        Number of samples that are left out with `better`.
    silences : tuple of (str, float, float)
        Each input that has no sample for much longer than usual, although a sensor has, and the times of its last sample before
        and of the next one, in seconds.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> fast = monitoring.Signal([0.0, 0.1, 0.2, 0.3], [20.0, 20.1, 20.0, 19.9], unit="degC")
    >>> slow = monitoring.Signal([0.0, 0.2], [20.2, 20.3], unit="degC")
    >>> recording = monitoring.align({"fast": fast, "slow": slow}, {}, dt=0.1)
    >>> recording.y[:, 1].tolist(), recording.loss
    ([20.2, nan, 20.3, nan], (0.01, 0.5))
    """

    start: float
    dt: Fraction
    sensors: tuple[str, ...]
    y: Floats
    u: Floats
    loss: tuple[float, ...]
    resolution: tuple[float, ...]
    replaced: tuple[int, ...]
    units: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    input_units: tuple[str, ...] = ()
    origin: datetime | None = None
    bias: tuple[float, ...] = ()
    gain: tuple[float, ...] = ()
    interval: tuple[float, ...] = ()
    better: Fraction | None = None
    left_out: int = 0
    silences: tuple[Silence, ...] = ()

    def __repr__(self) -> str:
        return short(self, start="s", dt="s")

    def _repr_html_(self) -> str:
        """Return the sensors and inputs, for notebooks."""
        samples = [(name, self.y[:, i], self.units[i]) for i, name in enumerate(self.sensors)]
        samples += [(f"{name} (input)", self.u[:, j], self.input_units[j]) for j, name in enumerate(self.inputs)]
        rows = [
            (name, unit or "–", int(np.isfinite(values).sum()), *_extremes(values)) for name, values, unit in samples
        ]
        span = span_text(float(self.time[0]), float(self.time[-1]), self.origin)
        title = f"Recording: {span}, {len(self.y)} steps of {float(self.dt):g} s"
        return table(title, rows, ("", "unit", "steps with a value", "least", "mean", "largest"))

    def of_sensors(self, kept: Sequence[int]) -> Recording:
        """Return the recording of some of its sensors, by their numbers, in this order."""
        names = ("sensors", "loss", "resolution", "replaced", "units", "bias", "gain", "interval")
        fields: dict[str, Any] = {name: getattr(self, name) for name in names}
        chosen: dict[str, Any] = {name: tuple(values[i] for i in kept) for name, values in fields.items() if values}
        return replace(self, y=self.y[:, list(kept)], **chosen)

    def as_read(self, sensor: int, values: Floats) -> Floats:
        """Convert values of the measured quantity to readings of a sensor: with its bias and its gain."""
        bias, gain = (given[sensor] if given else usual for given, usual in ((self.bias, 0.0), (self.gain, 1.0)))
        return bias + gain * values

    def without(self, bias: Sequence[float], gain: Sequence[float]) -> Recording:
        """Return the recording with these biases subtracted and divided by these gains, whatever was subtracted before."""
        sensors = len(self.sensors)
        before, factor = np.array(self.bias or (0.0,) * sensors), np.array(self.gain or (1.0,) * sensors)
        if np.array_equal(before, bias) and np.array_equal(factor, gain):
            return self
        y = (self.y * factor + before - np.array(bias)) / np.array(gain)
        resolution = tuple((np.array(self.resolution) * np.abs(factor / np.array(gain))).tolist())
        return replace(self, y=y, resolution=resolution, bias=tuple(bias), gain=tuple(gain))

    @property
    def time(self) -> Floats:
        """Times of the steps in seconds."""
        return np.asarray(self.start + np.arange(len(self.y)) * float(self.dt), dtype=np.float64)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Stretches in which no sensor has a sample, because the logger stood still."""
        time = self.time
        return tuple(
            Gap(float(time[before]), float(time[after]), missed) for before, after, missed in find_gaps(self.y)
        )


def align(sensors: Mapping[str, Signal], inputs: Mapping[str, Signal], dt: float | str | Fraction) -> Recording:
    """Bring signals to common steps: each sample goes to the nearest step, each input is averaged up to the next step.

    Nothing is interpolated: a sensor without a sample near a step has none at that step. An input holds each sample from its
    time stamp until the next one. The value of the input at a step is the mean of this signal from the step to the next one. A
    time stamp within a twentieth of a step from a step counts as at that step, because it may be rounded. A sample of an angle
    (`Signal.period`) gets the number of full turns that brings it nearest to the last samples of the sensors of this angle.

    Parameters
    ----------
    sensors, inputs : mapping of str to Signal
        In the order of the model's sensors and inputs.
    dt : float, str or Fraction
        Seconds between two steps. A step longer than the interval of the fastest sensor loses samples.

    Returns
    -------
    Recording
        The samples and inputs at the steps, from the first one at which every sensor has a sample.

    Raises
    ------
    RecordingError
        If there is no sensor, the signals do not overlap in time, or there would be too many steps.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> signals = {name: monitoring.Signal([0.02, 0.11, 0.2], [20.0, y, 20.1]) for name, y in (("a", 20.2), ("b", 20.3))}
    >>> heater = monitoring.Signal([0.0, 0.15], [0.0, 1.0])
    >>> recording = monitoring.align(signals, {"heater": heater}, dt=0.1)
    >>> recording.y.tolist(), recording.u.round(2).tolist()
    ([[20.0, 20.0], [20.2, 20.3], [20.1, 20.1]], [[0.0], [0.7], [1.0]])
    """
    step = rational_step(dt, "The monitor's sample time")
    if not sensors:
        raise RecordingError("There is no sensor to monitor. Name at least one.")
    origin = next((signal.origin for signal in (*sensors.values(), *inputs.values()) if signal.origin), None)
    start, end = _overlap({**sensors, **inputs}, sensors, origin)
    if (end - start) / float(step) > MOST_STEPS:
        raise RecordingError(
            f"The recording of {end - start:g} s has more than {MOST_STEPS:,} steps of {show(step)} s. Check the unit of its "
            "times: without one in the name of their column, such as t_ms, they are in seconds."
        )
    if end - start < float(step) and any(len(signal.corrected[0]) > 1 for signal in sensors.values()):
        raise RecordingError(
            f"The recording from {time_text(start, origin)}, when the last sensor begins, to {time_text(end, origin)} is shorter "
            f"than one step of {show(step)} s. Give a smaller dt, about the interval of the fastest sensor."
        )
    _warn_of_a_late_sensor(sensors, start, end, origin)
    times = [signal.corrected[0] for signal in sensors.values()]
    first, start = start, first_step(max(times, key=len), start, float(step))
    steps = int(np.rint((end - start) / float(step))) + 1
    y, loss, replaced, interval = np.full((steps, len(sensors)), np.nan), [], [], []
    for i, signal in enumerate(sensors.values()):
        time, values = signal.corrected
        at = np.rint((time - start) / float(step)).astype(np.int64)
        inside = at >= 0
        y[at[inside], i] = values[inside]
        replaced.append(int(inside.sum() - np.isfinite(y[:, i]).sum()))
        loss.append(expected_loss(time, step))
        interval.append(typical_interval(time))
    turns = Turns(signal.period for signal in sensors.values())
    if turns.needed:
        y = np.array([turns.place(row) for row in y])
    ends: Floats = np.arange(1.0, steps + 1.0) * float(step)
    u = np.zeros((steps, max(len(inputs), 1)))
    for j, signal in enumerate(inputs.values()):
        time, values = signal.corrected
        u[:, j] = _mean_before(_snapped(time - start, float(step)), values, ends, max(signal.smooth, float(step)))
    resolution, units = zip(
        *((float(signal.resolution or 0.0) / abs(signal.gain), signal.unit) for signal in sensors.values()), strict=True
    )
    of_inputs = tuple(inputs), tuple(signal.unit for signal in inputs.values())
    better, left_out = _better(times, first, replaced)
    sampled = np.asarray(start + np.flatnonzero(np.isfinite(y).any(axis=1)) * float(step), dtype=np.float64)
    return Recording(
        start,
        step,
        tuple(sensors),
        y,
        u,
        tuple(loss),
        resolution,
        tuple(replaced),
        units,
        *of_inputs,
        origin,
        bias=tuple(float(signal.bias) for signal in sensors.values()),
        gain=tuple(float(signal.gain) for signal in sensors.values()),
        interval=tuple(interval),
        better=better,
        left_out=left_out,
        silences=silences(((name, signal.corrected[0]) for name, signal in inputs.items()), sampled, end),
    )


def _better(times: Sequence[Floats], first: float, replaced: Sequence[int]) -> tuple[Fraction | None, int]:
    """Return a step with which fewer samples are left out, and how many; the longest of the best ones."""
    if not any(replaced):
        return None, 0
    fastest = min((t for t, count in zip(times, replaced, strict=True) if count), key=typical_interval)
    usual = usual_step(fastest)
    counted = {step: _left_out(times, first, step) for step in (usual, usual / 2)}
    best = min(counted, key=lambda step: counted[step])
    return (best, counted[best]) if counted[best] < sum(replaced) else (None, 0)


def _left_out(times: Sequence[Floats], first: float, step: Fraction) -> int:
    """Return how many samples are left out with a step, because a later one belongs to the same."""
    start = first_step(max(times, key=len), first, float(step))
    at = [steps[steps >= 0] for steps in (np.rint((time - start) / float(step)) for time in times)]
    return sum(len(steps) - len(np.unique(steps)) for steps in at)


def expected_loss(time: Floats, step: Fraction) -> float:
    """Return the share of steps at which a healthy sensor has no sample, from the times of its samples in seconds."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else float("inf")
    return float(np.clip(1.0 - float(step) / interval, LEAST_LOSS, MOST_LOSS))


def _overlap(
    signals: Mapping[str, Signal], sensors: Mapping[str, Signal], origin: datetime | None
) -> tuple[float, float]:
    """Return the time from which every sensor has samples, and the end of the last one."""
    spans = {name: (float(s.corrected[0][0]), float(s.corrected[0][-1])) for name, s in signals.items()}
    late, early = max(spans, key=lambda name: spans[name][0]), min(spans, key=lambda name: spans[name][1])
    if spans[late][0] > spans[early][1]:
        raise RecordingError(
            f"The recordings of {early!r} ({span_text(*spans[early], origin)}) and {late!r} ({span_text(*spans[late], origin)}) "
            "do not overlap. Check that all times are in seconds from the same instant."
        )
    return max(spans[name][0] for name in sensors), max(spans[name][1] for name in sensors)


def _warn_of_a_late_sensor(sensors: Mapping[str, Signal], start: float, end: float, origin: datetime | None) -> None:
    begins = {name: float(signal.corrected[0][0]) for name, signal in sensors.items()}
    first, late = min(begins.values()), max(begins, key=lambda name: begins[name])
    if start - first > LATE * (end - first):
        warn_user(
            f"The recording is judged from {time_text(start, origin)} on, when {late} begins; "
            f"{spoken(start - first)} before that are left out. To judge them, leave {late} out."
        )


def _snapped(time: Floats, step: float) -> Floats:
    """Return times with those that only rounding keeps from a multiple of the step set to it."""
    multiple = np.rint(time / step)
    return np.where(np.abs(time / step - multiple) <= ROUNDING, multiple * step, time)


def _mean_before(time: Floats, values: Floats, ends: Floats, window: float) -> Floats:
    """Return the mean of a held signal over the window before each time; NaN before its first sample."""
    before = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time))])

    def integral(at: Floats) -> Floats:
        last = np.searchsorted(time, at, side="right") - 1
        return np.asarray(before[last] + values[last] * (at - time[last]))

    begins = np.maximum(ends - window, time[0])
    later = ends > begins
    u = np.full(len(ends), np.nan)
    u[later] = (integral(ends[later]) - integral(begins[later])) / (ends - begins)[later]
    return u
