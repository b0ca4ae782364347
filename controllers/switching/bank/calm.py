"""A process that is quieter than the model says, and what an unmodelled course is then credited with.

Process noise is often stated too large, to be on the safe side. The belief then follows the noise of the sensors, and beside one
sensor another one that does not follow that noise seems frozen or filtered; a single sensor seems too quiet. An unmodelled course
would explain either. While the innovations are smaller than expected, a course is therefore credited with the density of no fault
at most, unless the last errors of its sensor were large.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.conditioning import ERROR, SPREAD, TOTAL
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.mode_kernels import log_density
from bayesftc.controllers.switching.sensor_kernels import HEALTHY
from bayesftc.cosim.ops import both, maximum, minimum, select

CALM = 0.85
"""Mean squared innovation, in its expected variances, below which the process is quieter than the model says."""

LEARNED = 0.01
"""Weight of a sample in that mean."""

START = 200.0
"""Number of samples from the first one on in which small errors of a sensor that seems faulty count."""

LARGE = 9.0
"""Largest squared error, in its expected variances, that counts in a mean."""

FOLLOWED, WRONG = 0.2, 4.0
"""Weight of a sample in the mean of a sensor's last squared errors, and the mean from which on these are large."""


@cache
def make_notice(layout: Layout) -> Callable[..., None]:
    """Return the step function that learns from a reading without a fault how large innovations are, and keeps it.

    A reading counts by the share of its variance that the state has, and that of a faulty sensor not at all: a filtered one has
    small errors as well. At the start such errors count, because a sensor may only seem faulty then, as the process is quiet.
    """
    m, sensor, readings, surprise, usual = layout.m, layout.sensor, layout.readings, layout.surprise, layout.usual
    count = m * sensor

    def notice(i, present, nominal, memory):
        square, total = memory[readings + ERROR] * memory[readings + ERROR], memory[readings + TOTAL]
        memory[usual + i] = square
        memory[usual + m + i] = total
        spread = memory[readings + SPREAD]
        ratio = minimum(square / maximum(total, spread + nominal), LARGE)
        seems = both(memory[count] < START, square < total)
        sound = present * select(seems, 1.0, minimum(memory[i * sensor + HEALTHY], 1.0))
        memory[surprise] = memory[surprise] + LEARNED * sound * (spread / total) * (ratio - memory[surprise])

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
        last = memory[usual + 2 * m + i]
        last = last + present * FOLLOWED * (minimum(square / total, LARGE) - last)
        memory[usual + 2 * m + i] = last
        most = select(both(memory[surprise] < CALM, last < WRONG), log_density(square, total), density)
        return minimum(density, most)

    return credit
