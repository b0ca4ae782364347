"""The sensors and inputs of a model file: the column of each, and its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.fault_modes import HEALTHY_REPEATS
from bayesftc.cosim.errors import ModelError


def check_gain(owner: Any) -> None:
    """Check the setting ``gain`` of `owner`.

    Raises
    ------
    ModelError
        If it is zero, or no finite number.
    """
    check_number(owner, "gain")
    if owner.gain == 0.0:
        raise ModelError(
            f"{type(owner).__name__} has gain=0; it must be a number above 0, or below 0 where samples move the other way."
        )


@dataclass(frozen=True)
class Column:
    r"""The column of a signal in a CSV file.

    Parameters
    ----------
    file : str, optional
        Name of its CSV file; not needed if there is only one.
    column : str, optional
        Its column; by default the signal's name. A unit in brackets at its end may be left out.
    time : str, optional
        The column of its time stamps; by default the monitor's.
    bias : float
        Known offset in its unit, which is subtracted.
    delay : float
        Seconds by which its time stamps are late.
    invalid : sequence of float or str
        Values that the device records in place of a sample, such as ``[-9999, "Bad Input"]``.
    gain : float
        How far its samples move while the quantity moves by 1, as -1 for an altitude beside a depth: samples, less the bias, are
        divided by it.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from bayesftc import monitoring
    >>> sensor = monitoring.Sensor(column="T_1", bias=0.5, delay=0.1, invalid=[-9999], std=0.1)
    >>> monitor = monitoring.Monitor(0.1, monitoring.RandomWalk(std=0.02), {"tank": sensor})
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "plant.csv")
    ...     _ = file.write_text("t,T_1\n0.1,20.5\n0.2,-9999\n0.3,20.7\n")
    ...     signals, _ = monitor.signals([file])
    >>> [values.round(1).tolist() for values in signals["tank"].corrected]
    [[0.0, 0.2], [20.0, 20.2]]
    """

    file: str | None = None
    column: str | None = None
    time: str | None = None
    bias: float = 0.0
    delay: float = 0.0
    invalid: Sequence[float | str] = ()
    gain: float = 1.0

    def __post_init__(self) -> None:
        check_gain(self)


@dataclass(frozen=True, kw_only=True)
class Sensor(Column):
    """A sensor.

    Parameters
    ----------
    file, column, time, bias, delay, invalid, gain
        See `Column`.
    std : float
        Standard deviation of its white noise, in its unit, after the division by the gain.
    resolution : float
        Its samples in the file are whole multiples of this; 0 if it is too fine to matter. By default it is estimated from the
        samples.
    repeats : float
        Share of samples that equal the one before while the sensor is healthy, as with slow sensors or a faster logger.
    reads : sequence of float, optional
        Its row of C, one number per state; by default it measures the first state.
    period : float
        Full turn of an angle, such as 360 for a heading in degrees; 0 for other quantities. Its samples count on where they begin
        anew, on the turn of the other sensors with this period.
    held : bool
        Whether a value that repeats the one before is no sample: the log, or the wire of a live monitor, is faster than the
        sensor and repeats its last value. If the sensor freezes, it has no samples and counts as dropped out.
    unit : str
        Its unit, for figures and tables. Samples of a column whose name ends in another unit, as in ``h [cm]``, are converted.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> position = monitoring.Sensor(std=0.1)
    >>> speed = monitoring.Sensor(std=0.05, reads=[0.0, 1.0])
    >>> model = monitoring.Monitor(0.1, monitoring.ConstantRate(std=0.2), {"position": position, "speed": speed}).model
    >>> model.C.tolist(), model.sensor_covariance.round(4).tolist()
    ([[1.0, 0.0], [0.0, 1.0]], [[0.01, 0.0], [0.0, 0.0025]])
    """

    std: float
    resolution: float | None = None
    repeats: float = HEALTHY_REPEATS
    reads: Sequence[float] | None = None
    period: float = 0.0
    held: bool = False
    unit: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "std", above=0)
        check_number(self, "period", least=0)
        check_number(self, "repeats", least=0, below=1)
        if self.period and self.gain != 1.0:
            raise ModelError(
                f"Sensor has period = {self.period:g} and gain = {self.gain:g}. Samples of an angle begin anew after a full "
                "turn, so they cannot be divided by a gain. Remove one of the two."
            )


@dataclass(frozen=True, kw_only=True)
class Input(Column):
    """A known input.

    Parameters
    ----------
    file, column, time, bias, invalid, gain
        See `Column`.
    delay : float
        Seconds by which its time stamps are late; a dead time of the plant behind this input is a negative delay: -60 for 60 s.
    smooth : float
        Seconds over which it is averaged.
    error_std : float
        Standard deviation of its unknown error at the beginning; 0 if it has none.
    error_walk : float
        Standard deviation of that error's change in one second.
    unit : str
        Unit of its samples, for tables.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in ("wheel", "radar")}
    >>> inputs = {"acceleration": monitoring.Input(bias=0.02, error_std=0.1, error_walk=0.01)}
    >>> model = monitoring.Monitor(0.1, monitoring.Integrator(std=0.2), sensors, inputs).model
    >>> model.states, model.disturbances  # speed and the error of the acceleration
    (2, 1)
    """

    smooth: float = 0.0
    error_std: float = 0.0
    error_walk: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("error_std", "error_walk"):
            check_number(self, name, least=0)


@dataclass(frozen=True)
class SensorErrors:
    """Lasting errors of sensors; see `LinearModel.with_sensor_errors`.

    Parameters
    ----------
    std : number or vector
        Their standard deviation.
    time_constant : number or vector
        In seconds.
    sensors : sequence of str, optional
        Names of the sensors; by default all.
    common : bool
        Whether these sensors have one common error.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "ab"}
    >>> errors = monitoring.SensorErrors(std=0.3, time_constant=60.0, sensors=["b"])
    >>> model = monitoring.Monitor(0.1, monitoring.RandomWalk(std=0.2), sensors, errors=[errors]).model
    >>> model.C.tolist()
    [[1.0, 0.0], [1.0, 1.0]]
    """

    std: float | Sequence[float]
    time_constant: float | Sequence[float]
    sensors: Sequence[str] | None = None
    common: bool = False
