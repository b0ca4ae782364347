"""Diagrams of many small blocks: the time to build and to run them, and how both grow."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesftc.cosim.block import Block
    from bayesftc.cosim.diagram.diagram import Diagram

FEW, SOME, MANY = 50, 200, 800
"""Numbers of blocks."""
STEPS = 1000


def measure(quick: bool = False) -> Section:
    """Build and run diagrams of 50, 200 and 800 blocks in turns, in processor time; runs have 1,000 steps, once compiled."""
    sizes, rounds = ((FEW, SOME), 2) if quick else ((FEW, SOME, MANY), 9)
    diagrams = {n: chain(n).build() for n in sizes}
    for diagram in diagrams.values():
        _seconds_of_a_run(diagram)  # compiles
    built = in_turns({str(n): partial(_seconds_to_build, n) for n in sizes}, rounds)
    run = in_turns({str(n): partial(_seconds_of_a_run, diagram) for n, diagram in diagrams.items()}, rounds)
    reason = "not measured in a quick run." if quick else None
    of = f"{SOME} blocks"
    further = f"time of a further block: from {SOME} to {MANY} / from {FEW} to {SOME}"
    return Section(
        "large_diagrams",
        "Diagrams of many blocks",
        (
            Figure("build", f"{of}: added, connected and built", "s", built[str(SOME)], at_most=1.0),
            Figure("run", f"{of}: {STEPS} steps, all signals recorded", "ms", _in_ms(run[str(SOME)]), at_most=50.0),
            Figure(
                "build_growth", f"build, {further}", "", _growth(built), at_most=1.5, reason=reason, note="1 is linear"
            ),
            Figure("run_growth", f"run, {further}", "", _growth(run), at_most=1.5, reason=reason, note="1 is linear"),
        ),
    )


def chain(blocks: int) -> Diagram:
    """Return a diagram of a source and blocks of eight kinds in turns, each fed by the one before."""
    from bayesftc import cosim

    kinds: tuple[Block, ...] = (
        cosim.Gain(0.9),
        cosim.ExponentialFilter(0.1),
        cosim.RateLimiter(5.0),
        cosim.Saturation(-1.0, 1.0),
        cosim.UnitDelay(),
        cosim.LookupTable([-1.0, 0.0, 1.0], [-1.0, 0.5, 1.0]),
        cosim.MovingAverage(3),
        cosim.Integrator(low=-1.0, high=1.0),
    )
    diagram = cosim.Diagram("1/100")
    last = diagram.add(cosim.Sine(1.0, period=3.0), "source")
    for i in range(blocks - 1):
        node = diagram.add(kinds[i % len(kinds)], f"b{i}")
        diagram.connect(last["y"], node["u"])
        last = node
    return diagram


def _seconds_to_build(blocks: int) -> float:
    started = time.process_time()
    chain(blocks).build()
    return time.process_time() - started


def _seconds_of_a_run(diagram: Diagram) -> float:
    started = time.process_time()
    diagram.simulate(STEPS * diagram.step, engine="compiled")
    return time.process_time() - started


def _in_ms(seconds: Sequence[float]) -> list[float]:
    return [1e3 * each for each in seconds]


def _growth(taken: dict[str, list[float]]) -> list[float]:
    """Return the time of a further block in the large diagrams, divided by that in the small ones, for each round."""
    if str(MANY) not in taken:
        return []
    few, some, many = (np.array(taken[str(n)]) for n in (FEW, SOME, MANY))
    return ratios((many - some) / (MANY - SOME), (some - few) / (SOME - FEW))
