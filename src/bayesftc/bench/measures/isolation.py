"""The cost of running an FMU in a separate process, compared with the same loop in process; the memory left by instances."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.bench._child import repeated
from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench.measures.full_loop import EXPERIMENT, RECORD, engine_recording, full_diagram
from bayesftc.cosim.run.session import Session

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram

EVERY = 100

LIVES = """
import json
from fractions import Fraction
import numpy as np
from bayesftc import cosim, fmus
from bayesftc.bench.measures.memory import resident

def live(block, u=np.zeros(2), y=np.zeros(1)):
    instance = block.instantiate(Fraction(1, 50), "car")
    instance.output(u, y, 0.0)
    instance.update(u, y, 0.0)
    instance.close()

grown = []
for fmi in ("2.0", "3.0"):
    block = cosim.FMU(fmus.path("CruiseControl", fmi=fmi))
    for _ in range(100):
        live(block)
    before = resident()
    for _ in range({lives}):
        live(block)
    grown.append(resident() - before)
print(json.dumps(grown))
"""


def measure(quick: bool = False) -> Section:
    """Compare the bits of both loops, measure them in turns, then measure the memory that instances in process leave."""
    slow, fast, rounds, lives = (2_000, 20_000, 2, 200) if quick else (200_000, 1_000_000, 7, 10_000)
    inside, outside = full_diagram(), full_diagram(isolate=True)
    difference = float(np.abs(engine_recording(outside, EXPERIMENT, 1) - engine_recording(inside, EXPERIMENT, 1)).max())
    starts = [_starting(outside) for _ in range(rounds)]
    with _session(inside) as first, _session(outside) as second:
        rates = in_turns(
            {"in_process": lambda: _rate(inside, first, fast), "isolated": lambda: _rate(outside, second, slow)}, rounds
        )
    results, reason = repeated(LIVES.format(lives=lives))
    grown, label = (
        [growth / 1e6 for run in results for growth in run],
        f"growth over {lives:,} instances in process, FMI 2 and 3",
    )
    bits, rate = "bit for bit" if difference == 0.0 else "not bit for bit", "steps/s"
    return Section(
        "isolation",
        "FMUs in separate processes",
        (
            Figure("isolated", "whole loop, FMU isolated", rate, rates["isolated"], at_least=4e5),
            Figure("in_process", "whole loop, FMU in process", rate, rates["in_process"]),
            Figure("over_in_process", "isolated / in process", "", ratios(rates["isolated"], rates["in_process"])),
            Figure(
                "difference", "largest difference of all recorded signals", "", [difference], at_most=0.0, note=bits
            ),
            Figure("start", "start and end of an isolated instance, compiled code loaded", "s", starts),
            Figure("lives", label, "MB", grown, at_most=1.0, reason=reason),
        ),
    )


def _session(diagram: Diagram) -> Session:
    session = diagram.start(seed=1, record=RECORD, decimation=EVERY, engine="compiled")
    session.advance(EVERY * diagram.step)
    return session


def _rate(diagram: Diagram, session: Session, steps: int) -> float:
    started = time.perf_counter()
    session.advance(steps * diagram.step)
    return steps / (time.perf_counter() - started)


def _starting(diagram: Diagram) -> float:
    started = time.perf_counter()
    diagram.start(engine="compiled").close()
    return time.perf_counter() - started
