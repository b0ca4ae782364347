"""The start of the plant in a bank of hypotheses: at the belief, or elsewhere, where the first samples say."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import STATE
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.bank.merges import make_collect, make_receive
from bayesftc.controllers.switching.sensor_kernels import LAST, LEAST, held
from bayesftc.cosim.ops import absolute, both, either, maximum, select, sqrt

SETTLES = 0.02
"""Probability per sample that the end of a process mode becomes final. Until then the end is a separate hypothesis, because often
only the samples after a kick reveal it."""

NEAR, FAR = 25.0, 100.0
"""Squared distances, in variances of the sensor's noise: up to the first the plant starts where it is believed to be; about the
second a start elsewhere becomes probable."""

SPREAD = 100.0
"""How much the variance of an unread state grows in a start elsewhere on which two samples agree: the plant may move as well. It
does not grow where a quantity has a single sensor, because the next samples would then say that the sensor has an offset."""


@cache
def make_settle(layout: Layout) -> Callable[..., None]:
    """Return the step function that settles a part of the end of a process mode, or moves it to the first samples.

    If a quantity's first samples are far from the belief, this hypothesis says that the plant starts elsewhere, as if it had been
    kicked before. Its state goes to their median (of the two middle ones to the nearer), so that one faulty sensor of three has
    no effect. That costs the probability of this sample in a wide prior, as a jump costs a sensor's offset.
    """
    n, m, sensor, none, elsewhere = layout.n, layout.m, layout.sensor, layout.first, layout.elsewhere
    quantity, new, error = layout.quantity, layout.scratch, layout.scratch + layout.m
    leads = tuple(quantity.index(of) == i for i, of in enumerate(quantity))
    collect, receive, doubt, unread = make_collect(layout), make_receive(layout), layout.doubt, layout.unread

    def compare(e, present, C, nominal, memory, at):
        """Write which sensors have their first sample (1 or 0), and the samples' deviations from the likelier belief."""
        likelier = memory[at] > memory[none]
        for i in range(m):
            last, total = memory[i * sensor + LAST], e[i]
            for a in range(n):
                total = total - C[i, a] * select(likelier, memory[at + STATE + a], memory[none + STATE + a])
            memory[new + i] = select(both(last != last, present[i] > 0.5), 1.0, 0.0)
            memory[error + i] = held(total, nominal[i, i])

    def samples(i, memory):
        """Return the number of first samples of a sensor's quantity."""
        count = 0.0 * memory[new]
        for j in range(m):
            if quantity[j] == quantity[i]:
                count = count + memory[new + j]
        return count

    def median(i, count, memory):
        """Return the median deviation of these samples, of the two middle ones the smaller."""
        low, high = 0.0 * count, 0.0 * count
        for j in range(m):
            if quantity[j] == quantity[i]:
                twice, mine = 0.0 * count, memory[error + j]
                for k in range(m):
                    if quantity[k] == quantity[i] and k != j:
                        less = memory[error + k] <= mine if k < j else memory[error + k] < mine
                        twice = twice + select(less, 2.0 * memory[new + k], 0.0)
                counts = memory[new + j] > 0.5
                low = select(both(counts, either(twice == count - 1.0, twice == count - 2.0)), mine, low)
                high = select(both(counts, either(twice == count - 1.0, twice == count)), mine, high)
        return select(absolute(low) <= absolute(high), low, high)

    def settle(e, present, C, nominal, memory, settings, at):
        compare(e, present, C, nominal, memory, at)
        farthest, wide = 0.0 * memory[at], 1.0 + 0.0 * memory[at]
        spread = select(memory[at] < memory[none], SPREAD, 0.0)
        for i in range(m):
            if leads[i]:
                count, variance = samples(i, memory), nominal[i, i]
                far = median(i, count, memory)
                far = select(far * far > NEAR * variance, far, 0.0)
                farthest = maximum(farthest, far * far / variance)
                wide = wide * sqrt(variance / (variance + far * far))
                memory[error + i] = far
                spread = select(both(far != 0.0, count < 1.5), 0.0, spread)
        moved = select(farthest > 0.0, 1.0, 0.0)
        incoming = moved * settings[doubt] * memory[none]
        receive(memory, at, incoming, none, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        memory[none] = maximum(memory[none] - incoming, LEAST)
        memory[at] = maximum(memory[at] * select(moved > 0.5, wide * (farthest / (farthest + FAR)), 1.0), LEAST)
        z, P, N = at + STATE, at + STATE + n + 2, n + 2
        for a in range(n):
            grows = moved * spread * settings[unread + a]
            memory[P + a * N + a] = memory[P + a * N + a] * (1.0 + grows)
        for i in range(m):
            if leads[i]:
                far, first = memory[error + i], elsewhere + i
                widened = select(far == 0.0, 0.0, nominal[i, i])
                for a in range(n):
                    memory[z + a] = memory[z + a] + settings[first + a * m] * far
                    for b in range(n):
                        along = settings[first + a * m] * settings[first + b * m]
                        memory[P + a * N + b] = memory[P + a * N + b] + widened * along
        collect(memory, at, SETTLES * (1.0 - moved), -1)

    return settle
