"""The run of the estimator over a recording, and the faults that it finds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.recorded import estimate
from bayesftc.controllers.models.checks import Matrix
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.base import PrecisionLearner
from bayesftc.controllers.switching.actuator_settings import check_controls
from bayesftc.controllers.switching.fault_modes import Burst
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.recordings.dates import span_text, time_text
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.signals import Flags
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import (
    ACTUATOR_SIGNALS,
    ActuatorEvent,
    Alarm,
    Disagreement,
    FaultEvent,
    actuator_events,
    disagreements,
    sensor_events,
)
from bayesftc.monitoring.gaps import in_gaps
from bayesftc.monitoring.precision import default_precision
from bayesftc.monitoring.recording import Recording
from bayesftc.monitoring.rest import at_rest, held, known, surprises

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

HEALTHY = "healthy"
FOUND_OPEN = "A fault was found, but not in which sensor: see disagreements."
Event = TypeVar("Event", FaultEvent, ActuatorEvent)

MANY_BURSTS, AROUND, MOST = 0.01, 10, 0.8
"""Share of a sensor's samples from which on its bursts have a note; steps around one in which no other sensor has any; share of
the bursts whose span the note has."""


@dataclass(frozen=True, eq=False)
class Monitored:
    """The results of a monitor for a recording.

    Attributes
    ----------
    recording : Recording
        The samples.
    model : LinearModel
        The model of the estimator.
    fault_probability : ndarray, steps x sensors
        Fault probability of each sensor at each step; NaN where the learner gives none.
    kinds : tuple of str
        Names of the modes, the first being ``"healthy"``; empty if the learner has no modes.
    mode_probability : ndarray, steps x sensors x modes
        Probability of each mode.
    x_hat : ndarray, steps x states
        The belief's mean.
    innovation : ndarray, steps x sensors
        Samples minus predictions.
    events : tuple of FaultEvent
        Alarms in the order of their start.
    rest : ndarray, steps
        Whether all sensors repeat their values at once, as in a parked car: then the quantity or the logger is at rest, which is
        no fault. At these steps the fault probabilities of sensors keep their values, as in the gaps of the recording. The
        belief also keeps its value, and there is no innovation. The latter two do not hold if all sensors but one are coarse.
    why_no_probability : str or None
        Why there are no probabilities, as a sentence.
    actuators : tuple of str
        Names of the inputs with actuator modes; empty if the learner has none.
    actuator_fault_probability : ndarray, steps x actuators
        Fault probability of each actuator.
    actuator_kinds : tuple of str
        Names of the actuators' modes, the first being ``"healthy"``.
    actuator_mode_probability : ndarray, steps x actuators x modes
        Probability of each mode.
    actuator_events : tuple of ActuatorEvent
        The actuators' alarms in the order of their start.
    alarm : Alarm
        The conditions of an alarm.
    joint : bool
        Whether sensors were judged together.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(60), 0.1 * np.random.default_rng(0).standard_normal((60, 3))
    >>> noise[30:, 1] += 2.0  # the second of three thermometers jumps at 3 s
    >>> signals = {name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("abc")}
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=0.1)
    >>> monitored = monitoring.monitor_recording(monitoring.align(signals, {}, dt=0.1), model, initial_mean=20.0)
    >>> monitored.to_pandas()[["t", "a", "b", "b_kind"]].iloc[[29, 40]].round(2)
          t    a    b   b_kind
    29  2.9  0.0  0.0  healthy
    40  4.0  0.0  1.0   Offset
    """

    recording: Recording
    model: LinearModel
    fault_probability: Floats
    kinds: tuple[str, ...]
    mode_probability: Floats
    x_hat: Floats
    innovation: Floats
    events: tuple[FaultEvent, ...]
    rest: Flags
    why_no_probability: str | None = None
    actuators: tuple[str, ...] = ()
    actuator_fault_probability: Floats = field(default_factory=lambda: np.empty((0, 0)))
    actuator_kinds: tuple[str, ...] = ()
    actuator_mode_probability: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))
    actuator_events: tuple[ActuatorEvent, ...] = ()
    alarm: Alarm = field(default_factory=Alarm)
    joint: bool = False

    def __repr__(self) -> str:
        begun = [event for of in (self.events, self.actuator_events) for event in of if not event.continued]
        alarms = counted(len(begun), "alarm")
        sensors, steps = counted(len(self.recording.sensors), "sensor"), len(self.recording.y)
        return f"<Monitored: {sensors}, {steps} steps of {float(self.recording.dt):g} s, {alarms}>"

    def _repr_html_(self) -> str:
        """Return the sensors and their alarms, for notebooks; `plot` draws them."""
        recording, origin = self.recording, self.recording.origin
        rows = [
            (
                name,
                int(np.isfinite(recording.y[:, i]).sum()),
                f"{self.fault_probability[:, i].mean():.4f}",
                sum(event.sensor == name and not event.continued for event in self.events),
            )
            for i, name in enumerate(recording.sensors)
        ]
        span = span_text(float(self.time[0]), float(self.time[-1]), origin)
        title = f"{span}, {len(self.time)} steps of {float(recording.dt):g} s"
        shown = table(title, rows, ("sensor", "samples", "mean fault probability", "alarms"))
        found = [
            (
                event.sensor,
                event.kind or "–",
                "–" if event.onset is None else time_text(event.onset, origin),
                span_text(event.start, event.end, origin),
                "–" if event.size is None else f"{event.size:.3g}",
                f"{event.probability:.3f}",
            )
            for event in self.events
        ]
        header = ("sensor", "kind", "onset", "alarm", "size", "largest probability")
        nothing = FOUND_OPEN if self.disagreements else "No fault was found."
        faults = table("Faults", found, header) if found else f"<p>{nothing}</p>"
        notes = "".join(f"<p>{escape(text)}</p>" for text in self.burst_notes())
        return shown + faults + notes

    @property
    def time(self) -> Floats:
        """Times of the steps in seconds."""
        return self.recording.time

    @property
    def bursts(self) -> dict[str, float]:
        """Share of the samples of each sensor that are bursts: with far more noise for a short time, which is no fault.

        Empty if the learner does not distinguish them (`bayesftc.controllers.Burst`).
        """
        return {name: float(np.mean(flags)) if len(flags) else 0.0 for name, (flags, _) in self._bursts().items()}

    def burst_notes(self) -> list[str]:
        """Return a sentence for each sensor with many bursts of its own, from 1 % of its samples on.

        Bursts that another sensor has at the same time do not count: their cause is the quantity or the model, such as a bump,
        and not the sensor.
        """
        notes = []
        for name, (flags, time) in self._bursts(alone=True).items():
            if len(flags) and np.mean(flags) >= MANY_BURSTS:
                most, first, last = _densest(time[flags])
                notes.append(
                    f"{name} has {counted(int(flags.sum()), 'burst')} ({np.mean(flags):.1%} of its samples), {most} of them from "
                    f"{span_text(first, last, self.recording.origin)}: samples with far more noise, while the other sensors have "
                    "none. A burst is no fault and hardly counts in the belief. So many may be a loose contact or a reflection."
                )
        return notes

    def _bursts(self, *, alone: bool = False) -> dict[str, tuple[Flags, Floats]]:
        """Return which samples of each sensor are bursts, and their times; `alone`: those while no other sensor has one."""
        if Burst.__name__ not in self.kinds:
            return {}
        likely = self.mode_probability[:, :, self.kinds.index(Burst.__name__)] > 0.5
        if alone:
            near = np.array([np.convolve(of, np.ones(2 * AROUND + 1), "same") > 0.5 for of in likely.T.astype(float)]).T
            likely &= near.sum(axis=1, keepdims=True) == 1
        there = np.isfinite(self.recording.y)
        names = self.recording.sensors
        return {name: (likely[there[:, i], i], self.time[there[:, i]]) for i, name in enumerate(names)}

    @property
    def disagreements(self) -> tuple[Disagreement, ...]:
        """Times in which one of two sensors is faulty, but it is open which one, in the order of their start.

        There are none if sensors were judged one by one: the sum of two probabilities then is no probability.
        """
        if not self.joint:
            return ()
        found = disagreements(self.recording, self.fault_probability, self.alarm)
        return tuple(sorted(found, key=lambda each: each.start))

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each step: the time ``t``, and for each sensor its fault probability and kind.

        If the times of the recording were dates, ``date`` has those of the steps. The other columns have the sensors' names; with
        modes there are also columns with ``_kind``, the most probable mode. The names of actuators' columns begin with
        ``actuator_``.
        """
        import pandas as pd

        columns: dict[str, Any] = {"t": self.time}
        if self.recording.origin is not None:
            since = pd.to_timedelta(np.rint(self.time * 1e6), unit="us")
            columns["date"] = pd.Timestamp(self.recording.origin) + since
        for i, sensor in enumerate(self.recording.sensors):
            columns[sensor] = self.fault_probability[:, i]
            if self.kinds:
                columns[f"{sensor}_kind"] = np.array(self.kinds)[self.mode_probability[:, i].argmax(axis=1)]
        for j, name in enumerate(self.actuators):
            columns[f"actuator_{name}"] = self.actuator_fault_probability[:, j]
            most = self.actuator_mode_probability[:, j].argmax(axis=1)
            columns[f"actuator_{name}_kind"] = np.array(self.actuator_kinds)[most]
        return pd.DataFrame(columns)

    def plot(self) -> Figure:
        """Return the figure: samples and belief, samples minus belief, and the fault probabilities."""
        from bayesftc.cosim.judging.figures.panels import shown_figure
        from bayesftc.monitoring.figure import plot_monitored

        return plot_monitored(self, shown_figure())


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
        By default a `SwitchingPrecision` for recordings, with the sensors' rates.
    initial_mean, initial_covariance : optional
        Belief before the first sample, as for `StateEstimator`.
    alarm : Alarm, optional
        Conditions of an alarm; by default a fault probability of at least 0.9.
    compiled : bool, optional
        False to run the plain Python form, with the same numbers. By default the Python form runs for a short recording, because
        compilation would take longer.

    Returns
    -------
    Monitored
        The fault probabilities, the belief and the alarms.

    Raises
    ------
    ModelError
        If model and recording do not fit together.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers, monitoring
    >>> t, noise = 0.1 * np.arange(60), 0.1 * np.random.default_rng(0).standard_normal((60, 3))
    >>> noise[30:, 1] = noise[30, 1]  # the second of three thermometers freezes at 3 s
    >>> signals = {name: monitoring.Signal(t, 20.0 + noise[:, i]) for i, name in enumerate("abc")}
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-4, 0.01, dt=0.1)
    >>> monitored = monitoring.monitor_recording(monitoring.align(signals, {}, dt=0.1), model, initial_mean=20.0)
    >>> [(event.sensor, event.kind, round(event.onset, 1)) for event in monitored.events]
    [('b', 'Frozen', 3.1)]
    """
    shape = (model.sensors, model.controls, model.step)
    if shape != (recording.y.shape[1], recording.u.shape[1], recording.dt):
        raise ModelError(
            f"The model has {model.sensors} sensors, {model.controls} input(s) and steps of {float(model.step):g} s, but the "
            f"recording has {recording.y.shape[1]}, {recording.u.shape[1]} and {float(recording.dt):g} s. They must be equal."
        )
    if precision is None:
        precision = default_precision(recording.loss, recording.resolution)
    actuators = recording.inputs or tuple(f"input {j}" for j in range(model.controls))
    actuator_modes = precision.actuator_modes
    check_controls(actuator_modes, model, [f"the input {name!r}" for name in actuators])
    estimator = StateEstimator(model, precision, initial_mean, initial_covariance)
    switching = precision if isinstance(precision, SwitchingPrecision) else None
    modes = switching.modes if switching else ()
    judged = judged_names(precision)
    names = signal_names(precision)
    rest = at_rest(recording.y)
    asleep = known(rest) & surprises(recording, model)
    signals = estimate(estimator, np.where(asleep[:, np.newaxis], np.nan, recording.y), recording.u, names, compiled)
    signals = held(signals, judged, recording.y, rest, in_gaps(recording.y))
    signals["x_hat"] = signals["x_hat"][np.maximum.accumulate(np.where(asleep, 0, np.arange(len(asleep))))]
    alarm = alarm or Alarm()
    monitored = Monitored(
        recording,
        model,
        signals["fault_probability"],
        _kinds(modes),
        signals.get("mode_probability", np.empty((len(recording.y), model.sensors, 0))),
        signals["x_hat"],
        signals["innovation"],
        _in_order(sensor_events(recording, signals, modes, alarm)),
        rest,
        precision.why_no_probability,
        alarm=alarm,
        joint=bool(getattr(precision, "joint", False)),
    )
    if not actuator_modes:
        return monitored
    return replace(
        monitored,
        actuators=actuators,
        actuator_fault_probability=signals["actuator_fault_probability"],
        actuator_kinds=_kinds(actuator_modes),
        actuator_mode_probability=signals["actuator_mode_probability"],
        actuator_events=_in_order(actuator_events(recording, actuators, signals, actuator_modes, alarm)),
    )


def judged_names(precision: PrecisionLearner) -> list[str]:
    """Return the names of the outputs about the faults of the sensors, which keep their values at rest."""
    modes = precision.modes if isinstance(precision, SwitchingPrecision) else ()
    return ["fault_probability", *(["mode_probability", "fault_size", "fault_onset"] if modes else [])]


def signal_names(precision: PrecisionLearner) -> list[str]:
    """Return the names of the estimator's outputs that a monitor needs."""
    of_actuators = [f"actuator_{name}" for name in ACTUATOR_SIGNALS] if precision.actuator_modes else []
    return ["x_hat", "innovation", *judged_names(precision), *of_actuators]


def _densest(time: Floats) -> tuple[int, float, float]:
    """Return the shortest span with at least `MOST` of some instants: how many of them it has, its first and its last."""
    spanned = int(np.ceil(MOST * len(time))) - 1
    first = int(np.argmin(time[spanned:] - time[: len(time) - spanned]))
    return spanned + 1, float(time[first]), float(time[first + spanned])


def _kinds(modes: Sequence[object]) -> tuple[str, ...]:
    return (HEALTHY, *(type(mode).__name__ for mode in modes)) if modes else ()


def _in_order(events: Iterable[Event]) -> tuple[Event, ...]:
    return tuple(sorted(events, key=lambda event: event.start))
