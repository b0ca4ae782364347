"""The run of the estimator over a recording, and the faults that it finds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers._checks import Matrix, check_number
from bayesftc.controllers._recorded import estimate
from bayesftc.controllers.estimator import StateEstimator
from bayesftc.controllers.fault_modes import Burst, Drifting, DroppedOut, FaultMode, Frozen, Noisier, Offset
from bayesftc.controllers.model import LinearModel
from bayesftc.controllers.precision import PrecisionLearner
from bayesftc.controllers.switching import SwitchingPrecision
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import ModelError
from bayesftc.monitoring._recording import Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

HEALTHY = "healthy"


@dataclass(frozen=True)
class Alarm:
    """When there is an alarm.

    Parameters
    ----------
    threshold : float
        Fault probability from which on.
    hold : float
        Seconds for which the probability must stay below it for the alarm to end.

    Raises
    ------
    ModelError
        If the threshold is no probability, or `hold` is negative.
    """

    threshold: float = 0.9
    hold: float = 1.0

    def __post_init__(self) -> None:
        check_number(self, "threshold", above=0, below=1)
        check_number(self, "hold", least=0)


@dataclass(frozen=True)
class FaultEvent:
    """An alarm.

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
        When it is taken to have begun, in seconds of the recording.
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


@dataclass(frozen=True, eq=False)
class Monitored:
    """What a monitor has found in a recording.

    Attributes
    ----------
    recording : Recording
        The samples.
    model : LinearModel
        What was believed.
    fault_probability : ndarray, steps x sensors
        Of each sensor at each step; NaN where the learner says nothing.
    kinds : tuple of str
        Names of the modes, the first being ``"healthy"``; empty if the learner knows none.
    mode_probability : ndarray, steps x sensors x modes
        Probability of each.
    x_hat : ndarray, steps x states
        The belief's mean.
    innovation : ndarray, steps x sensors
        Samples minus what was expected.
    events : tuple of FaultEvent
        Alarms in the order of their start.
    why_no_probability : str or None
        Why there are no probabilities, as a sentence.
    """

    recording: Recording
    model: LinearModel
    fault_probability: Floats
    kinds: tuple[str, ...]
    mode_probability: Floats
    x_hat: Floats
    innovation: Floats
    events: tuple[FaultEvent, ...]
    why_no_probability: str | None = None

    @property
    def time(self) -> Floats:
        """Times of the steps in seconds."""
        return self.recording.time

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each step: the time ``t``, and for each sensor its fault probability and kind.

        The columns have the sensors' names, and these with ``_kind`` (the most probable mode) where the learner knows modes.
        """
        import pandas as pd

        columns: dict[str, Any] = {"t": self.time}
        for i, sensor in enumerate(self.recording.sensors):
            columns[sensor] = self.fault_probability[:, i]
            if self.kinds:
                columns[f"{sensor}_kind"] = np.array(self.kinds)[self.mode_probability[:, i].argmax(axis=1)]
        return pd.DataFrame(columns)

    def plot(self) -> Figure:
        """Return the figure: samples and belief, the samples' distance from it, and the fault probabilities."""
        from bayesftc.monitoring._figure import plot_monitored

        return plot_monitored(self)


def default_precision(loss: Sequence[float], resolution: Sequence[float]) -> SwitchingPrecision:
    """Return the learner of a monitor: every kind of fault, each once in an hour, and harmless bursts of noise.

    Offsets may be large and drifts fast, for nobody knows how a recording's faults are; times are in seconds and sizes in the
    sensors' own standard deviations, so that it fits any quantity. Sensors are judged one by one: in the joint form, on a real
    drive, a fault that has been found casts doubt on sensors that share errors with the faulty one.

    Parameters
    ----------
    loss : sequence of float
        As of `SwitchingPrecision`.
    resolution : sequence of float
        Of each sensor, in its unit.
    """
    rare = {"time_to_fault": 3600.0}
    modes = (
        Frozen(**rare, dither=0.001, resolution=tuple(resolution)),
        Offset(**rare, jump=30.0, walk=0.02),
        Drifting(**rare, slope=0.1),
        Noisier(**rare, scale=5.0),
        DroppedOut(**rare),
        Burst(scale=5.0),
    )
    return SwitchingPrecision(modes, loss=tuple(loss), joint=False)


