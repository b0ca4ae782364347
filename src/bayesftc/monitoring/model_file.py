"""The model file of a monitor, in TOML: reading and writing."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc import controllers, monitoring
from bayesftc.controllers.precision.base import PrecisionLearner
from bayesftc.controllers.registry import LEARNERS
from bayesftc.controllers.switching.actuator_settings import check_controls
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.campaign.store.durable import write_whole
from bayesftc.cosim.errors import RecordingError, ScenarioError
from bayesftc.monitoring.alarms import Alarm
from bayesftc.monitoring.columns import Input, Sensor, SensorErrors
from bayesftc.monitoring.models import PLANT_MODELS
from bayesftc.monitoring.monitor import Monitor
from bayesftc.scenario._files import find_scenario, read_toml
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import as_table, build, build_one_of
from bayesftc.scenario._written import toml

SECTIONS = ("dt", "time", "invalid", "joint", "model", "sensors", "inputs", "errors", "precision", "alarm")


@dataclass(frozen=True)
class Start:
    """The initial belief in ``[model]``.

    Attributes
    ----------
    initial_mean : number or sequence of number
        Mean of the quantity, or of each state of a linear model, at the first sample; by default from
        the first samples.
    initial_std : number or sequence of number
        Its standard deviation.
    """

    initial_mean: float | Sequence[float] | None = None
    initial_std: float | Sequence[float] | None = None


@dataclass(frozen=True)
class Head:
    """The settings above all sections.

    Attributes
    ----------
    dt : float or str
        Sample time in seconds.
    time : str
        The column of the time stamps, in seconds.
    invalid : sequence of float or str
        Values that devices record in place of a sample, for all sensors and inputs.
    joint : bool
        Without ``[precision]``: whether sensors are judged together, so that two that agree outvote a third one.
    """

    dt: float | str
    time: str = "t"
    invalid: Sequence[float | str] = ()
    joint: bool = False


def load_monitor(path: str | os.PathLike[str]) -> Monitor:
    r"""Read a monitor's model file and check its content.

    Parameters
    ----------
    path : str or path
        A TOML file.

    Returns
    -------
    Monitor
        The content of the file.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or if a key is unknown, missing or of a wrong type. The message names the key and its place.
    BayesFTCError
        If a setting is not valid. The message begins with its place in the file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import monitoring
    >>> text = "dt = 0.1\nmodel = { kind = 'RandomWalk', std = 0.02 }\nsensors.a.std = 0.1\nsensors.b.std = 0.2\n"
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "tank.toml")
    ...     _ = file.write_text(text)
    ...     monitor = monitoring.load_monitor(file)
    >>> monitor.model.sensor_covariance.round(2).tolist()
    [[0.01, 0.0], [0.0, 0.04]]
    """
    file = find_scenario(path, "monitor's model")
    content, root = read_toml(file), Place(str(file))
    root.refuse_unknown(content, SECTIONS, "section")
    for name in ("dt", "model", "sensors"):
        if name not in content:
            raise root.error(f"lacks {name!r}. A model file needs dt = ..., [model] and [sensors.<name>].")
    head: Head = build(Head, {key: content[key] for key in ("dt", "time", "invalid", "joint") if key in content}, root)
    table = dict(as_table(content["model"], root / "model"))
    start: Start = build(
        Start, {key: table.pop(key) for key in ("initial_mean", "initial_std") if key in table}, root / "model"
    )
    sensors = _named(content["sensors"], Sensor, root / "sensors")
    errors = content.get("errors", [])
    if not isinstance(errors, list):
        raise (root / "errors").error("must be a list of tables. Write [[errors]], with two brackets, above each.")
    if "joint" in content and "precision" in content:
        raise (root / "joint").error("holds without [precision] only. Move it into [precision].")
    precision, own_loss = _precision(content.get("precision"), root / "precision")
    monitor = Monitor(
        dt=head.dt,
        plant=build_one_of(PLANT_MODELS, table, root / "model"),
        sensors=sensors,
        inputs=_named(content.get("inputs", {}), Input, root / "inputs"),
        errors=tuple(_errors(table, root / "errors" / i, sensors) for i, table in enumerate(errors)),
        precision=precision,
        own_loss=own_loss,
        alarm=build(Alarm, content.get("alarm", {}), root / "alarm"),
        time=head.time,
        invalid=head.invalid,
        joint=head.joint,
        initial_mean=start.initial_mean,
        initial_std=start.initial_std,
    )
    with root.named():
        model = monitor.model
        if precision is not None:
            if monitor.inputs:
                check_controls(precision.actuator_modes, model, [f"the input {name!r}" for name in monitor.inputs])
            precision.learner(model)
    return monitor


def _named(table: object, cls: type[Any], place: Place) -> dict[str, Any]:
    """Return an instance of `cls` for each table in a table."""
    tables = as_table(table, place)
    if not tables and cls is Sensor:
        raise place.error("has no sensor. Write [sensors.<name>] with std = ... below it.")
    return {name: build(cls, value, place / name) for name, value in tables.items()}


def _errors(table: object, place: Place, sensors: Mapping[str, Sensor]) -> SensorErrors:
    errors: SensorErrors = build(SensorErrors, table, place)
    place.refuse_unknown(errors.sensors or (), sensors, "sensor")
    return errors


def _precision(table: object, place: Place) -> tuple[PrecisionLearner | None, bool]:
    """Return the learner, and whether its loss comes from the sensors' rates."""
    if table is None:
        return None, False
    learner: PrecisionLearner = build_one_of(LEARNERS, table, place)
    return learner, isinstance(learner, SwitchingPrecision) and "loss" not in as_table(table, place)


