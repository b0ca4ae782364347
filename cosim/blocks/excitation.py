"""Sources that excite: pulses, a pseudo-random binary sequence, a chirp."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from bayesftc.cosim.block import Definition
from bayesftc.cosim.blocks.sources import TAU, Source
from bayesftc.cosim.elementary import logarithm
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import exp, floor, select, sin

EDGE = 1e-9
"""Share of a period by which an edge may lie behind a sample and count at it: times are rounded."""


def _pulse(t, amplitude, period, width, offset, start, y):
    turns = (t - start[0]) / period[0] + EDGE
    on = turns - floor(turns) < width[0]
    y[0] = offset[0] + select(t >= start[0] - EDGE * period[0], select(on, amplitude[0], 0.0), 0.0)


@dataclass(frozen=True)
class Pulse(Source):
    """Rectangular pulses: in each period first ``offset + amplitude``, then ``offset``.

    Parameters
    ----------
    amplitude : float
        Height of a pulse.
    period : float
        Time from one pulse to the next, in seconds.
    width : float
        Share of the period in which the pulse is on, between 0 and 1.
    offset : float
        What the output is between the pulses.
    start : float
        Time in seconds at which the first pulse begins.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a setting is not finite, the period is not positive, or the width is not between 0 and 1.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> pulse = cosim.Pulse(amplitude=2.0, period=0.4, width=0.25).online(dt=0.1, compiled=False)
    >>> [pulse().y for _ in range(6)]
    [2.0, 0.0, 0.0, 0.0, 2.0, 0.0]
    """

    amplitude: float = field(metadata={"unit": "{y}"})
    period: float = field(metadata={"unit": "s"})
    width: float = 0.5
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    start: float = field(default=0.0, metadata={"unit": "s"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("amplitude", "period", "width", "offset", "start")
        if self.period <= 0 or not 0 < self.width < 1:
            raise ModelError(
                f"Pulse has period={self.period!r}, width={self.width!r}; the period must be positive, the width "
                "between 0 and 1."
            )

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        names = ("amplitude", "period", "width", "offset", "start")
        return Definition(_pulse, parameters={name: getattr(self, name) for name in names})


TAPS = {3: 2, 4: 3, 5: 3, 6: 5, 7: 6, 9: 5, 10: 7, 11: 9, 15: 14, 17: 14, 18: 11, 20: 17}
"""Length of the shift register: the place that is added to the last; each gives a sequence of the longest period."""


def _prbs(t, register, drawn, interval, tap, amplitude, offset, y):
    n = register.shape[0]
    passed = floor(t / interval[0] + EDGE)
    next_bit = passed > drawn[0]
    drawn[0] = select(next_bit, passed, drawn[0])
    other = 0.0
    for i in range(n):
        other = select(tap[0] == i + 1, register[i], other)
    first = register[n - 1] + other - 2.0 * register[n - 1] * other  # exclusive or
    for i in range(n - 1, 0, -1):
        register[i] = select(next_bit, register[i - 1], register[i])
    register[0] = select(next_bit, first, register[0])
    y[0] = offset[0] + amplitude[0] * (2.0 * register[n - 1] - 1.0)


@dataclass(frozen=True)
class PRBS(Source):
    """Pseudo-random binary sequence: ``offset + amplitude`` or ``offset - amplitude``, as white as two values can be.

    A shift register of `order` bits gives a sequence that repeats after ``2**order - 1`` intervals. It excites all frequencies
    up to about ``0.4 / interval`` Hz alike, for `identify`.

    Parameters
    ----------
    amplitude : float
        How far the output is from `offset`.
    interval : float
        Seconds for which each bit lasts; a multiple of the block's step.
    order : int
        Bits of the register: 3 to 7, 9 to 11, 15, 17, 18 or 20.
    offset : float
        The middle of the two values.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If the interval is not positive, there is no such order, or another setting is not finite.

    References
    ----------
    L. Ljung, System Identification: Theory for the User, 2nd ed., 1999, section 13.3.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> prbs = cosim.PRBS(amplitude=1.0, interval=0.1, order=3).online(dt=0.1, compiled=False)
    >>> [int(prbs().y) for _ in range(9)]  # repeats after 7 intervals
    [1, 1, 1, -1, -1, 1, -1, 1, 1]
    """

    amplitude: float = field(metadata={"unit": "{y}"})
    interval: float = field(metadata={"unit": "s"})
    order: int = 7
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("amplitude", "interval", "offset")
        if self.interval <= 0:
            raise ModelError(f"PRBS has interval={self.interval!r}; it must be positive.")
        if self.order not in TAPS:
            raise ModelError(f"PRBS has order={self.order!r}; it must be one of {', '.join(map(str, TAPS))}.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        names = ("interval", "amplitude", "offset")
        parameters = {name: getattr(self, name) for name in names} | {"tap": float(TAPS[self.order])}
        return Definition(_prbs, state={"register": np.ones(self.order), "drawn": 0.0}, parameters=parameters)


def _linear_chirp(t, amplitude, offset, begin, end, duration, y):
    passed = select(t < duration[0], t, duration[0])
    turns = begin[0] * passed + 0.5 * (end[0] - begin[0]) / duration[0] * passed * passed
    y[0] = offset[0] + amplitude[0] * sin(TAU * (turns + end[0] * (t - passed)))


def _exponential_chirp(t, amplitude, offset, begin, end, duration, growth, y):
    passed = select(t < duration[0], t, duration[0])
    turns = begin[0] * duration[0] / growth[0] * (exp(growth[0] * passed / duration[0]) - 1.0)
    y[0] = offset[0] + amplitude[0] * sin(TAU * (turns + end[0] * (t - passed)))


@dataclass(frozen=True)
class Chirp(Source):
    """A sine whose frequency rises or falls from `begin` to `end` within `duration` seconds, and then is constant.

    Parameters
    ----------
    amplitude : float
        How far the output swings to either side.
    begin, end : float
        First and last frequency in hertz, positive.
    duration : float
        Seconds in which the frequency changes from `begin` to `end`.
    sweep : {"linear", "exponential"}
        Whether the frequency changes by the same amount (linear) or by the same factor (exponential) in each second.
    offset : float
        Value about which the output swings.
    unit : str or None
        Unit of the output.

    Raises
    ------
    ModelError
        If a frequency or the duration is not positive, a setting is not finite, or there is no such sweep.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> chirp = cosim.Chirp(amplitude=1.0, begin=0.5, end=2.5, duration=1.0).online(dt=0.25, compiled=False)
    >>> [round(chirp().y, 3) for _ in range(5)]
    [0.0, 0.924, 0.0, -0.383, 0.0]
    """

    amplitude: float = field(metadata={"unit": "{y}"})
    begin: float = field(metadata={"unit": "Hz"})
    end: float = field(metadata={"unit": "Hz"})
    duration: float = field(metadata={"unit": "s"})
    sweep: str = "linear"
    offset: float = field(default=0.0, metadata={"unit": "{y}"})
    unit: str | None = None

    def __post_init__(self) -> None:
        self._check("amplitude", "begin", "end", "duration", "offset")
        for name in ("begin", "end", "duration"):
            if getattr(self, name) <= 0:
                raise ModelError(f"Chirp has {name}={getattr(self, name)!r}; it must be positive.")
        if self.sweep not in {"linear", "exponential"}:
            raise ModelError(f"Chirp has sweep={self.sweep!r}; it must be 'linear' or 'exponential'.")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        names = ("amplitude", "offset", "begin", "end", "duration")
        parameters = {name: getattr(self, name) for name in names}
        if self.sweep == "linear" or self.begin == self.end:
            return Definition(_linear_chirp, parameters=parameters)
        return Definition(_exponential_chirp, parameters=parameters | {"growth": logarithm(self.end / self.begin)})


__all__ = ["PRBS", "Chirp", "Pulse"]
