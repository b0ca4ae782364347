"""Blocks that remember: integrator, filters, rate limiter, hysteresis, sample and hold, counter, variable delay."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import ClassVar

import numpy as np

from bayesftc.cosim.base.numbers import check_count
from bayesftc.cosim.block import Definition
from bayesftc.cosim.blocks.elementwise import Elementwise, SameUnit
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import both, exp, floor, isnan, maximum, minimum, negate, select
from bayesftc.cosim.ports import Port


def _within(x, low, high):
    return maximum(minimum(x, high), low)


def _integral(x, y):
    for i in range(y.shape[0]):
        y[i] = x[i]


def _integrate(u, x, dt, low, high):
    for i in range(x.shape[0]):
        x[i] = _within(x[i] + dt[0] * select(isnan(u[i]), 0.0, u[i]), low[0], high[0])


def _integrate_or_reset(u, reset, x, dt, initial, low, high):
    for i in range(x.shape[0]):
        further = _within(x[i] + dt[0] * select(isnan(u[i]), 0.0, u[i]), low[0], high[0])
        x[i] = select(reset[0] > 0.5, initial[0], further)


@dataclass(frozen=True)
class Integrator(Elementwise):
    """The integral of each element over time, by the forward Euler method.

    The output at t_k depends on the inputs before t_k only, so that an integrator breaks an algebraic loop. A missing sample
    (NaN) adds nothing.

    Parameters
    ----------
    initial : float
        The integral at the beginning, and after a reset.
    low, high : float
        Limits at which the integral stays (no windup).
    reset : bool
        Whether there is an input ``reset``: where it is above 0.5 at t_k, the integral at t_k+1 is `initial`.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `low`, `initial` and `high` do not rise in this order, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> integral = cosim.Integrator(initial=1.0, high=1.5).online(dt=0.1, compiled=False)
    >>> [round(integral(u=2.0).y, 9) for _ in range(5)]
    [1.0, 1.2, 1.4, 1.5, 1.5]
    """

    result: ClassVar[str] = "The integral"

    initial: float = field(default=0.0, metadata={"unit": "{y}"})
    low: float = field(default=-np.inf, metadata={"unit": "{y}"})
    high: float = field(default=np.inf, metadata={"unit": "{y}"})
    reset: bool = False
    size: int = 1

    def __post_init__(self) -> None:
        self._check("initial")
        if not self.low <= self.initial <= self.high:
            raise ModelError(
                f"Integrator has low={self.low!r}, initial={self.initial!r}, high={self.high!r}; they must rise in this order."
            )

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u`` and, if asked for, ``reset``; both without direct feedthrough."""
        u = Port("u", self.shape, feedthrough=False, description="What is integrated")
        again = Port("reset", feedthrough=False, description="Above 0.5: begin again")
        return (u, again) if self.reset else (u,)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        parameters = {"dt": float(step), "low": self.low, "high": self.high}
        state = {"x": np.full(int(self.size), float(self.initial))}
        if self.reset:
            parameters["initial"] = self.initial
            return Definition(_integral, _integrate_or_reset, state=state, parameters=parameters)
        return Definition(_integral, _integrate, state=state, parameters=parameters)


def _exponential(u, x, begun, gain, y):
    for i in range(y.shape[0]):
        weight = select(begun[i] > 0.5, gain[0], 1.0)
        x[i] = select(isnan(u[i]), x[i], x[i] + weight * (u[i] - x[i]))
        begun[i] = select(isnan(u[i]), begun[i], 1.0)
        y[i] = x[i]


@dataclass(frozen=True)
class ExponentialFilter(SameUnit):
    """First-order low pass of each element: ``y += (1 - exp(-dt / time_constant)) (u - y)``, from the first sample on.

    While samples are missing (NaN), the output stays as it is.

    Parameters
    ----------
    time_constant : float
        Seconds in which 63 % of a step are reached.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If the time constant is not a positive number, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from math import nan
    >>> from bayesftc import cosim
    >>> smooth = cosim.ExponentialFilter(time_constant=1.0).online(dt=0.5, compiled=False)
    >>> [round(smooth(u=u).y, 3) for u in (0.0, 1.0, nan, 1.0)]
    [0.0, 0.393, 0.393, 0.632]
    """

    result: ClassVar[str] = "The filtered signal"
    settling: ClassVar[tuple[str, ...]] = ("x", "begun")
    """States that settle at the first samples; a loop is linearized where they have settled."""

    time_constant: float
    size: int = 1

    def __post_init__(self) -> None:
        self._check("time_constant", above=0.0)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        gain = 1.0 - float(exp(-float(step) / self.time_constant))
        n = int(self.size)
        return Definition(_exponential, state={"x": np.zeros(n), "begun": np.zeros(n)}, parameters={"gain": gain})


