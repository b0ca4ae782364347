"""Outages in a bank of hypotheses: of what a step without any sample has concluded, only predictions and ages remain."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import OFFSET_AGE, STATE
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.mode_kernels import AGE
from bayesftc.controllers.switching.sensor_kernels import FIRST
from bayesftc.cosim.ops import select


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

    The beliefs about state and offset remain predicted, and each fault is a sample older: else its onset would move on. What
    hypotheses have received from others meanwhile is negligible, as their probabilities are those of the last sample.
    """
    none, saved, kept, length, H = layout.first, layout.saved, layout.kept, layout.length, layout.hypotheses
    m, sensor, modes, width, density = layout.m, layout.sensor, layout.modes, layout.width, layout.m * layout.sensor + 1

    def restore(outage, memory):
        older = select(outage > 0.5, 1.0, 0.0)
        for h in range(H):
            at, before = none + h * length, saved + h * length
            for a in range(STATE):
                memory[at + a] = select(outage > 0.5, memory[before + a], memory[at + a])
            for a in range(kept, length):
                memory[at + a] = select(outage > 0.5, memory[before + a], memory[at + a])
            memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + older
            for i in range(m):
                for k in range(modes):
                    age = at + kept + i * sensor + FIRST + k * width + AGE
                    memory[age] = memory[age] + older
        memory[density] = select(outage > 0.5, 0.0, memory[density])

    return restore
