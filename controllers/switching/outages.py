"""Outages: steps without any sample, as of a logger, which say nothing about the sensors."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.mode_kernels import WEIGHT
from bayesftc.controllers.switching.sensor_kernels import FIRST, MISSING
from bayesftc.cosim.ops import both, maximum, select

WIDE, SETTLES = 1.5, 30.0
"""How many times as large as before the belief's variance is wide; number of samples after which it need not settle any more."""


@cache
def make_outage(length: int, row: int, width: int, drops: tuple[int, ...]) -> Callable[..., float]:
    """Return the step function for whether a step is an outage (1, else 0).

    No sensor has a sample, also not those, two or more, which send most of the time and have not dropped out before.

    Parameters
    ----------
    length, row : int
        Numbers of values and of settings of a sensor.
    width : int
        Width of the block of a mode.
    drops : tuple of int
        The modes without samples.
    """
    count, modes = len(drops), drops or (0,)

    def outage(sample, memory, settings):
        sampled, silent = 0.0 * sample.nominal[0, 0], 0.0 * sample.nominal[0, 0]
        for i in range(sample.y.shape[0]):
            dropped = 0.0 * sampled
            for k in range(count):
                dropped = dropped + memory[i * length + FIRST + modes[k] * width + WEIGHT]
            sampled = maximum(sampled, sample.present[i])
            silent = silent + select(both(settings[i * row + MISSING] < 0.5, dropped < 0.5), 1.0, 0.0)
        return select(both(sampled < 0.5, silent > 1.5), 1.0, 0.0)

    return outage


def prolonged(outage, sample, memory, at):
    """Return whether an outage lasts: it goes on until the belief about the state is nearly as narrow again as before.

    Until then the samples correct the state by the precisions from before the outage, and say nothing about the sensors: judged
    one by one, healthy sensors that contradict a wide belief together would be blamed, and a faulty one that agrees with it by
    chance acquitted. In ``memory`` are, from ``at`` on, the width of the belief and the number of samples left.
    """
    wide = 0.0 * outage
    for i in range(sample.y.shape[0]):
        wide = wide + sample.spread[i, i] / sample.nominal[i, i]
    left = select(outage > 0.5, SETTLES, memory[at + 1] - 1.0)
    settles = both(both(outage < 0.5, left > 0.5), wide > WIDE * memory[at])
    lasts = select(settles, 1.0, outage)
    memory[at] = select(lasts > 0.5, memory[at], wide)
    memory[at + 1] = select(lasts > 0.5, left, 0.0)
    return lasts
