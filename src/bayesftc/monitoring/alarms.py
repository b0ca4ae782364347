"""Alarms: when there is one, of which sensor or actuator, and what is taken to be its fault."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.default_time import DefaultTime, time_at
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.recording import Recording


@dataclass(frozen=True)
class Alarm:
    """When there is an alarm.

    Parameters
    ----------
    threshold : float
        Fault probability from which on.
    hold : float
        Seconds for which the probability must stay below it for the alarm to end; by default one, and where samples are more
        than 0.1 s apart ten of them.

    Raises
    ------
    ModelError
        If the threshold is no probability, or `hold` is negative.
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
        Whose.
    start, end : float
        From when to when, in seconds of the recording.
    probability : float
        The largest fault probability meanwhile.
    kind : str or None
        The fault mode that was most probable when it ended, if the learner knows modes.
    onset : float or None
        When it is taken to have begun, in seconds of the recording; at the latest when the alarm started, for the kind may
        have changed meanwhile, and the learner knows the onset of the last one only.
    size : float or None
        Of the fault when it ended: an offset in the sensor's unit; of a noisier sensor its noise in nominal ones.
    """

    sensor: str
    start: float
    end: float
    probability: float
    kind: str | None = None
    onset: float | None = None
    size: float | None = None


@dataclass(frozen=True)
class ActuatorEvent:
    """An alarm of an actuator, or of the process where its input acts.

    Attributes
    ----------
    actuator : str
        Name of the input.
    start, end : float
        From when to when, in seconds of the recording.
    probability : float
        The largest fault probability meanwhile.
    kind : str
        The actuator mode that was most probable when it ended.
    size : float or None
        Of the fault when it ended: of `LostEffect` the share that is lost, else in the input's unit.
    """

    actuator: str
    start: float
    end: float
    probability: float
    kind: str
    size: float | None = None


def alarms(probability: Floats, threshold: float, hold: int) -> list[tuple[int, int]]:
    """Return the first step of each alarm and the one after its last; gaps of at most `hold` steps do not end it."""
    above = np.flatnonzero(probability >= threshold)
    if not len(above):
        return []
    breaks = np.flatnonzero(np.diff(above) > hold + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(above) - 1]])
    return [(int(above[a]), int(above[b]) + 1) for a, b in zip(first, last, strict=True)]


def sensor_events(
    recording: Recording, signals: Mapping[str, Floats], modes: Sequence[FaultMode], alarm: Alarm
) -> Iterator[FaultEvent]:
    """Give the alarms of each sensor.

    Parameters
    ----------
    recording : Recording
        Whose.
    signals : mapping of str to ndarray
        The estimator's outputs over time.
    modes : sequence of FaultMode
        Those that the learner knows; may be none.
    alarm : Alarm
        When there is one.
    """
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
            onset=min(float(time[0]) + onset, span[0]) if np.isfinite(onset) else None,
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
        As of `sensor_events`.
    names : sequence of str
        Of the actuators.
    modes : sequence of ActuatorMode
        Those that the learner knows.
    """
    faulty = list(range(1, 1 + len(modes)))
    for name, span, begin, end, j in _spans(recording, names, signals["actuator_fault_probability"], alarm):
        kind, last = _kind(signals["actuator_mode_probability"][begin:end, j], faulty)
        size = float(signals["actuator_fault_size"][begin + last, j])
        yield ActuatorEvent(name, *span, kind=type(modes[kind - 1]).__name__, size=size if np.isfinite(size) else None)


def _spans(
    recording: Recording, names: Sequence[str], probability: Floats, alarm: Alarm
) -> Iterator[tuple[str, tuple[float, float, float], int, int, int]]:
    """Give each alarm's name, its start, end and largest probability, its first step, the one after its last, its column."""
    time, step = recording.time, float(recording.dt)
    hold = round(time_at(alarm.hold, step) / step)
    for i, name in enumerate(names):
        for begin, end in alarms(probability[:, i], alarm.threshold, hold):
            largest = float(probability[begin:end, i].max())
            yield name, (float(time[begin]), float(time[end - 1]), largest), begin, end, i


def _kind(p: Floats, faulty: Sequence[int]) -> tuple[int, int]:
    """Return the mode that is the most probable fault at an alarm's end, and the last step that speaks of it."""
    kind = faulty[int(p[-1, faulty].argmax())]
    # Size and onset belong to the most probable mode of all, which at moments may be another one.
    own = np.flatnonzero(p.argmax(axis=1) == kind)
    return kind, int(own[-1]) if len(own) else len(p) - 1
