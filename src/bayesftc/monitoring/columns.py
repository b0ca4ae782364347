"""What a model file says of each sensor and input: where it stands, and what is known of its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.fault_modes import HEALTHY_REPEATS


@dataclass(frozen=True)
class Column:
    """Where a signal stands.

    Parameters
    ----------
    file : str, optional
        Name of its CSV file; not needed if there is one only.
    column : str, optional
        Its column; by default the signal's own name.
    time : str, optional
        The column of its time stamps, instead of the monitor's.
    bias : float
        Known offset, which is taken off.
    delay : float
        Seconds by which its time stamps are late.
    invalid : sequence of float
        Values that the device records in place of a sample, as ``[-9999, 65535]``.
    """

    file: str | None = None
    column: str | None = None
    time: str | None = None
    bias: float = 0.0
    delay: float = 0.0
    invalid: Sequence[float] = ()


@dataclass(frozen=True, kw_only=True)
class Sensor(Column):
    """A sensor.

    Parameters
    ----------
    file, column, time, bias, delay, invalid
        See `Column`.
    std : float
        Standard deviation of its white noise, in its unit.
    resolution : float
        Its samples are whole multiples of this; 0 if it is too fine to matter. By default it is found in the samples.
    repeats : float
        Share of its samples that equal the one before while it is healthy: of slow sensors, or a logger that samples faster.
    reads : sequence of float, optional
        What it reads of the state; by default the first one.
    unit : str
        Of its samples, for figures and tables.
    """

    std: float
    resolution: float | None = None
    repeats: float = HEALTHY_REPEATS
    reads: Sequence[float] | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        check_number(self, "std", above=0)
        check_number(self, "repeats", least=0, below=1)


@dataclass(frozen=True, kw_only=True)
class Input(Column):
    """A known input.

    Parameters
    ----------
    file, column, time, bias, delay, invalid
        See `Column`.
    smooth : float
        Seconds over which it is averaged.
    error_std : float
        Standard deviation of its own unknown error at the beginning; 0 if it has none.
    error_walk : float
        Standard deviation of that error's change in a second.
    unit : str
        Of its samples, for tables.
    """

    smooth: float = 0.0
    error_std: float = 0.0
    error_walk: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        for name in ("error_std", "error_walk"):
            check_number(self, name, least=0)


@dataclass(frozen=True)
class SensorErrors:
    """Errors of sensors that last; see `LinearModel.with_sensor_errors`.

    Parameters
    ----------
    std : number or vector
        Their standard deviation.
    time_constant : number or vector
        In seconds.
    sensors : sequence of str, optional
        Names of the sensors; by default all.
    common : bool
        Whether all have the same error.
    """

    std: float | Sequence[float]
    time_constant: float | Sequence[float]
    sensors: Sequence[str] | None = None
    common: bool = False
