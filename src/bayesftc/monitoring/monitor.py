"""A monitor: a recording's columns, the model of the measured quantity, and the settings of fault detection."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.block import extended_mean
from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.diagnosis.diagnose import diagnose_inputs
from bayesftc.controllers.diagnosis.finding import ModelFinding
from bayesftc.controllers.estimation.absurd import EXPLICABLE
from bayesftc.controllers.learning.learn_modes import LearnedModes, RecordedRun, learn_modes
from bayesftc.controllers.models.checks import as_vector
from bayesftc.controllers.models.linear import LinearModel, SignalNames
from bayesftc.controllers.precision.base import FixedPrecision, PrecisionLearner
from bayesftc.controllers.switching.fault_modes import Frozen
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.html import table, text_of
from bayesftc.cosim.base.invalid import numbers_of
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.recordings.columns import column_unit
from bayesftc.cosim.base.recordings.dates import date_at
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import ModelError, RecordingError, brief
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.alarms import Alarm
from bayesftc.monitoring.columns import Column, Input, Sensor, SensorErrors
from bayesftc.monitoring.csv import Tables, file_of, in_order, warn_of_changes
from bayesftc.monitoring.fit.columns import Place, placed, signals_by_name, stretch_of
from bayesftc.monitoring.fit.fit import fit_model
from bayesftc.monitoring.fit.units import in_unit
from bayesftc.monitoring.models import PlantModel
from bayesftc.monitoring.precision import default_precision
from bayesftc.monitoring.recording import Recording, Signal, align
from bayesftc.monitoring.run import Monitored, monitor_recording

if TYPE_CHECKING:
    import pandas as pd

FLAT = 10.0
"""Ratio of the initial belief's standard deviation to that of the first samples, from which it is computed: so they do not
count twice."""

SMALL = 1e-9

OPENING = 9
"""Number of first samples whose median the first sample must not contradict."""


def _are_paths(source: Sequence[Any]) -> bool:
    return bool(source) and all(isinstance(path, str | os.PathLike) for path in source)


def _as_recorded(signal: Signal, sensor: Sensor | None) -> Signal:
    """Return a signal with what the monitor knows of its sensor: a full turn, and which values stand for no sample."""
    if sensor is None:
        return signal
    invalid = (*signal.invalid, *numbers_of(sensor.invalid))
    return replace(signal, period=signal.period or sensor.period, held=signal.held or sensor.held, invalid=invalid)


@dataclass(frozen=True, eq=False)
class Monitor:
    r"""The content of a model file: the recording's columns, the model, the learner, the alarm.

    Parameters
    ----------
    dt : float, str or Fraction
        Sample time in seconds.
    plant : PlantModel
        The model of the state's motion.
    sensors, inputs : mapping of str to Sensor or Input
        By name.
    errors : sequence of SensorErrors
        Errors of the sensors that are estimated.
    precision : PrecisionLearner, optional
        By default that of `monitor_recording`.
    own_loss : bool
        Whether a `SwitchingPrecision` takes its loss from the sensors' rates.
    joint : bool
        Without `precision`: whether sensors are judged together. Two that agree then outvote a third one that drifts slowly, even
        if it is more precise. By default each is judged by itself.
    alarm : Alarm
        Conditions of an alarm.
    time : str
        The column of the time stamps, in seconds or in the unit that ends its name, as in ``t_ms`` or ``t [min]``.
    initial_mean, initial_std : optional
        Belief about the plant's states before the first sample; by default from the first samples.
    invalid : sequence of float or str
        Values that devices record in place of a sample, for all sensors and inputs.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "abc"}
    >>> monitor = monitoring.Monitor(0.1, monitoring.RandomWalk(std=0.02), sensors)
    >>> rows = [f"{k / 10},{20 + k % 3 / 10},{20 - k % 2 / 10},{20 + k % 5 / 20 + 3 * (k > 20)}" for k in range(40)]
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "tank.csv")
    ...     _ = file.write_text("\n".join(["t,a,b,c", *rows]))
    ...     monitored = monitor.run(monitor.read([file]))
    >>> [(event.sensor, event.kind) for event in monitored.events]
    [('c', 'Offset')]
    """

    dt: float | str | Fraction
    plant: PlantModel
    sensors: Mapping[str, Sensor]
    inputs: Mapping[str, Input] = field(default_factory=dict)
    errors: Sequence[SensorErrors] = ()
    precision: PrecisionLearner | None = None
    own_loss: bool = False
    alarm: Alarm = field(default_factory=Alarm)
    time: str = "t"
    initial_mean: float | Sequence[float] | None = None
    initial_std: float | Sequence[float] | None = None
    invalid: Sequence[float | str] = ()
    joint: bool = False

    def __post_init__(self) -> None:
        for name, sensor in self.sensors.items():
            if not isinstance(sensor, Sensor):
                raise ModelError(
                    f"The sensor {name!r} of Monitor is {brief(sensor)}; give Sensor(std=...). Monitor.fit makes the monitor of "
                    "a fitted model."
                )

    def __repr__(self) -> str:
        inputs = f", {counted(len(self.inputs), 'input')}" if self.inputs else ""
        return f"<Monitor: {counted(len(self.sensors), 'sensor')}{inputs}, steps of {float(self.dt):g} s, {text_of(self.plant)}>"

    def _repr_html_(self) -> str:
        """Return the model, the sensors and the inputs, for notebooks."""
        rows = [
            (name, s.unit or "–", f"{s.std:g}", "–" if s.resolution is None else f"{s.resolution:g}", f"{s.bias:g}")
            for name, s in self.sensors.items()
        ]
        shown = table(repr(self), rows, ("sensor", "unit", "std", "resolution", "bias"))
        inputs = [(name, i.unit or "–", f"{i.bias:g}") for name, i in self.inputs.items()]
        return shown + (table("Inputs", inputs, ("input", "unit", "bias")) if inputs else "")

    @classmethod
    def fit(
        cls,
        recording: Recording | Mapping[str, Signal] | pd.DataFrame | str | os.PathLike[str],
        stretch: slice | tuple[float | datetime | None, float | datetime | None] = slice(None),
        *,
        gains: bool = True,
        **settings: Any,
    ) -> tuple[Monitor, Recording]:
        """Return a monitor with a model fitted to a recording of sensors of one quantity, and the recording for its `run`.

        The monitor is for this recording and for later ones, from files or tables with the same columns; `run` subtracts the
        biases that the fit has found. `save` writes a model file; `as_model_file` returns the text of one with remarks, which
        ``bayesftc monitor --fit`` writes.

        Parameters
        ----------
        recording : Recording, mapping of str to Signal, DataFrame or path
            From `align`, or anything that `recorded` turns into a recording: a table with a column for each sensor, or a CSV
            file.
        stretch : slice or pair of times
            The part of the recording in which the sensors are healthy: a slice of steps, or its first and its last time (seconds
            of the recording, or dates; None for its beginning or its end); see `fit_model`.
        gains : bool
            Whether a sensor may have a gain other than 1; for angles give False.
        **settings
            Further ones of the monitor, such as ``alarm``.

        Raises
        ------
        RecordingError
            As for `recorded` and `fit_model`.
        ModelError
            If ``stretch`` or ``gains`` is something else.

        Examples
        --------
        >>> import numpy as np
        >>> import pandas as pd
        >>> from bayesftc import monitoring
        >>> rng, t = np.random.default_rng(0), 0.1 * np.arange(1000)
        >>> level = 20.0 + np.cumsum(0.05 * rng.standard_normal(1000))
        >>> y = level[:, None] + 0.1 * rng.standard_normal((1000, 3)) + [0.0, 0.0, 2.0]
        >>> y[700:, 1] += 1.5
        >>> monitor, corrected = monitoring.Monitor.fit(pd.DataFrame(y, columns=["a", "b", "c"], index=t))
        >>> [(event.sensor, event.kind) for event in monitor.run(corrected).events]
        [('b', 'Offset')]
        """
        places: dict[str, Place] = {}
        if not isinstance(recording, Recording):
            places, recording = placed(recording)
        count = len(recording.sensors)
        before = zip(recording.bias or (0.0,) * count, recording.gain or (1.0,) * count, strict=True)
        if isinstance(stretch, tuple | list) and len(stretch) == 2:
            stretch = stretch_of(recording, *stretch)
        if not isinstance(stretch, slice):
            raise ModelError(
                f"stretch is {brief(stretch)}; give a slice of steps, or the first and the last time, as (0.0, 60.0)."
            )
        if not isinstance(gains, bool):
            raise ModelError(f"gains is {brief(gains)}; it must be True or False.")
        fitted = fit_model(recording, stretch, gains=gains)
        files = {place.file for place in places.values()}
        sensors = {}
        for (name, s), unit, (bias, gain) in zip(fitted.sensors.items(), recording.units, before, strict=True):
            place = places.get(name, Place("", name, "t"))
            sensors[name] = Sensor(
                file=(place.file or None) if len(files) > 1 else None,
                column=place.column if place.column != name else None,
                time=place.time if len(files) > 1 else None,
                bias=bias + gain * s.bias,
                invalid=place.invalid,
                gain=gain * s.gain,
                std=s.std,
                resolution=abs(gain) * s.resolution,
                repeats=s.repeats,
                period=place.period,
                held=place.held,
                unit=unit,
            )
        if places:
            settings = {"time": next(iter(places.values())).time, **settings}
        mean, std = fitted.belief or (None, None)
        given = {"errors": fitted.errors, "joint": fitted.joint, "initial_mean": mean, "initial_std": std, **settings}
        monitor = cls(recording.dt, fitted.plant, sensors, **given)
        return monitor, monitor.recording(recording)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a model file, for ``bayesftc monitor --model`` and `load_monitor`; an existing one is replaced.

        Parameters
        ----------
        path : str or path
            The TOML file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        RecordingError
            If it cannot be written.
        ScenarioError
            If a setting cannot stand in a file, such as a model of the motion that you have written.

        Examples
        --------
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from bayesftc import monitoring
        >>> sensors = {"a": monitoring.Sensor(std=0.1, unit="m"), "b": monitoring.Sensor(std=0.2, bias=0.5)}
        >>> monitor = monitoring.Monitor(0.1, monitoring.RandomWalk(std=0.02), sensors, joint=True)
        >>> with TemporaryDirectory() as folder:
        ...     file = monitor.save(Path(folder, "tank.toml"))
        ...     print(*file.read_text().split(chr(10))[:6], sep=chr(10))
        ...     monitoring.load_monitor(file).sensors == sensors
        dt = 0.1
        joint = true
        <BLANKLINE>
        [model]
        kind = "RandomWalk"
        std = 0.02
        True
        """
        from bayesftc.monitoring.model_file import save_monitor

        return save_monitor(self, path)

    @property
    def _input_errors(self) -> bool:
        return any(given.error_std or given.error_walk for given in self.inputs.values())

    @property
    def model(self) -> LinearModel:
        """The linear model, with the errors of inputs and sensors as states."""
        A, B, _ = self.plant.matrices(1.0)
        count, states = 0 if B is None else B.shape[1], len(A)
        if len(self.inputs) != count:
            named = ", ".join(map(repr, self.inputs)) or "none"
            remedy = "Name each in [inputs.<name>]" if len(self.inputs) < count else "Remove the others"
            raise ModelError(
                f"The model {type(self.plant).__name__} has {count or 'no'} input{'s' * (count != 1)}, but [inputs] names "
                f"{named}. {remedy}, or use another model: Integrator has one input, Matrices one for each column of B, the "
                "others none."
            )
        first = [1.0] + [0.0] * (states - 1)
        C = np.array(
            [
                as_vector(f"'reads' of the sensor {name!r}", first if s.reads is None else s.reads, states)
                for name, s in self.sensors.items()
            ]
        )
        noise = np.diag(np.square([sensor.std for sensor in self.sensors.values()]))
        model = self.plant.linear(rational_step(self.dt), len(self.inputs), C, noise)
        if self._input_errors:
            # The covariance must be positive, even for an error that never changes.
            walks = [max(given.error_walk, SMALL) for given in self.inputs.values()]
            model = model.with_disturbance([walk * walk * float(model.step) for walk in walks])
        order = list(self.sensors)
        for errors in self.errors:
            chosen = None if errors.sensors is None else [order.index(name) for name in errors.sensors]
            model = model.with_sensor_errors(errors.std, errors.time_constant, chosen, common=errors.common)
        return model

    def recording(self, source: Recording | Mapping[str, Signal] | pd.DataFrame | str | os.PathLike[str]) -> Recording:
        """Return a recording for this monitor at its steps: without the biases and gains of its sensors.

        Parameters
        ----------
        source : Recording, mapping of str to Signal, DataFrame or path
            The samples of the monitor's sensors as they were recorded, or a recording from which biases are subtracted already.
            A table or file has the columns that the monitor reads.

        Raises
        ------
        RecordingError
            As for `read`.
        ModelError
            If a recording has other sensors.
        """
        if isinstance(source, str | os.PathLike) or (isinstance(source, list | tuple) and _are_paths(source)):
            return self.read(source)
        if hasattr(source, "to_csv"):
            with file_of(source, self.time) as (file, origin):  # type: ignore[arg-type]
                read = self.read(file)
            return replace(read, origin=origin or read.origin)
        of = self.sensors
        if not isinstance(source, Recording):
            given = signals_by_name(source)
            source = align({name: _as_recorded(signal, of.get(name)) for name, signal in given.items()}, {}, self.dt)
        if set(source.sensors) != set(of):
            names = (", ".join(map(repr, given)) for given in (source.sensors, of))
            raise ModelError("The recording has the sensors {}, but the monitor has {}.".format(*names))
        if source.sensors != tuple(of):
            source = source.of_sensors([source.sensors.index(name) for name in of])
        return source.without([sensor.bias for sensor in of.values()], [sensor.gain for sensor in of.values()])

    def read(self, paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> Recording:
        """Read the recording from CSV files, or folders of them, and bring it to the model's steps.

        Raises
        ------
        RecordingError
            As for `signals` and `align`.
        """
        return align(*self.signals(paths), self.dt)

    def signals(
        self, paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
    ) -> tuple[dict[str, Signal], dict[str, Signal]]:
        """Return the sensors' and the inputs' signals from CSV files, or folders of them, by name.

        Raises
        ------
        RecordingError
            If a file or column is missing, or contains anything but increasing times and numbers.
        """
        tables, cells = Tables(paths), dict[str, Floats]()

        def signal(name: str, given: Column, what: str, **more: Any) -> Signal:
            title = f"The {what} {name!r}"
            column = tables.called(given.column or name, given.file, title)
            files = tables.having(given.file, column, title)
            of_files = [tables.times(file, given.time or self.time, f" of the {what} {name!r}") for file in files]
            order = in_order(of_files)
            if order is None:
                raise RecordingError(
                    f"{title} is in {len(files)} files whose times overlap. Add file = 'name.csv', or give one file."
                )
            time = np.concatenate([of_files[i] for i in order])
            invalid = (*self.invalid, *given.invalid)
            logged = np.concatenate([tables.column(files[i], column, f"the {what} {name!r}", invalid) for i in order])
            file = files[0]
            if what == "sensor":
                cells[name] = logged
                more["unit"] = more["unit"] or column_unit(column)
            values = in_unit(logged, column, more["unit"])
            try:
                return Signal(
                    time, values, bias=given.bias, gain=given.gain, delay=given.delay, origin=tables.origin, **more
                )
            except RecordingError as error:
                raise RecordingError(f"{file}, the {what} {name!r}: {error}") from None

        sensors = {
            name: signal(
                name,
                s,
                "sensor",
                resolution=s.resolution,
                period=s.period,
                held=s.held,
                unit=s.unit,
            )
            for name, s in self.sensors.items()
        }
        warn_of_changes(cells)
        return sensors, {
            name: signal(name, i, "input", smooth=i.smooth, resolution=0.0, unit=i.unit)
            for name, i in self.inputs.items()
        }

    def compare(self, recording: Recording, monitored: Monitored | None = None) -> ModelFinding | None:
        """Compare the sensors' samples with the predictions of the model, driven by the recorded inputs.

        Parameters
        ----------
        recording : Recording
            From `read`.
        monitored : Monitored, optional
            What `run` returned for it: if nothing speaks against the model without the samples for which it blames their sensors,
            the finding names these sensors (the kind ``"sensors"``).

        Returns
        -------
        ModelFinding or None
            How the model is wrong, as from `bayesftc.controllers.diagnose_recording`. None without enough evidence against it.
        """
        if not recording.u.shape[1]:
            return None
        model = self.model
        states = tuple(f"x[{i}]" for i in range(model.states - model.disturbances))
        inputs = (*self.inputs, *(f"input {j}" for j in range(len(self.inputs), model.controls)))
        model = replace(model, names=SignalNames(inputs, tuple(self.sensors), states))  # for the sentences
        mean, _ = self.start(recording, model)
        start: Any = extended_mean(model, np.array(mean), mean)
        probability = None if monitored is None else monitored.fault_probability
        first = None if recording.origin is None else date_at(recording.origin, recording.start)
        return diagnose_inputs(model, recording.y, recording.u, start, probability, first)

    def run(
        self,
        recording: Recording | Mapping[str, Signal] | pd.DataFrame | str | os.PathLike[str],
        *,
        compiled: bool | None = None,
    ) -> Monitored:
        """Run the estimator over a recording; see `monitor_recording`.

        Parameters
        ----------
        recording : Recording, mapping of str to Signal, DataFrame or path
            See `recording`.
        compiled : bool, optional
            As for `monitor_recording`.
        """
        recording = self.recording(recording)
        model = self.model
        mean, covariance = self.start(recording, model)
        return monitor_recording(
            recording,
            model,
            self._precision(recording),
            initial_mean=mean,
            initial_covariance=covariance,
            alarm=self.alarm,
            compiled=compiled,
        )

    def estimator(self, recording: Recording) -> StateEstimator:
        """Return the estimator of a recording, or of the first samples of a longer one."""
        model = self.model
        return StateEstimator(model, self._precision(recording), *self.start(recording, model))

    def learn(
        self, recordings: Sequence[Recording], *, iterations: int = 20, compiled: bool | None = None
    ) -> LearnedModes:
        """Learn from recordings how often faults start and end and how large they are; see `learn_modes`.

        ``replace(monitor, precision=learned.precision)`` is the monitor with the learned modes.

        Parameters
        ----------
        recordings : sequence of Recording
            From `read`. The sensors' rates and resolutions come from the first one.
        iterations, compiled
            As for `learn_modes`.

        Raises
        ------
        ModelError
            If the precision learner has no modes, or there is no recording.
        """
        model = self.model
        runs = [RecordedRun(r.y, r.u, *self.start(r, model)) for r in recordings]
        first = self._precision(recordings[0]) if runs else None
        return learn_modes(runs, model, first, iterations=iterations, compiled=compiled)  # type: ignore[arg-type]

    def _precision(self, recording: Recording) -> PrecisionLearner:
        """Return the learner, with the sensors' rates, resolutions and repetitions."""
        defaults = {
            "resolution": recording.resolution,
            "healthy_repeats": tuple(sensor.repeats for sensor in self.sensors.values()),
        }
        if self.precision is None:
            return default_precision(recording.loss, *defaults.values(), joint=self.joint)
        if not isinstance(self.precision, SwitchingPrecision):
            return self.precision

        def completed(mode: Frozen) -> Frozen:
            """Return the mode with the recording's values for the settings that it leaves open."""
            more: dict[str, Any] = {k: v for k, v in defaults.items() if getattr(mode, k) == getattr(Frozen, k)}
            return replace(mode, **more)

        modes = [completed(mode) if isinstance(mode, Frozen) else mode for mode in self.precision.modes]
        return replace(self.precision, modes=modes, loss=recording.loss if self.own_loss else self.precision.loss)

    def start(self, recording: Recording, model: LinearModel) -> tuple[tuple[float, ...], Floats]:
        """Return the belief before the first sample: the given one, or one from the first sample of each sensor that has any.

        Raises
        ------
        ModelError
            If the sensors alone do not determine the state, and no belief is given.
        """
        plant = model.states - model.disturbances
        covariance = np.array(StateEstimator(model, FixedPrecision()).initial_covariance)
        if self._input_errors:
            variances = np.square([max(given.error_std, SMALL) for given in self.inputs.values()])
            covariance[plant : plant + len(variances), plant : plant + len(variances)] = np.diag(variances)
        seen = np.isfinite(recording.y).any(axis=0)
        C = model.matrix("C")[seen]
        given = self.initial_mean is not None and self.initial_std is not None
        if not given and np.linalg.matrix_rank(C[:, :plant]) < plant:
            raise ModelError(
                "The sensors alone do not determine all states of the model. Give initial_mean and initial_std in [model]."
            )
        noise = model.matrix("sensor_covariance")[np.ix_(seen, seen)]
        columns = recording.y.T[seen]
        first = np.array([_first(column, std) for column, std in zip(columns, np.sqrt(np.diag(noise)), strict=True)])
        inverse = np.linalg.pinv(C[:, :plant])
        mean = inverse @ first
        if self.initial_mean is not None:
            mean = as_vector("initial_mean", self.initial_mean, plant).copy()
            mean[0] += self._whole_turns(first - C[:, :plant] @ mean, np.flatnonzero(seen))
        if self.initial_std is None:
            errors = C[:, plant:] @ covariance[plant:, plant:] @ C[:, plant:].T + noise
            covariance[:plant, :plant] = FLAT * FLAT * inverse @ errors @ inverse.T
        else:
            covariance[:plant, :plant] = np.diag(as_vector("initial_std", self.initial_std, plant) ** 2)
        return tuple(map(float, mean)), (covariance + covariance.T) / 2

    def _whole_turns(self, apart: Floats, seen: Iterable[int]) -> float:
        """Return how far the belief must move, by full turns, to be near the first samples of an angle."""
        sensors = list(self.sensors.values())
        periods = np.array([sensors[i].period for i in seen])
        if not (angles := periods > 0).any():
            return 0.0
        period = float(periods[angles][0])
        return period * float(np.rint(np.median(apart[angles]) / period))


def _first(samples: Floats, std: float) -> float:
    """Return the first sample that is near the median of the first samples."""
    opening = samples[np.isfinite(samples)][:OPENING]
    near = np.abs(opening - np.median(opening)) <= np.sqrt(EXPLICABLE) * std
    return float(opening[near][0] if near.any() else opening[0])