def save_monitor(monitor: Monitor, path: str | os.PathLike[str]) -> Path:
    """Write a model file, as `bayesftc.monitoring.Monitor.save` describes."""
    file = expanded(path)
    # With a learner of one's own, `joint` has no effect, and a file refuses it.
    joint = monitor.joint and monitor.precision is None
    content: dict[str, Any] = {
        "dt": _plain(monitor.dt),
        **({"time": monitor.time} if monitor.time != Head.time else {}),
        **({"invalid": _plain(monitor.invalid)} if monitor.invalid else {}),
        **({"joint": True} if joint else {}),
        "model": {**_named_kind(monitor.plant), **_changed(Start(monitor.initial_mean, monitor.initial_std))},
        "sensors": {name: _plain(sensor) for name, sensor in monitor.sensors.items()},
        "inputs": {name: _plain(each) for name, each in monitor.inputs.items()},
        "errors": [_plain(each) for each in monitor.errors],
        "alarm": _plain(monitor.alarm),
    }
    content = {name: value for name, value in content.items() if value not in ({}, [])}
    if monitor.precision is not None:
        content["precision"] = _named_kind(monitor.precision)
        if isinstance(monitor.precision, SwitchingPrecision):  # a file without its loss has that of the sensors' rates
            content["precision"].pop("loss", None)
            if not monitor.own_loss:
                content["precision"]["loss"] = _plain(monitor.precision.loss)
    text = toml(content)
    try:
        write_whole(file, text.encode())
    except OSError as error:
        raise RecordingError(f"{file} cannot be written: {error.strerror or error}. Name another file.") from None
    return file


def _plain(value: Any) -> Any:
    """Return a setting as texts, numbers, lists and tables."""
    if is_dataclass(value):
        return _changed(value)
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, Fraction):
        return float(value) if rational_step(float(value)) == value else str(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple):
        return [_named_kind(each) if is_dataclass(each) else _plain(each) for each in value]
    return value


def _named_kind(thing: Any) -> dict[str, Any]:
    """Return the table of an object whose class is chosen by ``kind``."""
    name = type(thing).__name__
    if not any(getattr(package, name, None) is type(thing) for package in (controllers, monitoring)):
        raise ScenarioError(f"The class {name} is your own, and a model file can name only those of this package.")
    return {"kind": name, **_changed(thing)}


def _changed(thing: Any) -> dict[str, Any]:
    """Return the settings of a dataclass that differ from their defaults."""
    settings = {}
    for each in fields(thing):
        value = getattr(thing, each.name)
        default = each.default if each.default_factory is MISSING else each.default_factory()
        if each.init and not each.metadata.get("derived") and not _same(value, default):
            settings[each.name] = _named_kind(value) if is_dataclass(value) else _plain(value)
    return settings


def _same(value: Any, default: Any) -> bool:
    if value is default or default is MISSING:
        return value is default
    return is_dataclass(value) == is_dataclass(default) and _plain([value]) == _plain([default])
