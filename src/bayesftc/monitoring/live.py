"""A monitor as the stepper of a live run: samples come from wires instead of a recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.cosim.base.invalid import numbers_of
from bayesftc.cosim.base.recordings.held import HeldValues
from bayesftc.cosim.base.recordings.turns import Turns
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.live.steppers import Stepper
from bayesftc.cosim.ports import Port
from bayesftc.cosim.run.online import Online
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.columns import Input, Sensor
from bayesftc.monitoring.gaps import GapWatch
from bayesftc.monitoring.monitor import OPENING, Monitor
from bayesftc.monitoring.recording import LEAST_LOSS, Recording, expected_loss
from bayesftc.monitoring.rest import RestWatch, surprises
from bayesftc.monitoring.run import judged_names, signal_names

FINDING = 30
"""Samples of a sensor from which its resolution is estimated, if the model file does not have it."""

LONGEST = 300
"""Steps after which monitoring begins without the sensors that have sent no sample, and with few of others."""

ONSET = "fault_onset"


class MonitorStepper(Stepper):
    """The step of a monitor whose samples arrive now, for `bayesftc.cosim.live.run_live`.

    Its inputs have the names of the sensors and of the known inputs, its outputs those of the signals of `StateEstimator`.

    Monitoring begins when each sensor has sent 9 samples (30 if its resolution is not given), at the latest after 300 steps.
    From these samples come the belief at the beginning, and the rates and resolutions of the sensors, as from a recording. They
    are then judged at once. Until then, all outputs are NaN.

    An input acts from the first step after its arrival until the next step. A sample that arrives between two steps counts at
    the second one; so samples and inputs are late by the same time.

    Parameters
    ----------
    monitor : Monitor
        The content of a model file. Its columns and files have no effect.
    compiled : bool
        False for the plain Python form.

    Attributes
    ----------
    began : float or None
        Time of the first step that was judged, in seconds; None before monitoring begins.
    estimator : StateEstimator
        The estimator; its learner has the modes.

    Raises
    ------
    ModelError
        If a sensor or input has a delay, or the monitor needs more than the sensors for its belief at the beginning.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1, resolution=0.0) for name in "abc"}
    >>> monitor = monitoring.Monitor(0.1, monitoring.RandomWalk(std=0.02), sensors)
    >>> stepper = monitoring.MonitorStepper(monitor, compiled=False)
    >>> stepper.prepare()
    >>> rng = np.random.default_rng(0)
    >>> for k in range(60):
    ...     samples = 20.0 + 0.1 * rng.standard_normal(3)
    ...     outputs = stepper.advance(samples + [0.0, 2.0 * (k >= 30), 0.0])
    >>> outputs[stepper.output_places("fault_probability")].round(2).tolist()
    [0.0, 1.0, 0.0]
    """

    def __init__(self, monitor: Monitor, *, compiled: bool = True):
        columns: dict[str, Sensor | Input] = {**monitor.sensors, **monitor.inputs}
        for name, column in columns.items():
            if column.delay:
                raise ModelError(
                    f"{name!r} has delay = {column.delay:g} s, but a live monitor judges each sample when it arrives. Remove the "
                    "delay: without it, the sample counts for the step of its arrival."
                )
        self.step = rational_step(monitor.dt, "The monitor's sample time")
        self.inputs = {name: Port(name, unit=column.unit or None) for name, column in columns.items()}
        self.outputs: Mapping[str, Port] = {}
        self.began: float | None = None
        self.estimator = monitor.estimator(self._recording(monitor, np.zeros((1, len(monitor.sensors)))))
        self._monitor, self._compiled = monitor, compiled
        self._bias, self._gain = np.array([(column.bias, column.gain) for column in columns.values()]).T
        self._invalid = [np.array(numbers_of((*monitor.invalid, *column.invalid))) for column in columns.values()]
        windows = [max(1, round(given.smooth / float(self.step))) for given in monitor.inputs.values()]
        self._smoothed: list[deque[float]] = [deque(maxlen=window) for window in windows]
        self._opening: deque[tuple[Floats, Floats]] = deque(maxlen=LONGEST)
        self._rest, self._gap = RestWatch(len(monitor.sensors)), GapWatch(len(monitor.sensors))
        self._held = HeldValues(sensor.held for sensor in monitor.sensors.values())
        self._turns = Turns(sensor.period for sensor in monitor.sensors.values())
        self._running: Online | None = None
        self._surprised, self._belief = False, np.zeros(0)
        self._k = -1
        self._enough = [OPENING if sensor.resolution is not None else FINDING for sensor in monitor.sensors.values()]

    def _prepare(self) -> None:
        online = self.estimator.online(compiled=self._compiled)
        self._step_of(online, np.full(len(self._monitor.sensors), np.nan), np.zeros(self.estimator.model.controls))
        names = signal_names(self.estimator.precision)
        self.outputs = {name: online.outputs[name] for name in names}
        self._judged = judged_names(self.estimator.precision)

    def bears_missing(self, name: str) -> bool:
        """Return whether it is a sensor."""
        return name in self._monitor.sensors

    @property
    def k(self) -> int:
        """The number of the last step; -1 before the first."""
        return self._k

    @property
    def gap_since(self) -> float | None:
        """Time of the last sample in seconds, as long as no sensor sends any; the fault probabilities keep their values."""
        since = self._gap.since
        return None if since is None or self.began is None else self.began + since * float(self.step)

    @property
    def silent(self) -> list[str]:
        """The sensors that have sent no sample, as long as monitoring has not begun."""
        counts = self._sent().items() if self.began is None else ()
        return [name for name, count in counts if not count]

    @property
    def waits_for(self) -> str:
        """Which sensors have sent too few samples for monitoring to begin, as text; empty once it has begun."""
        if self.began is not None:
            return ""
        counts = zip(self._sent().items(), self._enough, strict=True)
        few = [f"{name} has sent {n} of the first {need} samples" for (name, n), need in counts if 0 < n < need]
        return "; ".join([f"no sample yet of {', '.join(self.silent)}"] * bool(self.silent) + few)

    def _sent(self) -> dict[str, int]:
        """Return the number of samples of each sensor so far."""
        names = list(self._monitor.sensors)
        return {name: sum(bool(np.isfinite(y[i])) for y, _ in self._opening) for i, name in enumerate(names)}

    def advance(self, inputs: Floats) -> Floats:
        """Judge the samples of a step: those of all sensors, then the inputs; NaN or None is a missing one.

        Raises
        ------
        ModelError
            If there are more or fewer, one is no number, or `prepare` was not called.
        """
        if not (isinstance(inputs, np.ndarray) and inputs.dtype.kind in "fiub"):
            inputs = np.array([self._number(k, value) for k, value in enumerate(inputs)])
        if inputs.shape != self._bias.shape:
            names = ", ".join(self.inputs)
            raise ModelError(f"A step of the monitor has {len(self._bias)} samples ({names}), not {len(inputs)}.")
        if not self.outputs:
            raise ModelError("The monitor's steps are not made yet. Call prepare() before the first advance().")
        self._k += 1
        values = (inputs - self._bias) / self._gain
        for i, invalid in enumerate(self._invalid):
            if np.isin(inputs[i], invalid):
                values[i] = np.nan
        sensors = len(self._monitor.sensors)
        values[:sensors][self._held.repeated(values[:sensors])] = np.nan
        y = self._turns.place(values[:sensors])
        u = self._averaged(values[sensors:])
        if self._running is not None:
            return self._judge(self._running, y, u)
        self._opening.append((y, u))
        first = self._first()
        if first is None:
            return np.full(sum(port.size for port in self.outputs.values()), np.nan)
        rows = list(self._opening)[first:]
        self._opening.clear()
        self.began = (self._k + 1 - len(rows)) * float(self.step)
        opening = self._recording(self._monitor, np.array([y for y, _ in rows]))
        self.estimator = self._monitor.estimator(opening)
        self._surprised = surprises(opening, self.estimator.model)
        self._running = self.estimator.online(compiled=self._compiled)
        return [self._judge(self._running, *row) for row in rows][-1]

    def _number(self, k: int, value: float | None) -> float:
        try:
            return np.nan if value is None else float(value)
        except (TypeError, ValueError, OverflowError):
            name = [*self.inputs, f"value {k}"][min(k, len(self.inputs))]
            raise ModelError(
                f"The sample of {name} is {value!r}. Give a number; NaN or None is a missing sample."
            ) from None

    def _averaged(self, values: Floats) -> Floats:
        """Return the known inputs, each averaged over its last values."""
        for kept, value in zip(self._smoothed, values, strict=True):
            kept.append(float(value))
        means = [
            np.mean(there) if (there := [v for v in kept if np.isfinite(v)]) else np.nan for kept in self._smoothed
        ]
        return np.array(means or np.zeros(self.estimator.model.controls))

    def _first(self) -> int | None:
        """Return the first step to judge, at which every sensor has sent a sample; None if monitoring cannot begin yet."""
        there = np.isfinite([y for y, _ in self._opening])
        counts = there.sum(axis=0)
        if (counts < self._enough).any() and (len(there) < LONGEST or not self._determined(counts > 0)):
            return None
        return int(there[:, counts > 0].argmax(axis=0).max(initial=0))

    def _determined(self, seen: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> bool:
        """Return whether some of the sensors determine the belief at the beginning."""
        if self._monitor.initial_mean is not None and self._monitor.initial_std is not None:
            return True
        model = self.estimator.model
        plant = model.states - model.disturbances
        return int(np.linalg.matrix_rank(model.matrix("C")[seen, :plant])) == plant

    def _recording(self, monitor: Monitor, y: Floats) -> Recording:
        """Return what the first samples say of the sensors."""
        sensors = monitor.sensors
        times = [np.asarray(np.flatnonzero(np.isfinite(column)) * float(self.step)) for column in y.T]
        given = [None if s.resolution is None else s.resolution / abs(s.gain) for s in sensors.values()]
        return Recording(
            start=0.0,
            dt=self.step,
            sensors=tuple(sensors),
            y=y,
            u=np.zeros((len(y), max(len(monitor.inputs), 1))),
            loss=tuple(expected_loss(time, self.step) if len(time) > 1 else LEAST_LOSS for time in times),
            resolution=tuple(find_resolution(y[:, i]) if r is None else r for i, r in enumerate(given)),
            replaced=(0,) * len(sensors),
            units=tuple(sensor.unit for sensor in sensors.values()),
            bias=tuple(sensor.bias for sensor in sensors.values()),
            gain=tuple(sensor.gain for sensor in sensors.values()),
        )

    def _judge(self, online: Online, y: Floats, u: Floats) -> Floats:
        rests = self._rest.see(y) and self._surprised
        signals = self._step_of(online, np.full_like(y, np.nan) if rests else y, u)
        signals["x_hat"] = self._belief = self._belief if rests else signals["x_hat"]
        if ONSET in signals:
            signals[ONSET] = signals[ONSET] + (self.began or 0.0)
        signals |= self._gap.feed(y, self._rest.hold({name: signals[name] for name in self._judged}))
        return np.concatenate([signals[name].ravel() for name in self.outputs])

    @staticmethod
    def _step_of(online: Online, y: Floats, u: Floats) -> dict[str, Floats]:
        return {name: np.asarray(value) for name, value in online(y=y, u=u).items()}
