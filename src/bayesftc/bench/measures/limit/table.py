"""The table: the loop by hand, the engine in both ways and the user's loop in turns, and the nanoseconds of each part of a step.

What a part takes is the time of the whole loop by hand less that of the loop without it. Parts overlap in the processor, so that
their sum need not be the whole.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from math import inf
from statistics import median

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import unpacked_fmu
from bayesftc.bench.measures.full_loop import EXPERIMENT, RECORD, SETTING, engine_recording, full_diagram, user_rate
from bayesftc.bench.measures.limit.by_hand import PARTS, compiled
from bayesftc.cosim.run.fused import compiled as compiled_loop
from bayesftc.cosim.run.fused.compiled import LANES
from bayesftc.cosim.run.many import ManyRuns
from bayesftc.cosim.run.recording import select_signals

STEPS = 1000
"""Length of the runs in lock step."""

EVERY = 1000
"""Steps between two recorded ones in the engine's loop that records next to nothing."""


def measure(quick: bool = False) -> Section:
    """Check that the loops compute the same, then measure them in turns."""
    fast, slow, rounds = (20_000, 300, 2) if quick else (1_000_000, 20_000, 9)
    diagram = full_diagram()

    def engine(decimation: int, *, fused: bool) -> float:
        with _fused(always=fused):
            started = time.perf_counter()
            diagram.simulate(fast * diagram.step, seed=1, record=RECORD, decimation=decimation)
            return 1e9 * (time.perf_counter() - started) / fast

    def lanes() -> float:
        with _fused(always=True), closing(ManyRuns(diagram.schedule, columns, STEPS)) as runs:
            count = max(4 * LANES, fast // STEPS)
            warm = sum(len(block.steps) for block in runs.run(range(count), of=2 * count))
            started = time.perf_counter()
            done = sum(len(block.steps) for block in runs.run(range(warm, warm + count), of=2 * count))
            return 1e9 * (time.perf_counter() - started) / (done * STEPS)

    columns = select_signals(diagram.schedule, RECORD)
    for decimation in (1, EVERY):
        engine(decimation, fused=True)  # compiles
    lanes()

    with unpacked_fmu() as car, compiled(car, SETTING) as by_hand:
        recording = engine_recording(diagram, EXPERIMENT, 1)
        difference = max(
            float(np.abs(by_hand(name, EXPERIMENT)[0] - recording)[:, 0].max())
            for name in ("whole_loop", "own_controller")
        )
        shorter = {part: lambda name=name: 1e9 * by_hand(name, fast)[1] / fast for part, name in PARTS.items()}
        times = in_turns(
            {
                "c": lambda: 1e9 * by_hand("whole_loop", fast)[1] / fast,
                "own": lambda: 1e9 * by_hand("own_controller", fast)[1] / fast,
                "fused": lambda: engine(1, fused=True),
                "fused_alone": lambda: engine(EVERY, fused=True),
                "lanes": lanes,
                "engine": lambda: engine(1, fused=False),
                "user": lambda: 1e9 / user_rate(slow),
                **shorter,
            },
            rounds,
        )
    unit = "ns/step"
    parts = [_part(part, times["c"], times[part]) for part in PARTS]
    return Section(
        "limit",
        "The whole loop beside the same written by hand in C",
        (
            Figure("c", "loop by hand in C, for this case alone: the limit", unit, times["c"]),
            *parts,
            Figure("own", "the same with the engine's controller, exported as C", unit, times["own"]),
            Figure("fused", "engine, one function for the loop", unit, times["fused"]),
            Figure("fused_alone", f"the same, every {EVERY}th step recorded", unit, times["fused_alone"]),
            Figure("lanes", f"{LANES} runs of {STEPS} steps in lock step, for each run", unit, times["lanes"]),
            Figure("engine", "engine, block by block", unit, times["engine"]),
            Figure("user", "loop with fmpy, NumPy and filterpy", unit, times["user"]),
            Figure(
                "engine_over_own",
                "speed of one function / C with the same controller",
                "",
                ratios(times["own"], times["fused"]),
                at_least=0.8,
            ),
            Figure(
                "engine_over_c", "speed of one function / C for this case alone", "", ratios(times["c"], times["fused"])
            ),
            Figure(
                "fused_over_engine",
                "speed of one function / block by block",
                "",
                ratios(times["engine"], times["fused"]),
            ),
            Figure("lanes_over_c", "speed of runs in lock step / C", "", ratios(times["c"], times["lanes"])),
            Figure("difference", "largest difference of the speeds", "m/s", [difference], at_most=1e-9),
        ),
    )


@contextmanager
def _fused(*, always: bool) -> Iterator[None]:
    """Use one function for the loop of each run, or of none; it is only compiled for runs that are far longer."""
    before = compiled_loop.LOADED, compiled_loop.COMPILED
    compiled_loop.LOADED, compiled_loop.COMPILED = (0, 0) if always else (inf, inf)
    try:
        yield
    finally:
        compiled_loop.LOADED, compiled_loop.COMPILED = before


def _part(part: str, whole: Sequence[float], without: Sequence[float]) -> Figure:
    """Return the time of a part of the loop: what the whole loop needs more than the loop without it."""
    more = [all_ - rest for all_, rest in zip(whole, without, strict=True)]
    key, label, unit = part, f"of that: {part}", "ns/step"
    if median(more) > 0.0:
        return Figure(key, label, unit, more)
    return Figure(key, label, unit, (), reason="less than the scatter of the times")
