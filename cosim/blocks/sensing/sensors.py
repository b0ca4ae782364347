"""Sensors: the measured signals, offset, noise and resolution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from fractions import Fraction
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.base.invalid import Invalid, invalid_values
from bayesftc.cosim.base.numbers import counted, reals
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.sensing import kernels
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats, Kernel

MOST = 10_000
"""Largest number of sensors, or of signals. Each needs memory, and a row in matrices of a controller."""
MOST_STEPS = 1_000_000
"""Largest number of steps from one sample of a sensor to the next."""


@dataclass(frozen=True)
class Sensors(Block):
    """Redundant sensors: ``y = g(u) + bias + std * noise``, rounded to the resolution.

    Input ``u`` (a scalar, or of shape (signals,)), output ``y`` of shape (count,), also for one sensor. A missing
    sample (NaN) of a signal is a missing sample of every sensor that reads it. Each sensor has its own noise, which
    does not change when further sensors are added.

    Parameters
    ----------
    count : int or sequence of int
        Number of sensors, or one number for each signal: ``(1, 3)`` is one sensor of the first signal, then three sensors of the
        second one. With a single number, the sensors read the signals in turn: ``4`` for position and speed is position, speed,
        position, speed.
    std : float or sequence of float
        Standard deviation of the noise in the unit of the signal: one number for all sensors, or one for each in the order of
        `count`. If `count` has a number for each signal, `std` may also have one for each signal. The same holds for `bias` and
        `resolution`.
    signals : int
        Number of signals that they read.
    bias : float or sequence of float
        Constant offset.
    resolution : float or sequence of float
        Readings are whole multiples of this (halves are rounded up); 0 for no rounding. If a scenario file designs a
        controller from the plant, the controller's sensor noise includes the rounding (`error_std`). If you call `design`,
        include the rounding in its `sensor_std`.
    matrix : sequence of sequence of float, shape (count, signals), optional
        Measurement matrix: coefficients of the signals for each sensor.
    function : function, optional
        A step function ``function(u, clean)`` that keeps the rules of `Block` and writes the readings of `count` ideal sensors
        into ``clean``. Without matrix and function all sensors read the one signal, or sensor i reads signal ``i %
        signals``.
    covariance : sequence of sequence of float, shape (count, count), optional
        Covariance of the noise, instead of `std`, for correlated sensors.
    unit : str or sequence of str, optional
        Unit of the signal and of the readings, or of each signal: ``("m", "degC")``. By default they have the units of the
        outputs that they measure.
    every : int or sequence of int
        The sensor has a sample in every n-th step, from the first step on, and none (NaN) in between: ``[1, 1, 10]`` for a third
        sensor of 5 Hz in a loop of 50 Hz. Give one number for all sensors, or one for each sensor. If `count` has a number for
        each signal, you may also give one for each signal, for all sensors of it. `closed_loop` also gives the number to the
        faults of the sensor and to the learner of the controller. The learner then expects no samples in between. Figures of the
        linear loop, such as `loop.poles()`, treat a slow sensor as if it had a sample in each step.
    invalid : sequence of float, or of one for each sensor
        Values that the devices send in place of a sample, such as ``[-9999, 65535]``. The samples are not changed.
        `closed_loop` gives the values to the controller, which treats such samples as missing.

    Raises
    ------
    ModelError
        If sizes do not fit or a setting is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> cosim.Sensors(count=2, std=(1.0, 0.5)).port("y").shape
    (2,)
    """

    count: int | Sequence[int] = 1
    std: float | Sequence[float] = field(default=0.0, metadata={"unit": "{y}"})
    _: KW_ONLY
    signals: int = 1
    bias: float | Sequence[float] = field(default=0.0, metadata={"unit": "{y}"})
    resolution: float | Sequence[float] = field(default=0.0, metadata={"unit": "{y}"})
    matrix: Sequence[Sequence[float]] | None = None
    function: Callable[..., None] | None = None
    covariance: Sequence[Sequence[float]] | None = None
    unit: str | Sequence[str] | None = None
    invalid: Invalid = ()
    every: int | Sequence[int] = 1

    def __post_init__(self) -> None:
        if isinstance(self.count, Sequence | np.ndarray) and not isinstance(self.count, str):
            self._count_by_signal(tuple(self.count))
        if self.unit is not None and not isinstance(self.unit, str):
            self._unit_by_signal(self.unit)
        for name in ("count", "signals"):
            _check_number(name, getattr(self, name))
        for name in ("std", "bias", "resolution"):
            self._check_each(name, negative=name == "bias")
        self._check_every()
        invalid_values("Sensors", self.invalid, len(self))
        self._check_matrix("matrix", self.signals)
        self._check_matrix("covariance", len(self))
        if self.matrix is not None and self.function is not None:
            raise ModelError("Sensors has a matrix and a function; give only one of them.")
        if self.function is not None:
            _check_function(self.function)
        elif self.matrix is None and len(self) % self.signals:
            raise ModelError(
                f"{self.count} sensors cannot share {self.signals} signals evenly; give the number of each, such as "
                f"count={(*[1] * (self.signals - 1), max(len(self) - self.signals + 1, 1))}, or matrix=... ({self.count} x "
                f"{self.signals}) or function=... for the readings of each sensor."
            )
        if self.covariance is not None:
            if np.any(self.std):
                raise ModelError(
                    "Sensors has both std and covariance; leave out std, which the diagonal of the covariance contains."
                )
            _semidefinite_factor(np.asarray(self.covariance))

    def _count_by_signal(self, counts: tuple[int, ...]) -> None:
        """Set the number of sensors and the matrix from the number of sensors of each signal."""
        for number in counts:
            _check_number("count", number)
        if self.signals not in (1, len(counts)):
            raise ModelError(
                f"Sensors has count={counts}, {len(counts)} number{'s' if len(counts) > 1 else ''} for {self.signals} signals; "
                "give one for each signal, or one in all without brackets."
            )
        if self.matrix is not None or self.function is not None:
            other = "a matrix" if self.matrix is not None else "a function"
            raise ModelError(
                f"Sensors has count={counts}, a number for each signal, which does not go with {other}; leave one of them out."
            )
        read = np.repeat(np.arange(len(counts)), counts)
        for name in ("std", "bias", "resolution", "every"):
            if np.shape(value := getattr(self, name)) == (len(counts),):
                object.__setattr__(self, name, tuple(np.asarray(value)[read].tolist()))
        object.__setattr__(self, "count", len(read))
        if len(counts) > 1:
            object.__setattr__(self, "signals", len(counts))
            object.__setattr__(self, "matrix", np.eye(len(counts))[read].tolist())

    def _unit_by_signal(self, units: Sequence[str]) -> None:
        """Set the units from those of each signal, and the number of signals if it is not given otherwise."""
        if not isinstance(units, list | tuple) or not units or not all(isinstance(unit, str) for unit in units):
            raise ModelError(
                f"Sensors has unit={brief(units)}; it must be a text, or a text for each signal, such as ('m', 'degC')."
            )
        if self.signals == 1 and self.matrix is None and self.function is None:
            object.__setattr__(self, "signals", len(units))
        if len(units) != self.signals:
            raise ModelError(
                f"Sensors has unit={tuple(units)!r}, {counted(len(units), 'unit')} for "
                f"{counted(self.signals, 'signal')}; give one for each signal, or one text for all."
            )
        object.__setattr__(self, "unit", tuple(units) if len(set(units)) > 1 else units[0])

    def __len__(self) -> int:
        """Return the number of sensors."""
        return self.count  # type: ignore[return-value]

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u`` and random input ``noise``."""
        shape = () if self.signals == 1 else (self.signals,)
        unit, units = (self.unit, ()) if self.unit is None or isinstance(self.unit, str) else (None, tuple(self.unit))
        u = Port("u", shape, unit=unit, description="What is measured", units=units)
        return (u, Port("noise", (len(self),), draw="normal"))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        unit, units = (self.unit, ()) if self.unit is None or isinstance(self.unit, str) else (None, self._units)
        text = "Samples of the sensors; NaN for a missing one"
        return (Port("y", (len(self),), unit=unit, description=text, units=units),)

    @property
    def _units(self) -> tuple[str | None, ...]:
        """The unit of each sensor that reads one signal as it is."""
        return tuple(None if j is None else self.unit[j] for j in self.reads)  # type: ignore[index]

    @property
    def reads(self) -> tuple[int | None, ...]:
        """The number of the signal that each sensor reads as it is; None for one that reads a mixture, or a function."""
        rows = self.rows
        if rows is None:
            return (None,) * len(self)
        return tuple(
            int(row.argmax()) if row.max() == 1.0 and np.count_nonzero(row) == 1 else None  # a row of C
            for row in rows
        )

    @property
    def rows(self) -> Floats | None:
        """Measurement matrix (count x signals); None if the measurement is not linear."""
        if self.function is not None:
            return None
        if self.matrix is not None:
            return np.asarray(self.matrix, dtype=np.float64)
        return np.asarray(np.eye(self.signals)[np.arange(len(self)) % self.signals])

    @property
    def error_std(self) -> float | tuple[float, ...]:
        """Standard deviation of the readings' errors: that of the noise and of rounding to the resolution, r / sqrt(12)."""
        both = np.hypot(self.std, np.asarray(self.resolution) / 12**0.5)
        return float(both) if both.ndim == 0 else tuple(both.tolist())

    @property
    def one_unit(self) -> tuple[str, ...]:
        """See `Block.one_unit`."""
        return ("u", "y") if self.matrix is None and self.function is None else ()

    @property
    def rates(self) -> tuple[int, ...]:
        """For each sensor the number of steps from one sample to the next."""
        return (self.every,) * len(self) if isinstance(self.every, int) else tuple(self.every)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        measure: Kernel = kernels.one_to_one
        if self.function is not None:
            measure = kernels.by_function(self.function)
        elif self.matrix is not None:
            measure = kernels.linear
        disturbance: Callable[..., Any] = kernels.independent
        factor = self._each("std")[:, np.newaxis]
        if self.covariance is not None:
            disturbance, factor = kernels.correlated, _semidefinite_factor(np.asarray(self.covariance))
        sense, rates = kernels.sensors(measure, disturbance), {}
        if max(self.rates) > 1:
            sense, rates = kernels.slow(sense), {"every": np.array(self.rates, float)}
        return Definition(
            sense,
            state={"clean": np.zeros(len(self))},
            parameters={
                "matrix": [[0.0]] if self.matrix is None else self.matrix,
                "factor": factor,
                "bias": self._each("bias"),
                "resolution": self._each("resolution"),
                **rates,
            },
        )

    def _each(self, name: str) -> Floats:
        return np.broadcast_to(np.asarray(getattr(self, name), float), (len(self),))

    def _check_each(self, name: str, negative: bool) -> None:
        value = getattr(self, name)
        numbers = reals(value)
        if numbers.shape not in {(), (self.count,)}:
            raise ModelError(
                f"Sensors has {name}={brief(value)} for {self.count} sensors; give one number, or one for each; with a count for "
                "each signal, also one for each signal."
            )
        if not np.isfinite(numbers).all() or (not negative and (numbers < 0).any()):
            raise ModelError(
                f"Sensors has {name}={brief(value)}; it must be finite{'' if negative else ' and not negative'}."
            )
        object.__setattr__(self, name, tuple(numbers.tolist()) if numbers.ndim else float(numbers))

    def _check_every(self) -> None:
        numbers = reals(self.every)
        fits = (numbers >= 1) & (numbers <= MOST_STEPS) & (numbers % 1 == 0)
        if numbers.shape not in {(), (self.count,)} or not fits.all():
            raise ModelError(
                f"Sensors has every={brief(self.every)} for {counted(len(self), 'sensor')}; give a whole number of steps from 1 "
                f"to {MOST_STEPS:,}, or one for each sensor: [1, 10] for a second one with a sample in every tenth step. With "
                "a count for each signal, also one for each signal."
            )
        steps = numbers.astype(int)
        object.__setattr__(self, "every", tuple(steps.tolist()) if numbers.ndim else int(steps))

    def _check_matrix(self, name: str, columns: int) -> None:
        value = getattr(self, name)
        if value is None:
            return
        numbers = reals(value)
        if numbers.shape != (self.count, columns) or not np.isfinite(numbers).all():
            raise ModelError(
                f"Sensors has {name}={value!r}; it must have a row of {columns} finite numbers for each of the "
                f"{self.count} sensors."
            )
        object.__setattr__(self, name, tuple(tuple(row) for row in numbers.tolist()))


