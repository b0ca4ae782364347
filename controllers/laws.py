"""Feedback laws, blocks from ``x_hat`` and ``goal`` to ``u``: proportional, with derivative, and with integral action."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy as np

from bayesftc.controllers.models.checks import Matrix, as_matrix, as_numbers, as_vector, check_limits
from bayesftc.controllers.signals import port
from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import both, either, maximum, minimum, select
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats


def _error(x_hat, goal, j):
    """Return the error of state `j`; 0 if the goal is not finite."""
    d = goal[j] - x_hat[j]
    return select(d - d == 0.0, d, 0.0)


def _feedback(i, x_hat, goal, gain, derivative_gain):
    """Return the proportional and derivative part of control `i`."""
    g = gain.shape[1]
    total = gain[i, 0] * _error(x_hat, goal, 0)
    for j in range(1, g):
        total = total + gain[i, j] * _error(x_hat, goal, j)
    for j in range(derivative_gain.shape[1]):
        total = total - derivative_gain[i, j] * x_hat[g + j]
    return total


def _proportional(x_hat, goal, gain, no_rates, u_min, u_max, u):
    for i in range(u.shape[0]):
        u[i] = maximum(minimum(_feedback(i, x_hat, goal, gain, no_rates), u_max[i]), u_min[i])


def _proportional_derivative(x_hat, goal, gain, derivative_gain, u_min, u_max, u):
    for i in range(u.shape[0]):
        u[i] = maximum(minimum(_feedback(i, x_hat, goal, gain, derivative_gain), u_max[i]), u_min[i])


def _pid(x_hat, goal, integral, gain, derivative_gain, u_min, u_max, u):
    for i in range(u.shape[0]):
        total = _feedback(i, x_hat, goal, gain, derivative_gain) + integral[i]
        u[i] = maximum(minimum(total, u_max[i]), u_min[i])


def _integrate(x_hat, goal, gain, derivative_gain, integral_gain, integral_limit, u_min, u_max, wind, integral):
    """Advance the integral by a sample; ``wind`` has the sample time, the flag for clamping, and the tracking rate per sample."""
    for i in range(integral.shape[0]):
        total = _feedback(i, x_hat, goal, gain, derivative_gain) + integral[i]
        limited = maximum(minimum(total, u_max[i]), u_min[i])
        drive = integral_gain[i, 0] * _error(x_hat, goal, 0)
        for j in range(1, integral_gain.shape[1]):
            drive = drive + integral_gain[i, j] * _error(x_hat, goal, j)
        outward = either(both(total > u_max[i], drive > 0.0), both(total < u_min[i], drive < 0.0))
        drive = select(both(outward, wind[1] > 0.5), 0.0, wind[0] * drive)
        moved = integral[i] + drive + select(wind[2] > 0.0, wind[2] * (limited - total), 0.0)
        moved = maximum(minimum(moved, integral_limit[i]), -integral_limit[i])
        integral[i] = select(moved - moved == 0.0, moved, integral[i])


@dataclass(frozen=True)
class ControlLaw(Block):
    """Base of the laws that scenarios select by ``kind``; `bayesftc.controllers.registry` lists them."""


@dataclass(frozen=True)
class Proportional(ControlLaw):
    """``u = gain (goal - x)``, where x are the first states, as many as the goal has elements.

    Inputs ``x_hat`` (states) and ``goal``; output ``u``. A goal of NaN gives no error.

    Parameters
    ----------
    gain : number, vector or matrix
        Controls x goals; a vector stands for a diagonal.
    states : int, optional
        Number of states of ``x_hat``; by default as many as the law needs.
    u_min, u_max : number or vector
        Limits of the control.

    Raises
    ------
    ModelError
        If a size does not fit, a gain is not finite, or the limits exclude every control.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> law = controllers.Proportional(gain=2.0, states=2, u_max=5.0).online(dt=0.1, compiled=False)
    >>> [law(x_hat=[x, 0.0], goal=[3.0]).u for x in (0.0, 2.0)]
    [array([5.]), array([2.])]
    """

    gain: Matrix
    states: int | None = None
    u_min: float | Sequence[float] = field(default=float("-inf"), metadata={"unit": "{u}"})
    u_max: float | Sequence[float] = field(default=float("inf"), metadata={"unit": "{u}"})

    _kernel: ClassVar[Callable[..., None]] = _proportional
    _needs: ClassVar[int] = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", self._gain("gain"))
        object.__setattr__(self, "states", self._needs * self.goals if self.states is None else self.states)
        if isinstance(self.states, bool) or not isinstance(self.states, int | np.integer):
            raise ModelError(f"{type(self).__name__} has states={self.states!r}; it must be a whole number.")
        if self._states < self._needs * self.goals:
            raise ModelError(
                f"{type(self).__name__} reads {self._needs * self.goals} states for {self.goals} goals, but has "
                f"states={self.states!r}; give at least as many."
            )
        for name in ("u_min", "u_max"):
            value = as_vector(f"{name} of {type(self).__name__}", getattr(self, name), self.controls, finite=False)
            object.__setattr__(self, name, tuple(value.tolist()))
        check_limits(np.asarray(self.u_min), np.asarray(self.u_max), owner=f"{type(self).__name__}: ")
        if float("inf") in self.u_min or float("-inf") in self.u_max:  # type: ignore[operator]
            raise ModelError(
                f"{type(self).__name__} has u_min={self.u_min} and u_max={self.u_max}, which no control can keep. Give finite "
                "limits, or -inf for no lower and inf for no upper limit."
            )

    @property
    def controls(self) -> int:
        """Number of controls."""
        return len(np.asarray(self.gain))

    @property
    def goals(self) -> int:
        """Number of elements of the goal."""
        return int(np.asarray(self.gain).shape[1])

    @property
    def goal_matrix(self) -> Floats:
        """Matrix that maps ``x_hat`` to what has a goal, the first states (goals x states)."""
        return np.eye(self.goals, self._states)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``x_hat`` and ``goal``."""
        return port("x_hat", (self._states,)), port("goal", (self.goals,))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``u``."""
        return (port("u", (self.controls,)),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_proportional, parameters=self._parameters() | {"no_rates": np.zeros((self.controls, 0))})

    @property
    def _states(self) -> int:
        return int(self.states or 0)

    def _parameters(self) -> dict[str, Any]:
        return {name: np.asarray(getattr(self, name), float) for name in ("gain", "u_min", "u_max")}

    def _gain(self, name: str) -> tuple[tuple[float, ...], ...]:
        """Return a gain as rows; all gains have the size of `gain`."""
        value: Any = as_numbers(
            f"The {name} of {type(self).__name__}",
            getattr(self, name),
            "it must be a number, a list of numbers for a diagonal, or rows of numbers",
        )
        size = (None, None) if name == "gain" else (self.controls, self.goals)
        if value.ndim == 0 and size[0] is not None:
            value = value * np.eye(*size)
        elif value.ndim == 1:
            value = np.diag(value)
        matrix: Floats = as_matrix(f"The {name} of {type(self).__name__}", value, *size)
        return tuple(tuple(row) for row in matrix.tolist())


@dataclass(frozen=True)
class ProportionalDerivative(Proportional):
    """``u = gain (goal - x) - derivative_gain v``, where v are the states after x: the rates of x, in the same order.

    The rate of the goal is assumed to be zero. Ports are those of `Proportional`.

    Parameters
    ----------
    gain, states, u_min, u_max
        See `Proportional`.
    derivative_gain : number, vector or matrix
        Controls x goals; a number or vector stands for a diagonal.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> law = controllers.ProportionalDerivative(gain=2.0, derivative_gain=0.5).online(dt=0.1, compiled=False)
    >>> law(x_hat=[2.0, 1.0], goal=[3.0]).u.tolist()  # position 2, speed 1
    [1.5]
    """

    derivative_gain: Matrix = 0.0

    _needs: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "derivative_gain", self._gain("derivative_gain"))

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_proportional_derivative, parameters=self._parameters())

    def _parameters(self) -> dict[str, Any]:
        return super()._parameters() | {"derivative_gain": np.asarray(self.derivative_gain, float)}


@dataclass(frozen=True)
class PID(ProportionalDerivative):
    """`ProportionalDerivative` plus an integral ``dI/dt = integral_gain (goal - x)`` that does not wind up.

    The integral has the units of the control. Ports are those of `Proportional`. Without a derivative gain ``x_hat`` needs no
    rates.

    Parameters
    ----------
    gain, derivative_gain, states, u_min, u_max
        See `ProportionalDerivative`.
    integral_gain : number, vector or matrix
        Per second; controls x goals; a number or vector stands for a diagonal.
    integral_limit : number or vector
        The integral stays within plus and minus this, in units of the control.
    anti_windup : {"clamping", "back-calculation", "both", "none"}
        Behaviour of the integral while a control is at its limit. "clamping": it stops while it would drive the control further
        beyond. "back-calculation": it changes at ``(limited control - control) / tracking_time`` as well (Astrom and Hagglund,
        *Advanced PID Control*, section 3.5). "both": both of these. "none": neither.
    tracking_time : float
        Time constant of the back-calculation in seconds, at least the sample time.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> law = controllers.PID(gain=2.0, integral_gain=1.0, u_max=3.0).online(dt=0.1, compiled=False)
    >>> [round(float(law(x_hat=[2.0], goal=[3.0]).u[0]), 1) for _ in range(4)]
    [2.0, 2.1, 2.2, 2.3]
    """

    integral_gain: Matrix = 0.0
    integral_limit: float | Sequence[float] = field(default=float("inf"), metadata={"unit": "{u}"})
    anti_windup: Literal["clamping", "back-calculation", "both", "none"] = "clamping"
    tracking_time: float = field(default=1.0, metadata={"unit": "s"})

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "integral_gain", self._gain("integral_gain"))
        limit = as_vector("integral_limit of PID", self.integral_limit, self.controls, finite=False)
        object.__setattr__(self, "integral_limit", tuple(limit.tolist()))
        if (limit < 0).any():
            raise ModelError(f"PID has integral_limit={self.integral_limit}; it must not be negative.")
        if self.anti_windup not in ("clamping", "back-calculation", "both", "none"):
            raise ModelError(
                f"PID has anti_windup={self.anti_windup!r}; give 'clamping', 'back-calculation', 'both' or 'none'."
            )
        time = self.tracking_time
        if not 0 < real(time) < math.inf:
            raise ModelError(f"PID has tracking_time={time!r}; give a positive number of seconds.")

    @property
    def _needs(self) -> int:  # type: ignore[override]
        return 2 if np.any(self.derivative_gain) else 1

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        back = self.anti_windup in {"back-calculation", "both"}
        if back and self.tracking_time < float(step):
            raise ModelError(
                f"PID has tracking_time={self.tracking_time:g} s at a sample time of {float(step):g} s, so the integral would "
                "overshoot. Give at least the sample time."
            )
        wind = [
            float(step),
            self.anti_windup in {"clamping", "both"},
            float(step) / self.tracking_time if back else 0.0,
        ]
        parameters = self._parameters() | {
            "integral_gain": np.asarray(self.integral_gain, float),
            "integral_limit": np.asarray(self.integral_limit, float),
            "wind": np.array(wind, dtype=np.float64),
        }
        if self._needs == 1:
            parameters["derivative_gain"] = np.zeros((self.controls, 0))
        return Definition(_pid, _integrate, state={"integral": np.zeros(self.controls)}, parameters=parameters)


__all__ = ["PID", "Proportional", "ProportionalDerivative"]
