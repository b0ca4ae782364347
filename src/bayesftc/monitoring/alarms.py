"""Alarms: their times, their sensor or actuator, and its most probable fault."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.default_time import DefaultTime, time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.judging.findings import alarms, onset_of_alarm
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.gaps import Gap
from bayesftc.monitoring.recording import Recording

ACTUATOR_SIGNALS = ("fault_probability", "mode_probability", "fault_size")
"""Outputs of the estimator about its actuators; their names begin with ``actuator_``."""


@dataclass(frozen=True)
class Alarm:
    """Conditions of an alarm.

    Parameters
    ----------
    threshold : float
        Least fault probability of an alarm.
    hold : float
        Seconds below the threshold after which the alarm ends. By default 1 s, or ten samples if they are more than 0.1 s apart.

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
    """An alarm of a sensor.

    Attributes
    ----------
    sensor : str
        Name of the sensor.
    start, end : float
        Start and end of the alarm, in seconds of the recording.
    probability : float
        Largest fault probability during the alarm.
    kind : str or None
        Most probable fault mode at the end of the alarm, if the learner has modes.
    onset : float or None
        Estimated start of the fault, in seconds of the recording, never after the start of the alarm, nor before the end of an
        earlier alarm of the sensor. The learner estimates only the onset of the last kind, and the kind may have changed during
        the alarm.
    size : float or None
        Size of the fault at the end of the alarm: an offset in the sensor's unit; for `Noisier` and `Unmodelled`, the innovations
        as a multiple of the nominal noise.

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

    def __repr__(self) -> str:
        return short(self, start="s", end="s", onset="s")


@dataclass(frozen=True)
class ActuatorEvent:
    """An alarm of an actuator, or of the process where its input acts.

    Attributes
    ----------
    actuator : str
        Name of the input.
    start, end : float
        Start and end of the alarm, in seconds of the recording.
    probability : float
        Largest fault probability during the alarm.
    kind : str
        Most probable actuator mode at the end of the alarm.
    size : float or None
        Size of the fault at the end of the alarm: for `LostEffect` the lost share, otherwise in the input's unit.

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

    def __repr__(self) -> str:
        return short(self, start="s", end="s")


def sensor_events(
    recording: Recording, signals: Mapping[str, Floats], modes: Sequence[FaultMode], alarm: Alarm
) -> Iterator[FaultEvent]:
    """Give the alarms of each sensor. A fault that lasts over a gap of the recording is one alarm.

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
    gaps, hold = recording.gaps, time_at(alarm.hold, float(recording.dt))
    for event in _each(recording, signals, modes, alarm):
        if last is not None and _goes_on(last, event, gaps, hold):
            probability = max(last.probability, event.probability)
            last = replace(event, start=last.start, onset=last.onset, probability=probability)
            continue
        if last is not None:
            yield last
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
    time, faulty = recording.time, [k for k, mode in enumerate(modes, start=1) if mode.is_fault]
    for sensor, span, begin, end, i in _spans(recording, recording.sensors, signals["fault_probability"], alarm):
        if not modes:
            yield FaultEvent(sensor, *span)
            continue
        kind, last = _kind(signals["mode_probability"][begin:end, i], faulty)
        size, onset = (float(signals[name][begin + last, i]) for name in ("fault_size", "fault_onset"))
        yield FaultEvent(
            sensor,
            *span,
            kind=type(modes[kind - 1]).__name__,
            onset=float(time[0]) + onset if np.isfinite(onset) else None,
            size=size if np.isfinite(size) else None,
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
    faulty = list(range(1, 1 + len(modes)))
    for name, span, begin, end, j in _spans(recording, names, signals["actuator_fault_probability"], alarm):
        kind, last = _kind(signals["actuator_mode_probability"][begin:end, j], faulty)
        size = float(signals["actuator_fault_size"][begin + last, j])
        yield ActuatorEvent(name, *span, kind=type(modes[kind - 1]).__name__, size=size if np.isfinite(size) else None)


def _spans(
    recording: Recording, names: Sequence[str], probability: Floats, alarm: Alarm
) -> Iterator[tuple[str, tuple[float, float, float], int, int, int]]:
    """Give for each alarm: name; start, end, largest probability; first step, step after the last; column."""
    time, step = recording.time, float(recording.dt)
    hold = round(time_at(alarm.hold, step) / step)
    for i, name in enumerate(names):
        for begin, end in alarms(probability[:, i], alarm.threshold, hold):
            largest = float(probability[begin:end, i].max())
            yield name, (float(time[begin]), float(time[end - 1]), largest), begin, end, i


def _kind(p: Floats, faulty: Sequence[int]) -> tuple[int, int]:
    """Return the most probable fault mode at an alarm's end, and the last step at which it is the most probable mode."""
    kind = faulty[int(p[-1, faulty].argmax())]
    # The learner's size and onset at a step belong to the most probable mode of all, which can be another one.
    of_kind = np.flatnonzero(p.argmax(axis=1) == kind)
    return kind, int(of_kind[-1]) if len(of_kind) else len(p) - 1