def _check_number(name: str, number: object) -> None:
    if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 1 <= number <= MOST:
        raise ModelError(f"Sensors has {name}={brief(number)}; it must be a whole number from 1 to {MOST:,}.")


def _check_function(function: Callable[..., None]) -> None:
    if not isinstance(function, FunctionType) or function.__code__.co_argcount != 2:
        raise ModelError(
            f"Sensors has function={function!r}; it must be a plain Python function of two arguments, (u, clean), that "
            "writes the readings of ideal sensors into clean."
        )


def _semidefinite_factor(covariance: Floats) -> Floats:
    """Return the lower triangle L with L L' = covariance, which may be singular.

    Row i depends on the first i sensors only, so the noise of a sensor does not change when others are added after it.
    """
    message = f"Sensors has covariance={covariance.tolist()}; "
    if np.abs(covariance - covariance.T).max() > 1e-12 * np.abs(covariance).max():
        raise ModelError(message + "it must be symmetric.")
    variances = covariance.diagonal()
    std = np.sqrt(np.where(variances > 0, variances, 1.0))  # correlations have no unit, so one tolerance fits all
    correlation = covariance / np.outer(std, std)
    if np.linalg.eigvalsh(correlation).min() < -1e-10:
        raise ModelError(
            message + "it must have no negative eigenvalue (a correlation beyond 1, or a negative variance)."
        )
    factor = np.zeros_like(correlation)
    for i in range(len(factor)):
        for j in range(i + 1):
            rest = correlation[i, j] - factor[i, :j] @ factor[j, :j]
            if i == j:
                factor[i, i] = np.sqrt(rest) if rest > 1e-12 else 0.0
            elif factor[j, j] > 0:
                factor[i, j] = rest / factor[j, j]
    scaled: Floats = std[:, np.newaxis] * factor
    return scaled


__all__ = ["Sensors"]
