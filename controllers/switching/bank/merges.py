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
from bayesftc.controllers.switching.sensor_kernels import FIRST, HEALTHY, LEAST
from bayesftc.cosim.ops import maximum, minimum


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
            memory, at, incoming, source, i, memory[source + OFFSET_AGE], memory[c], memory[c + 1],
            memory[cc], memory[cc + 1], memory[cc + N + 1],
        )  # fmt: skip
        blend_between(memory, at, part, source, n)
        memory[source] = LEAST + 0.0 * incoming

    return become


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
