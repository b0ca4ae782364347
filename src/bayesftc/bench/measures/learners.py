"""What learning fault modes costs: the whole FMU loop with `SwitchingPrecision` beside that with `GammaPrecision`."""

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
"""Numbers of sensors: the paper's, and two more to see how the time grows."""
QUICK = "not measured in a quick run: compiling takes longer than that."


def measure(quick: bool = False) -> Section:
    """Measure the loops in turns: with two sensors all, with more those that show how the time grows."""
    from bayesftc import controllers

    steps, rounds = (20_000, 2) if quick else (200_000, 9)
    known = {
        "gamma": None,
        "per_sensor": controllers.SwitchingPrecision(joint=False),
        "joint": controllers.SwitchingPrecision(),
    }
    wanted = [(name, m) for m in ((FEW,) if quick else (FEW, SOME, MANY)) for name in ("gamma", "per_sensor")]
    wanted += [] if quick else [("joint", FEW), ("joint", SOME)]
    loops = {(name, m): full_diagram(precision=known[name], sensors=m) for name, m in wanted}
    taken = in_turns(
        {f"{name} {m}": partial(_time_of_a_step, loop, steps) for (name, m), loop in loops.items()}, rounds
    )

    def over_gamma(name: str, m: int) -> Sequence[float]:
        return ratios(taken.get(f"{name} {m}", ()), taken.get(f"gamma {m}", ()) if f"{name} {m}" in taken else ())

    def of_a_sensor(fewer: int, more: int) -> Sequence[float]:
        """Return the time that the learner takes for each further sensor, beyond the gamma learner's loop."""
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
    """Return how many nanoseconds of the processor's time a step takes; compiled before, as the first call does."""
    loop.simulate(loop.step, seed=1, record=["controller.u"])
    started = time.process_time()
    loop.simulate(steps * loop.step, seed=1, record=["controller.u"])
    return 1e9 * (time.process_time() - started) / steps
