"""Alarms: their times, their sensor or actuator, and its most probable fault."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.default_time import DefaultTime, time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.judging.findings import SURE_ONSET, onset_of_alarm, onset_of_kind, size_at_end
from bayesftc.cosim.judging.parts import Part, alarms, parts_of_alarms, plain_kinds
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.gaps import Gap
from bayesftc.monitoring.recording import Recording

ACTUATOR_SIGNALS = ("fault_probability", "mode_probability", "fault_size")
"""Outputs of the estimator about its actuators; their names begin with ``actuator_``."""

CERTAIN, MATERIAL = 0.9, 0.1
"""Fault probability from which one sensor alone is meant, and below which a sensor is not one of the two."""

EITHER, LASTS = 0.95, 50
"""Sum of the fault probabilities of two sensors from which one of them is faulty, and for how many samples at least."""


@dataclass(frozen=True)
class Alarm:
    """Conditions of an alarm.

    Parameters
    ----------
    threshold : float
        Least fault probability of an alarm.
    hold : float
        An alarm ends when the fault probability has been below the threshold for so many seconds: by default 1 s, but at least 10
        and at most 200 samples. After a shorter time it goes on, unless the fault is then of another kind.

    Raises
    ------
    ModelError
        If the threshold is no probability, or `hold` is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(60), 0.1 * np.random.default_rng(0).standard_normal((60, 3))
    >>> noise[30:, 1] += 1.0  # the second of three sensors jumps at 3 s
    >>> recording = monitoring.align({name: monitoring.Signal(t, noise[:, i]) for i, name in enumerate("abc")}, {}, dt=0.1)
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=0.1)
    >>> for threshold in (0.5, 0.999):
    ...     alarm = monitoring.Alarm(threshold=threshold, hold=2.0)
    ...     print(round(monitoring.monitor_recording(recording, model, alarm=alarm).events[0].start, 1))
    3.3
    3.6
    """

    threshold: float = 0.9
    hold: float = DefaultTime(1.0, usual_step=0.1)

    def __post_init__(self) -> None:
        check_number(self, "threshold", above=0, below=1)
        check_number(self, "hold", least=0)


@dataclass(frozen=True)
class FaultEvent:
    """An alarm of a sensor; or, if the kind of an alarm changes for good, a part of the alarm.

    Attributes
    ----------
    sensor : str
        Name of the sensor.
    start, end : float
        Start and end, in seconds of the recording.
    probability : float
        Largest fault probability.
    kind : str or None
        Fault mode with the largest mean probability, if the learner has modes.
    onset : float or None
        Estimated start of the fault, in seconds of the recording, never after `start`, nor before the end of an earlier alarm of
        the sensor.
    size : float or None
        Size of the fault at the end: an offset in the sensor's unit; for `Noisier` and `Unmodelled`, the innovations as a
        multiple of the nominal noise.
    continued : bool
        Whether it is a later part of an alarm, which had another kind before.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(60), 0.1 * np.random.default_rng(0).standard_normal((60, 3))
    >>> noise[30:, 1] += 2.0  # the second of three thermometers jumps at 3 s
    >>> signals = {name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("abc")}
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=0.1)
    >>> monitored = monitoring.monitor_recording(monitoring.align(signals, {}, dt=0.1), model, initial_mean=20.0)
    >>> event = monitored.events[0]
    >>> event.sensor, event.kind, round(event.start, 1), round(event.size, 1)
    ('b', 'Offset', 3.3, 2.0)
    """

    sensor: str
    start: float
    end: float
    probability: float
    kind: str | None = None
    onset: float | None = None
    size: float | None = None
    continued: bool = field(default=False, repr=False)

    def __repr__(self) -> str:
        return short(self, start="s", end="s", onset="s")


@dataclass(frozen=True)
class ActuatorEvent:
    """An alarm of an actuator, or of the process where its input acts; or, if its kind changes for good, a part of it.

    Attributes
    ----------
    actuator : str
        Name of the input.
    start, end : float
        Start and end, in seconds of the recording.
    probability : float
        Largest fault probability.
    kind : str
        Actuator mode with the largest mean probability.
    size : float or None
        Size of the fault at the end: for `LostEffect` the lost share, otherwise in the input's unit.
    continued : bool
        As for `FaultEvent`.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(100)
    >>> flow = np.sin(t)
    >>> change = 0.1 * flow * np.where(t < 4.0, 1.0, 0.3)  # from 4 s on 70 % of the flow are lost
    >>> level = np.cumsum(change) - change  # the flow at t acts after t
    >>> sensors = {name: monitoring.Signal(t, level + 0.01 * rng.standard_normal(100)) for name in "ab"}
    >>> recording = monitoring.align(sensors, {"flow": monitoring.Signal(t, flow)}, dt=0.1)
    >>> model = controllers.LinearModel([[1.0]], [[0.1]], [[1.0], [1.0]], 1e-5, 1e-4, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(actuator_modes=[controllers.LostEffect()])
    >>> event = monitoring.monitor_recording(recording, model, learner).actuator_events[0]
    >>> event.actuator, event.kind, round(event.start, 1), round(event.size, 1)
    ('flow', 'LostEffect', 4.2, 0.7)
    """

    actuator: str
    start: float
    end: float
    probability: float
    kind: str
    size: float | None = None
    continued: bool = field(default=False, repr=False)

    def __repr__(self) -> str:
        return short(self, start="s", end="s")


@dataclass(frozen=True)
class Disagreement:
    """A time in which one of two sensors is faulty, but neither has an alarm, because it is not known which one.

    It is meant for learners that judge sensors together. Only for these is the sum of the two fault probabilities the probability
    that one of the two sensors is faulty.

    Attributes
    ----------
    sensors : tuple of str
        Names of the two.
    start, end : float
        Start and end, in seconds of the recording.
    probability : float
        Largest sum of their fault probabilities, at most 1.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(400), 0.1 * np.random.default_rng(0).standard_normal((400, 2))
    >>> noise[200:, 1] += 0.01 * np.arange(200)  # the second of two thermometers drifts from 20 s on
    >>> signals = {name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("ab")}
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 2, 1.0, 0.01, dt=0.1)
    >>> recording, learner = monitoring.align(signals, {}, dt=0.1), controllers.SwitchingPrecision(joint=True)
    >>> monitored = monitoring.monitor_recording(recording, model, learner, initial_mean=20.0)
    >>> [(each.sensors, round(each.start)) for each in monitored.disagreements]
    [(('a', 'b'), 22)]
    """

    sensors: tuple[str, str]
    start: float
    end: float
    probability: float

    def __repr__(self) -> str:
        return short(self, start="s", end="s")


def disagreements(recording: Recording, probability: Floats, alarm: Alarm) -> Iterator[Disagreement]:
    """Give the times of at least `LASTS` samples in which only the fault probabilities of two sensors together are large.

    Parameters
    ----------
    recording : Recording
        The recording.
    probability : ndarray, steps x sensors
        Fault probabilities.
    alarm : Alarm
        Conditions of an alarm.
    """
    step = float(recording.dt)
    hold = round(time_at(alarm.hold, step) / step)
    quiet = probability.max(axis=1, initial=0.0) < min(alarm.threshold, CERTAIN)
    for i, j in combinations(range(probability.shape[1]), 2):
        open_ = quiet & (np.minimum(probability[:, i], probability[:, j]) >= MATERIAL)
        together = np.where(open_, probability[:, i] + probability[:, j], 0.0)
        for begin, end in alarms(together, EITHER, hold):
            if end - begin >= LASTS:
                start, last = float(recording.time[begin]), float(recording.time[end - 1])
                names = recording.sensors[i], recording.sensors[j]
                yield Disagreement(names, start, last, min(float(together[begin:end].max()), 1.0))


def sensor_events(
    recording: Recording, signals: Mapping[str, Floats], modes: Sequence[FaultMode], alarm: Alarm
) -> Iterator[FaultEvent]:
    """Give the alarms of each sensor, in parts if the kind changed. A fault that lasts over a gap of the recording is one alarm.

    Parameters
    ----------
    recording : Recording
        The recording.
    signals : mapping of str to ndarray
        The estimator's outputs over time.
    modes : sequence of FaultMode
        The learner's modes; may be empty.
    alarm : Alarm
        Conditions of an alarm.
    """
    last: FaultEvent | None = None
    earlier: float | None = None  # end of the alarm before
    gaps, hold = recording.gaps, time_at(alarm.hold, float(recording.dt))
    for event in _each(recording, signals, modes, alarm):
        if last is not None and _goes_on(last, event, gaps, hold):
            probability = max(last.probability, event.probability)
            last = replace(event, start=last.start, onset=last.onset, probability=probability, continued=last.continued)
            continue
        if last is not None:
            yield last
        if not event.continued:
            earlier = last.end if last is not None and last.sensor == event.sensor else None
        last = replace(event, onset=onset_of_alarm(event.onset, event.start, earlier))
    if last is not None:
        yield last


def _goes_on(event: FaultEvent, later: FaultEvent, gaps: Sequence[Gap], hold: float) -> bool:
    """Return whether the later alarm is of the same fault, which the learner may have forgotten in a gap of the recording.

    In a long gap the fault may have ended. So the learner infers it again, from the first samples after the gap on.
    """
    if (event.sensor, event.kind) != (later.sensor, later.kind):
        return False
    onset = later.start if later.onset is None else later.onset
    return any(event.start <= gap.start <= event.end + hold and gap.start < onset <= gap.end + hold for gap in gaps)


def _each(
    recording: Recording, signals: Mapping[str, Floats], modes: Sequence[FaultMode], alarm: Alarm
) -> Iterator[FaultEvent]:
    first, p = float(recording.time[0]), signals["fault_probability"]
    of_modes = signals["mode_probability"] if modes else None
    for sensor, span, part, i in _spans(recording, recording.sensors, p, of_modes, modes, alarm):
        if not modes:
            yield FaultEvent(sensor, *span)
            continue
        most = signals["mode_probability"][:, i].argmax(axis=1)
        kind = name_of_kind(modes, part.kind)
        size = size_at_end(signals["fault_size"][:, i], most, part, [type(mode).__name__ for mode in modes])
        onset = onset_of_kind(signals["fault_onset"][:, i], most, part, first=kind in SURE_ONSET)
        yield FaultEvent(
            sensor,
            *span,
            kind=kind or None,
            onset=None if onset is None else first + onset,
            size=size,
            continued=part.begin > part.alarm,
        )


def actuator_events(
    recording: Recording,
    names: Sequence[str],
    signals: Mapping[str, Floats],
    modes: Sequence[ActuatorMode],
    alarm: Alarm,
) -> Iterator[ActuatorEvent]:
    """Give the alarms of each actuator.

    Parameters
    ----------
    recording, signals, alarm
        As for `sensor_events`.
    names : sequence of str
        Names of the actuators.
    modes : sequence of ActuatorMode
        The learner's modes.
    """
    p, of_modes = signals["actuator_fault_probability"], signals["actuator_mode_probability"]
    for name, span, part, j in _spans(recording, names, p, of_modes, modes, alarm):
        most, kinds = of_modes[:, j].argmax(axis=1), [type(mode).__name__ for mode in modes]
        size = size_at_end(signals["actuator_fault_size"][:, j], most, part, kinds)
        yield ActuatorEvent(
            name, *span, kind=name_of_kind(modes, part.kind), size=size, continued=part.begin > part.alarm
        )


def fault_chances(of_modes: Floats, modes: Sequence[FaultMode | ActuatorMode]) -> Floats:
    """Return the probability of each mode that is a fault from those of all, healthy first; 0 for harmless modes."""
    faulty = [getattr(mode, "is_fault", True) for mode in modes]
    return np.where(faulty, of_modes[..., 1:], 0.0)


def name_of_kind(modes: Sequence[object], number: int) -> str:
    """Return the name of a mode from its number, counted from 1; empty for 0."""
    return type(modes[number - 1]).__name__ if number else ""


def _spans(
    recording: Recording,
    names: Sequence[str],
    probability: Floats,
    of_modes: Floats | None,
    modes: Sequence[FaultMode | ActuatorMode],
    alarm: Alarm,
) -> Iterator[tuple[str, tuple[float, float, float], Part, int]]:
    """Give for each part of an alarm: name; start, end, largest probability; its steps and kind; column."""
    time, step = recording.time, float(recording.dt)
    hold, plain = round(time_at(alarm.hold, step) / step), plain_kinds([type(mode).__name__ for mode in modes])
    for i, name in enumerate(names):
        chances = None if of_modes is None else fault_chances(of_modes[:, i], modes)
        for part in parts_of_alarms(probability[:, i], chances, alarm.threshold, hold, step, plain):
            a, b = part.begin, part.end
            yield name, (float(time[a]), float(time[b - 1]), float(np.nanmax(probability[a:b, i]))), part, i