def _average(u, window, y):
    for i in range(y.shape[0]):
        for j in range(window.shape[1] - 1, 0, -1):
            window[i, j] = window[i, j - 1]
        window[i, 0] = u[i]
        total, count = 0.0, 0.0
        for j in range(window.shape[1]):
            there = negate(isnan(window[i, j]))
            total = total + select(there, window[i, j], 0.0)
            count = count + select(there, 1.0, 0.0)
        y[i] = total / count


@dataclass(frozen=True)
class MovingAverage(SameUnit):
    """Mean of the last `samples` samples of each element, as far as they are there; NaN if none is.

    Parameters
    ----------
    samples : int
        Length of the window, at most 10,000.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `samples` or the size is out of range.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> average = cosim.MovingAverage(3).online(dt=0.1, compiled=False)
    >>> [average(u=u).y for u in (3.0, 6.0, 9.0, 0.0)]
    [3.0, 4.5, 6.0, 5.0]
    """

    result: ClassVar[str] = "The mean of the window"
    settling: ClassVar[tuple[str, ...]] = ("window",)

    samples: int
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        check_count(self, "samples", 10_000)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_average, state={"window": np.full((int(self.size), self.samples), np.nan)})


def _limit_rate(u, before, rise, fall, y):
    for i in range(y.shape[0]):
        missing = isnan(u[i])
        limited = _within(u[i], before[i] - fall[0], before[i] + rise[0])
        before[i] = select(missing, before[i], limited)
        y[i] = select(missing, u[i], limited)


