"""The cost of learning fault modes: the whole FMU loop with `SwitchingPrecision` and with `GammaPrecision`."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench.measures.full_loop import full_diagram

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesftc.cosim.diagram.diagram import Diagram

FEW, SOME, MANY = 2, 5, 8
"""Numbers of sensors: the paper's, and two larger ones to show how the time grows."""
QUICK = "not measured in a quick run, because compilation takes too long."


def measure(quick: bool = False) -> Section:
    """Measure the loops in turns: all with two sensors, and some with more to show how the time grows."""
    from bayesftc import controllers

    steps, rounds = (20_000, 2) if quick else (200_000, 9)
    learners = {
        "gamma": None,
        "per_sensor": controllers.SwitchingPrecision(joint=False),
        "joint": controllers.SwitchingPrecision(),
    }
    cases = [(name, m) for m in ((FEW,) if quick else (FEW, SOME, MANY)) for name in ("gamma", "per_sensor")]
    cases += [] if quick else [("joint", FEW), ("joint", SOME)]
    loops = {(name, m): full_diagram(precision=learners[name], sensors=m) for name, m in cases}
    taken = in_turns(
        {f"{name} {m}": partial(_time_of_a_step, loop, steps) for (name, m), loop in loops.items()}, rounds
    )

    def over_gamma(name: str, m: int) -> Sequence[float]:
        return ratios(taken.get(f"{name} {m}", ()), taken.get(f"gamma {m}", ()) if f"{name} {m}" in taken else ())

    def of_a_sensor(fewer: int, more: int) -> Sequence[float]:
        """Return the learner's time for each further sensor, beyond that of the gamma learner's loop."""
        if f"gamma {more}" not in taken:
            return ()
        beyond = [np.subtract(taken[f"per_sensor {m}"], taken[f"gamma {m}"]) for m in (fewer, more)]
        return list((beyond[1] - beyond[0]) / (more - fewer))

    reason = QUICK if quick else None
    growth = ratios(of_a_sensor(SOME, MANY), of_a_sensor(FEW, SOME))
    one, many = over_gamma("per_sensor", FEW), over_gamma("per_sensor", MANY)
    beside = "SwitchingPrecision per sensor / GammaPrecision, two sensors"
    further = f"time of a further sensor: from {SOME} to {MANY} / from {FEW} to {SOME}"
    return Section(
        "learners",
        "The whole loop with fault modes, beside precision learning",
        (
            Figure("gamma", "GammaPrecision, two sensors", "ns/step", taken[f"gamma {FEW}"]),
            Figure("per_sensor", beside, "", one, at_most=2.0),
            Figure("per_sensor_many", f"the same with {MANY} sensors", "", many, reason=reason),
            Figure("growth", further, "", growth, at_most=1.25, reason=reason, note="1 is linear"),
            Figure("joint", "joint form / GammaPrecision, two sensors", "", over_gamma("joint", FEW), reason=reason),
            Figure("joint_many", f"the same with {SOME} sensors", "", over_gamma("joint", SOME), reason=reason),
        ),
    )


def _time_of_a_step(loop: Diagram, steps: int) -> float:
    """Return the processor time of a step in nanoseconds. A first call compiles."""
    loop.simulate(loop.step, seed=1, record=["controller.u"])
    started = time.process_time()
    loop.simulate(steps * loop.step, seed=1, record=["controller.u"])
    return 1e9 * (time.process_time() - started) / steps
