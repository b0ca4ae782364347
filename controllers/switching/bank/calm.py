"""The rule for a quiet process (``../calm.py``) in the joint form."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.conditioning import ERROR, SPREAD, TOTAL
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.calm import credited, followed, surprised
from bayesftc.controllers.switching.mode_kernels import log_density
from bayesftc.controllers.switching.sensor_kernels import HEALTHY
from bayesftc.cosim.ops import select


@cache
def make_notice(layout: Layout) -> Callable[..., None]:
    """Return the step function that learns from a reading without a fault how large innovations are, and keeps it."""
    m, sensor, readings, surprise, usual = layout.m, layout.sensor, layout.readings, layout.surprise, layout.usual
    count = m * sensor

    def notice(i, present, nominal, memory):
        square, total = memory[readings + ERROR] * memory[readings + ERROR], memory[readings + TOTAL]
        memory[usual + i] = square
        memory[usual + m + i] = total
        memory[surprise] = surprised(
            memory[surprise],
            square,
            total,
            memory[readings + SPREAD],
            nominal,
            present,
            memory[i * sensor + HEALTHY],
            memory[count],
        )

    return notice


@cache
def make_credit(layout: Layout) -> Callable[..., float]:
    """Return the function for the log density with which a course is credited.

    Without a fault the reading has its density given all other sensors. Without the only sensor of a quantity the state is soon
    unknown; then it is that in the hypothesis without any fault.
    """
    m, surprise, usual = layout.m, layout.surprise, layout.usual

    def credit(density, square, total, i, present, memory):
        """Return it for a course's log ``density`` and the sensor's ``square`` error, without a fault of variance ``total``."""
        known = total <= memory[usual + m + i]
        square, total = select(known, square, memory[usual + i]), select(known, total, memory[usual + m + i])
        last = followed(memory[usual + 2 * m + i], square, total, present)
        memory[usual + 2 * m + i] = last
        return credited(density, log_density(square, total), memory[surprise], last)

    return credit