@dataclass(frozen=True)
class RateLimiter(SameUnit):
    """Follows each element, but no faster than given.

    Parameters
    ----------
    rising : float
        Largest rise per second.
    falling : float, optional
        Largest fall per second, a positive number; by default as `rising`.
    initial : float
        Output before the first sample.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If a rate is not a positive number, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> limiter = cosim.RateLimiter(rising=10.0, falling=20.0).online(dt=0.1, compiled=False)
    >>> [limiter(u=u).y for u in (1.5, 1.5, 1.5, -5.0)]
    [1.0, 1.5, 1.5, -0.5]
    """

    result: ClassVar[str] = "u, as fast as it may change"

    rising: float
    falling: float | None = None
    initial: float = field(default=0.0, metadata={"unit": "{y}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("initial")
        self._check("rising", *["falling"] * (self.falling is not None), above=0.0)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        fall = self.rising if self.falling is None else self.falling
        parameters = {"rise": self.rising * float(step), "fall": fall * float(step)}
        return Definition(
            _limit_rate, state={"before": np.full(int(self.size), float(self.initial))}, parameters=parameters
        )


def _relay(u, on, rise, fall, high, low, y):
    for i in range(y.shape[0]):
        on[i] = select(u[i] >= rise[0], 1.0, select(u[i] <= fall[0], 0.0, on[i]))
        y[i] = select(on[i] > 0.5, high[0], low[0])


@dataclass(frozen=True)
class Hysteresis(Elementwise):
    """A relay: `high` from the sample at which ``u`` reaches `on`, until the one at which it is down at `off`.

    A missing sample (NaN) changes nothing.

    Parameters
    ----------
    on, off : float
        Where it switches on and off; `on` is above `off`.
    high, low : float
        Output when it is on and off.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `on` is not above `off`, a setting is not finite, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> heater = cosim.Hysteresis(on=1.0, off=-1.0).online(dt=0.1, compiled=False)  # of the error of the temperature
    >>> [heater(u=u).y for u in (0.5, 1.0, 0.0, -1.0, 0.5)]
    [0.0, 1.0, 1.0, 0.0, 0.0]
    """

    result: ClassVar[str] = "high or low"

    on: float = field(metadata={"unit": "{u}"})
    off: float = field(metadata={"unit": "{u}"})
    high: float = field(default=1.0, metadata={"unit": "{y}"})
    low: float = field(default=0.0, metadata={"unit": "{y}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("on", "off", "high", "low")
        if self.off >= self.on:
            raise ModelError(f"Hysteresis has on={self.on!r} and off={self.off!r}; on must lie above off.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        parameters = {"rise": self.on, "fall": self.off, "high": self.high, "low": self.low}
        return Definition(_relay, state={"on": np.zeros(int(self.size))}, parameters=parameters)


def _sample_and_hold(u, trigger, held, y):
    for i in range(y.shape[0]):
        held[i] = select(trigger[0] > 0.5, u[i], held[i])
        y[i] = held[i]


@dataclass(frozen=True)
class SampleAndHold(SameUnit):
    """The last value of ``u`` at which ``trigger`` was above 0.5.

    Parameters
    ----------
    initial : float
        Output until then.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `initial` is not finite, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> hold = cosim.SampleAndHold(initial=-1.0).online(dt=0.1, compiled=False)
    >>> [hold(u=u, trigger=trigger).y for u, trigger in ((1.0, 0), (2.0, 1), (3.0, 0), (4.0, 1))]
    [-1.0, 2.0, 2.0, 4.0]
    """

    result: ClassVar[str] = "The last sample"

    initial: float = field(default=0.0, metadata={"unit": "{y}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("initial")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``u`` and ``trigger``."""
        return *super().inputs, Port("trigger", description="Above 0.5: take a sample")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_sample_and_hold, state={"held": np.full(int(self.size), float(self.initial))})


def _count(u, before, count, limit, y):
    for i in range(y.shape[0]):
        edge = both(u[i] > 0.5, before[i] <= 0.5)
        further = count[i] + select(edge, 1.0, 0.0)
        count[i] = select(further >= limit[0], 0.0, further)
        before[i] = select(isnan(u[i]), before[i], u[i])
        y[i] = count[i]


@dataclass(frozen=True)
class Counter(Elementwise):
    """How often each element has risen above 0.5.

    Parameters
    ----------
    limit : float
        Number at which it begins at zero again; infinite for never.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If the limit is below 1, or the size is not a whole number from 1 on.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> counter = cosim.Counter().online(dt=0.1, compiled=False)
    >>> [counter(u=alarm).y for alarm in (0, 1, 1, 0, 1)]
    [0.0, 1.0, 1.0, 1.0, 2.0]
    """

    result: ClassVar[str] = "The number of rises"

    limit: float = np.inf
    size: int = 1

    def __post_init__(self) -> None:
        self._check()
        if not self.limit >= 1:
            raise ModelError(f"Counter has limit={self.limit!r}; it must be at least 1.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        n = int(self.size)
        return Definition(_count, state={"before": np.zeros(n), "count": np.zeros(n)}, parameters={"limit": self.limit})


def _delay(u, delay, held, dt, y):
    length = held.shape[1]
    steps = _within(delay[0] / dt[0], 0.0, length - 1.0)
    whole = floor(steps + 1e-9)
    share = _within(steps - whole, 0.0, 1.0)
    for i in range(y.shape[0]):
        for j in range(length - 1, 0, -1):
            held[i, j] = held[i, j - 1]
        held[i, 0] = u[i]
        later, earlier = 0.0, 0.0
        for j in range(length):
            later = select(whole == j, held[i, j], later)
            earlier = select(whole + 1.0 == j, held[i, j], earlier)
        y[i] = select(share > 0.0, later + share * (earlier - later), later)


@dataclass(frozen=True)
class VariableDelay(SameUnit):
    """Each element as it was ``delay`` seconds before, linear between samples.

    Parameters
    ----------
    longest : float
        Seconds. Longest delay; a longer one counts as this, a negative one as zero.
    initial : float
        What the elements were before the beginning.
    size : int
        Number of elements.

    Raises
    ------
    ModelError
        If `longest` is not a positive number, or is more than 9,999 steps when the block is used.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> pipe = cosim.VariableDelay(longest=1.0).online(dt=0.1, compiled=False)
    >>> [round(pipe(u=u, delay=0.15).y, 9) for u in (10.0, 20.0, 30.0, 40.0)]
    [0.0, 5.0, 15.0, 25.0]
    """

    result: ClassVar[str] = "u of some time ago"

    longest: float = field(metadata={"unit": "s"})
    initial: float = field(default=0.0, metadata={"unit": "{y}"})
    size: int = 1

    def __post_init__(self) -> None:
        self._check("initial")
        self._check("longest", above=0.0)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``u`` and ``delay``."""
        return *super().inputs, Port("delay", unit="s", description="How long ago")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        length = ceil(self.longest / float(step) - 1e-9) + 1
        if length > 10_000:
            raise ModelError(
                f"VariableDelay has longest={self.longest!r} s, which is {length - 1} steps of {float(step):g} s; "
                "the most are 9,999."
            )
        state = {"held": np.full((int(self.size), length), float(self.initial))}
        return Definition(_delay, state=state, parameters={"dt": float(step)})


__all__ = [
    "Counter",
    "ExponentialFilter",
    "Hysteresis",
    "Integrator",
    "MovingAverage",
    "RateLimiter",
    "SampleAndHold",
    "VariableDelay",
]
