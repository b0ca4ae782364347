"""The estimator as a monitor: recorded samples of redundant sensors in, each sensor's fault probability out.

>>> from bayesftc.monitoring import load_monitor
>>> monitor = load_monitor("model.toml")  # doctest: +SKIP
>>> found = monitor.run(monitor.read(["data.csv"]))  # doctest: +SKIP
>>> print(found.events)  # doctest: +SKIP
"""

from bayesftc.monitoring._alarms import ActuatorEvent, Alarm, FaultEvent
from bayesftc.monitoring._columns import Column, Input, Sensor, SensorErrors
from bayesftc.monitoring._likelihood import log_likelihood
from bayesftc.monitoring._model_file import load_monitor
from bayesftc.monitoring._models import ConstantRate, Integrator, Matrices, PlantModel, RandomWalk
from bayesftc.monitoring._monitor import Monitor
from bayesftc.monitoring._precision import default_precision
from bayesftc.monitoring._recording import Recording, Signal, align
from bayesftc.monitoring._run import Monitored, monitor_recording

__all__ = [
    "ActuatorEvent",
    "Alarm",
    "Column",
    "ConstantRate",
    "FaultEvent",
    "Input",
    "Integrator",
    "Matrices",
    "Monitor",
    "Monitored",
    "PlantModel",
    "RandomWalk",
    "Recording",
    "Sensor",
    "SensorErrors",
    "Signal",
    "align",
    "default_precision",
    "load_monitor",
    "log_likelihood",
    "monitor_recording",
]
