"""Merging of hypotheses: ended ones into the pool, and one hypothesis into another."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.blends import make_blend_sensor
from bayesftc.controllers.switching.bank.hypothesis import (
    OFFSET_AGE,
    STATE,
    blend,
    blend_between,
    blend_healthy,
)
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.mode_kernels import AGE, ENTERED, OWN, SIZE, WEIGHT
from bayesftc.controllers.switching.sensor_kernels import ENDS, FIRST, FIRST_SETTINGS, HEALTHY, LEAST
from bayesftc.cosim.ops import maximum, minimum, sqrt

OLD = 0.3
"""Age of an offset, in its mean durations, at which a sixteenth of its probability counts beside a new fault; later more does."""


@cache
def make_collect(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges the ended part of a hypothesis into the pool."""
    n, m, pool, kept, sensor, width = layout.n, layout.m, layout.pool, layout.kept, layout.sensor, layout.width
    other, blend_sensor = layout.other, make_blend_sensor(layout.width, layout.other)

    def collect(memory, at, end, i):
        """Merge the part ``end`` of a hypothesis into the pool; sensor ``i`` had an offset (-1: none)."""
        ended = memory[at] * end
        memory[at] = maximum(memory[at] - ended, LEAST)
        both = maximum(memory[pool] + ended, LEAST * LEAST)
        part = ended / both
        memory[pool] = both
        blend(memory, pool, part, at, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(m):
            if j == i:
                blend_healthy(memory, pool + kept + j * sensor, part, FIRST, width, other)
            else:
                blend_sensor(memory, pool + kept + j * sensor, part, at + kept + j * sensor, 1.0)

    return collect


@cache
def make_receive(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges a part of another hypothesis into one."""
    n, m, kept, sensor = layout.n, layout.m, layout.kept, layout.sensor
    blend_sensor = make_blend_sensor(layout.width, layout.other)

    def receive(memory, at, incoming, source, i, age, c, b, cc, cb, bb):
        """Merge the probability ``incoming`` with an offset of this mean, slope and covariance, of sensor ``i`` (-1: none)."""
        part = incoming / (memory[at] + incoming)
        memory[at] = memory[at] + incoming
        blend(memory, at, part, source, n, 1, c, b, cc, cb, bb)
        memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + part * (age - memory[at + OFFSET_AGE])
        for j in range(m):
            if j != i:
                blend_sensor(memory, at + kept + j * sensor, part, source + kept + j * sensor, 1.0)

    return receive


@cache
def make_become(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges a whole hypothesis into another one with an offset, of sensor ``i`` (-1: none)."""
    n, N, receive = layout.n, layout.n + 2, make_receive(layout)

    def become(memory, at, source, i):
        c, cc, incoming = source + STATE + n, source + STATE + N + n * N + n, memory[source]
        part = incoming / (memory[at] + incoming)
        receive(
            memory,
            at,
            incoming,
            source,
            i,
            memory[source + OFFSET_AGE],
            memory[c],
            memory[c + 1],
            memory[cc],
            memory[cc + 1],
            memory[cc + N + 1],
        )
        blend_between(memory, at, part, source, n)
        memory[source] = LEAST + 0.0 * incoming

    return become


@cache
def make_describe(layout: Layout) -> Callable[..., None]:
    """Return the step function that writes the offset of a hypothesis as mode ``k`` of its sensor ``i``, before the prediction.

    The hypothesis itself does not use the modes of this sensor.
    """
    n, N, kept, sensor, width, other = (
        layout.n,
        layout.n + 2,
        layout.kept,
        layout.sensor,
        layout.width,
        layout.other,
    )

    def describe(memory, at, i, k):
        of_sensor, c, cc = at + kept + i * sensor, at + STATE + n, at + STATE + N + n * N + n
        memory[of_sensor + HEALTHY] = LEAST + 0.0 * memory[at]
        for mode in range(len(other)):
            memory[of_sensor + FIRST + mode * width + WEIGHT] = LEAST + 0.0 * memory[at]
        block = of_sensor + FIRST + k * width
        memory[block + WEIGHT] = 1.0 + 0.0 * memory[at]
        memory[block + AGE] = memory[at + OFFSET_AGE] + 1.0
        memory[block + SIZE], memory[block + OWN] = memory[c], memory[c + 1]
        # The prediction, which follows, resets a hypothesis whose covariance rounding has destroyed.
        of_c, of_b = maximum(memory[cc], 0.0), maximum(memory[cc + N + 1], 0.0)
        most = sqrt(of_c * of_b)
        memory[block + OWN + 1], memory[block + OWN + 3] = of_c, of_b
        memory[block + OWN + 2] = maximum(minimum(memory[cc + 1], most), -most)

    return describe


@cache
def make_gather(layout: Layout) -> Callable[..., float]:
    """Return the step function that writes the belief before a fault of an actuator or the process.

    A sensor may have an offset already when that happens. The belief is therefore that of the hypotheses without a fault and with
    an offset of one sensor together. The offset becomes a mode of its sensor, as in the hypotheses of the new fault. A young
    offset counts little, because it may be what the new fault explains.
    """
    n, m, none, stride, kept, sensor = (
        layout.n,
        layout.m,
        layout.first,
        layout.length,
        layout.kept,
        layout.sensor,
    )
    kinds, joined, before = layout.kinds or (0,), layout.joined or (False,), layout.before
    row_length, width_of_settings = layout.row, layout.width_of_settings
    K, blend_sensor = len(layout.kinds), make_blend_sensor(layout.width, layout.other)

    def gather(memory, settings, begun):
        """Return the probability of an offset that counts; the part ``begun`` of it leaves its hypothesis."""
        for a in range(stride):
            memory[before + a] = memory[none + a]
        for i in range(m):
            for q in range(K):
                if joined[q]:
                    at = none + (1 + i * K + q) * stride
                    ends = settings[i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + ENDS]
                    old = memory[at + OFFSET_AGE] * ends / (memory[at + OFFSET_AGE] * ends + OLD)
                    old = old * old
                    share = memory[at] * old * old
                    memory[at] = maximum(memory[at] - share * begun, LEAST)
                    memory[before] = memory[before] + share
                    part = share / memory[before]
                    blend(memory, before, part, at, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
                    for j in range(m):
                        of_sensor = kept + j * sensor
                        blend_sensor(memory, before + of_sensor, part, at + of_sensor, 1.0)
        return memory[before] - memory[none]

    return gather


@cache
def make_receive_new(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges a fault of an actuator or the process that begins into its hypothesis.

    Offsets of sensors that were there before do not begin with it.
    """
    m, K, kinds, joined, before = (
        layout.m,
        len(layout.kinds),
        layout.kinds or (0,),
        layout.joined or (False,),
        layout.before,
    )
    kept, sensor, width, source = layout.kept, layout.sensor, layout.width, before if any(joined) else layout.first
    receive = make_receive(layout)

    def receive_new(memory, at, incoming, c, cc):
        remaining = 1.0 - incoming / (memory[at] + incoming)  # rounded as for the weights, so that no share exceeds 1
        for i in range(m):
            for q in range(K):
                if joined[q]:
                    block = at + kept + i * sensor + FIRST + kinds[q] * width
                    memory[block + ENTERED] = remaining * memory[block + WEIGHT] * memory[block + ENTERED]
        receive(memory, at, incoming, source, -1, 0.0, c, 0.0, cc, 0.0, 0.0)
        for i in range(m):
            for q in range(K):
                if joined[q]:
                    block = at + kept + i * sensor + FIRST + kinds[q] * width
                    memory[block + ENTERED] = memory[block + ENTERED] / memory[block + WEIGHT]

    return receive_new


@cache
def make_witnessed(layout: Layout) -> Callable[..., float]:
    """Return the function for the probability that a sensor has a witness."""
    m, sensor = layout.m, layout.sensor

    def witnessed(memory, sensors, i):
        """Return the probability that a sensor other than ``i`` is healthy."""
        none_healthy = 1.0 + 0.0 * memory[sensors + HEALTHY]
        for j in range(m):
            if j != i:
                none_healthy = none_healthy * (1.0 - minimum(memory[sensors + j * sensor + HEALTHY], 1.0))
        return 1.0 - none_healthy

    return witnessed
