"""Outages in a bank of hypotheses: steps without any sample, as of a logger, which say nothing about sensors and plant."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import STATE
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.mode_kernels import WEIGHT
from bayesftc.controllers.switching.sensor_kernels import FIRST, MISSING
from bayesftc.cosim.ops import both, maximum, select


@cache
def make_outage(layout: Layout) -> Callable[..., float]:
    """Return the step function for whether a step is an outage (1, else 0).

    No sensor has a sample, also not those, two or more, which send most of the time and have not dropped out before.
    """
    m, sensor, row, width, drops = layout.m, layout.sensor, layout.row, layout.width, layout.drops or (0,)
    count = len(layout.drops)

    def outage(sample, memory, settings):
        sampled, silent = 0.0 * sample.nominal[0, 0], 0.0 * sample.nominal[0, 0]
        for i in range(m):
            dropped = 0.0 * sampled
            for k in range(count):
                dropped = dropped + memory[i * sensor + FIRST + drops[k] * width + WEIGHT]
            sampled = maximum(sampled, sample.present[i])
            silent = silent + select(both(settings[i * row + MISSING] < 0.5, dropped < 0.5), 1.0, 0.0)
        return select(both(sampled < 0.5, silent > 1.5), 1.0, 0.0)

    return outage


@cache
def make_keep(layout: Layout) -> Callable[..., None]:
    """Return the step function that copies the hypotheses before a step."""
    none, saved, size = layout.first, layout.saved, layout.hypotheses * layout.length

    def keep(memory):
        for a in range(size):
            memory[saved + a] = memory[none + a]

    return keep


@cache
def make_restore(layout: Layout) -> Callable[..., None]:
    """Return the step function that undoes what a step has concluded about faults if it is an ``outage``.

    The beliefs about state and offset remain predicted. What hypotheses have received from others meanwhile is negligible, as
    their probabilities are those of the last sample.
    """
    none, saved, kept, length, H = layout.first, layout.saved, layout.kept, layout.length, layout.hypotheses
    density = layout.m * layout.sensor + 1

    def restore(outage, memory):
        for h in range(H):
            at, before = none + h * length, saved + h * length
            for a in range(STATE):
                memory[at + a] = select(outage > 0.5, memory[before + a], memory[at + a])
            for a in range(kept, length):
                memory[at + a] = select(outage > 0.5, memory[before + a], memory[at + a])
        memory[density] = select(outage > 0.5, 0.0, memory[density])

    return restore