def monitor_recording(
    recording: Recording,
    model: LinearModel,
    precision: PrecisionLearner | None = None,
    *,
    initial_mean: float | tuple[float, ...] = 0.0,
    initial_covariance: Matrix | None = None,
    alarm: Alarm | None = None,
    compiled: bool | None = None,
) -> Monitored:
    """Run the estimator over a recording and list the faults that it finds.

    Parameters
    ----------
    recording : Recording
        Samples and inputs, from `align`.
    model : LinearModel
        With a row of C for each sensor, a column of B for each input, and the recording's sample time.
    precision : PrecisionLearner, optional
        By default a `SwitchingPrecision` for recordings, with the sensors' own rates.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.
    alarm : Alarm, optional
        When there is one; by default from a fault probability of 0.9 on.
    compiled : bool, optional
        False to step through the plain Python form, with the same numbers; by default a short recording does, which is over
        before anything is compiled.

    Raises
    ------
    ModelError
        If model and recording do not fit together.
    """
    shape = (model.sensors, model.controls, model.step)
    if shape != (recording.y.shape[1], recording.u.shape[1], recording.dt):
        raise ModelError(
            f"The model has {model.sensors} sensors, {model.controls} input(s) and steps of {float(model.step):g} s; the "
            f"recording has {recording.y.shape[1]}, {recording.u.shape[1]} and {float(recording.dt):g} s. They must be the same."
        )
    if precision is None:
        precision = default_precision(recording.loss, recording.resolution)
    estimator = StateEstimator(model, precision, initial_mean, initial_covariance)
    names = ["x_hat", "innovation", "fault_probability"]
    modes = precision.modes if isinstance(precision, SwitchingPrecision) else ()
    if modes:
        names += ["mode_probability", "fault_size", "fault_onset"]
    signals = estimate(estimator, recording.y, recording.u, names, compiled)
    kinds: tuple[str, ...] = ()
    if modes:
        kinds = (HEALTHY, *(type(mode).__name__ for mode in modes))
    empty = np.empty((len(recording.y), model.sensors, 0))
    found = Monitored(
        recording,
        model,
        signals["fault_probability"],
        kinds,
        signals.get("mode_probability", empty),
        signals["x_hat"],
        signals["innovation"],
        (),
        precision.why_no_probability,
    )
    events = sorted(_events(found, signals, modes, alarm or Alarm()), key=lambda event: event.start)
    return replace(found, events=tuple(events))


def alarms(probability: Floats, threshold: float, hold: int) -> list[tuple[int, int]]:
    """Return the first step of each alarm and the one after its last; gaps of at most `hold` steps do not end it."""
    above = np.flatnonzero(probability >= threshold)
    if not len(above):
        return []
    breaks = np.flatnonzero(np.diff(above) > hold + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(above) - 1]])
    return [(int(above[a]), int(above[b]) + 1) for a, b in zip(first, last, strict=True)]


def _events(
    found: Monitored, signals: dict[str, Floats], modes: Sequence[FaultMode], alarm: Alarm
) -> Iterator[FaultEvent]:
    time, faulty = found.time, [k for k, mode in enumerate(modes, start=1) if mode.is_fault]
    for i, sensor in enumerate(found.recording.sensors):
        for begin, end in alarms(
            found.fault_probability[:, i], alarm.threshold, round(alarm.hold / float(found.recording.dt))
        ):
            span = (
                sensor,
                float(time[begin]),
                float(time[end - 1]),
                float(found.fault_probability[begin:end, i].max()),
            )
            if not modes:
                yield FaultEvent(*span)
                continue
            p = found.mode_probability[begin:end, i]
            kind = faulty[int(p[-1, faulty].argmax())]
            # Size and onset belong to the most probable mode of all, which at moments may be another one.
            own = np.flatnonzero(p.argmax(axis=1) == kind)
            last = begin + int(own[-1]) if len(own) else end - 1
            size, onset = (float(signals[name][last, i]) for name in ("fault_size", "fault_onset"))
            yield FaultEvent(
                *span,
                kind=found.kinds[kind],
                onset=float(time[0]) + onset if np.isfinite(onset) else None,
                size=size if np.isfinite(size) else None,
            )
