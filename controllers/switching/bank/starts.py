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

NEAR, FAR = 12.0, 100.0
"""Squared distances, in variances of the mean of a quantity's first samples: up to the first the plant starts where it is
believed to be; about the second a start elsewhere becomes probable."""

AGREES = 9.0
"""Squared distance, in its variance, up to which two samples agree."""

SPREAD = 100.0
"""How much the variance of an unread state grows in a start elsewhere on which two samples agree: the plant may move as well. It
does not grow where a quantity has a single sensor, because the next samples would then say that the sensor has an offset."""


@cache
def make_settle(layout: Layout) -> Callable[..., None]:
    """Return the step function that settles a part of the end of a process mode, or moves it to the first samples.

    If a quantity's first samples are far from the belief, this hypothesis says that the plant starts elsewhere, as if it had been
    kicked before. Its state goes to the most precise of them that agrees with their median, so that one faulty sensor of three
    rarely has an effect. That costs the probability of this sample in a wide prior, as a jump costs a sensor's offset.
    """
    n, m, sensor, none, elsewhere = layout.n, layout.m, layout.sensor, layout.first, layout.elsewhere
    quantity, new, error = layout.quantity, layout.scratch, layout.scratch + layout.m
    spread_of = new  # of a sample that is located, in place of the flag that it is the sensor's first one
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

    def together(i, nominal, memory):
        """Return the variance of the mean of these samples, weighted by their precisions."""
        precision = LEAST + 0.0 * memory[new]
        for j in range(m):
            if quantity[j] == quantity[i]:
                precision = precision + memory[new + j] / nominal[j, j]
        return 1.0 / precision

    def locate(i, count, nominal, memory):
        """Write the deviation of the most precise of these samples that agrees with their median, and its variance.

        Of the two middle ones of an even number the one nearer to the belief counts as the median.
        """
        low, high, of_low, of_high = 0.0 * count, 0.0 * count, 0.0 * count, 0.0 * count
        for j in range(m):
            if quantity[j] == quantity[i]:
                twice, mine = 0.0 * count, memory[error + j]
                for k in range(m):
                    if quantity[k] == quantity[i] and k != j:
                        less = memory[error + k] <= mine if k < j else memory[error + k] < mine
                        twice = twice + select(less, 2.0 * memory[new + k], 0.0)
                counts = memory[new + j] > 0.5
                lower = both(counts, either(twice == count - 1.0, twice == count - 2.0))
                upper = both(counts, either(twice == count - 1.0, twice == count))
                low, of_low = select(lower, mine, low), select(lower, nominal[j, j], of_low)
                high, of_high = select(upper, mine, high), select(upper, nominal[j, j], of_high)
        nearer = absolute(low) <= absolute(high)
        middle, of_middle = select(nearer, low, high), select(nearer, of_low, of_high)
        far, variance = middle, of_middle
        for j in range(m):
            if quantity[j] == quantity[i]:
                off = memory[error + j] - middle
                agrees = off * off < AGREES * (nominal[j, j] + of_middle)
                better = both(both(agrees, nominal[j, j] < variance), memory[new + j] > 0.5)
                far = select(better, memory[error + j], far)
                variance = select(better, nominal[j, j], variance)
        memory[error + i], memory[spread_of + i] = far, variance

    def settle(e, present, C, nominal, memory, settings, at):
        compare(e, present, C, nominal, memory, at)
        farthest, wide = 0.0 * memory[at], 1.0 + 0.0 * memory[at]
        spread = select(memory[at] < memory[none], SPREAD, 0.0)
        for i in range(m):
            if leads[i]:
                count, variance = samples(i, memory), together(i, nominal, memory)
                locate(i, count, nominal, memory)
                far, of_one = memory[error + i], memory[spread_of + i]
                far = select(far * far > NEAR * variance, far, 0.0)
                farthest = maximum(farthest, far * far / variance)
                wide = wide * select(far == 0.0, 1.0, sqrt(of_one / (of_one + far * far)))
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
                widened = select(far == 0.0, 0.0, memory[spread_of + i])
                for a in range(n):
                    memory[z + a] = memory[z + a] + settings[first + a * m] * far
                    for b in range(n):
                        along = settings[first + a * m] * settings[first + b * m]
                        memory[P + a * N + b] = memory[P + a * N + b] + widened * along
        collect(memory, at, SETTLES * (1.0 - moved), -1)

    return settle
