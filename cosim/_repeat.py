"""One diagram for many seeds: the engine is set up once, which for short runs takes longer than the runs themselves."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing
from fractions import Fraction
from typing import TYPE_CHECKING

from bayesftc.cosim._isolation.spares import Spares
from bayesftc.cosim._running import BREATH, advance, choose_engine, explain, failed, open_run
from bayesftc.cosim.engines import CompiledEngine, Engine, Run
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.recording import select_signals
from bayesftc.cosim.result import Result
from bayesftc.cosim.timebase import whole_steps

if TYPE_CHECKING:
    from bayesftc.cosim.diagram import Diagram


def repeat(
    diagram: Diagram, duration: float | str | Fraction, seeds: Iterable[int], record: Iterable[str]
) -> Iterator[Result]:
    """Yield the result of ``diagram.simulate(duration, seed=seed, record=record)`` for each seed, to the same bits.

    Parameters
    ----------
    diagram : Diagram
        What to run.
    duration : float, str or Fraction
        Seconds of each run.
    seeds : iterable of int
        One for each run.
    record : iterable of str
        Names of the signals to keep.

    Raises
    ------
    SimulationError
        If a run has to stop; the sentence says at which seed.
    """
    schedule = diagram.schedule
    steps = whole_steps(duration, schedule.step, "The duration")
    selection = select_signals(schedule, record)
    known: tuple[CompiledEngine, Run, list[int]] | None = None
    short = False
    with closing(Spares()) as spares:
        for seed in seeds:
            with spares.lent(), ExitStack() as stack:
                run = open_run(schedule, stack, check_seed(seed), selection, steps, 1)
                # What an FMU's instance calls its own lies in memory; only another binary would have other functions.
                addresses = [a for i in run.instances.values() for a in (i.output_address, i.update_address)]
                machine: Engine
                if known is not None and known[2] == addresses:
                    machine, first, _ = known
                    first.memory[:] = run.memory
                    first.seed, first.recording, first.instances = run.seed, run.recording, run.instances
                    first.state_functions = run.state_functions
                    first.before, first.k, first.sound = run.before, run.k, run.sound
                    run = first
                else:
                    machine = choose_engine("auto", run)
                    known = (machine, run, addresses) if isinstance(machine, CompiledEngine) else None
                began = time.perf_counter()
                if short:  # over before anyone would notice: no pauses, for which threads would wait for each other
                    failure = machine.advance(0, steps, first=True)[1]
                    stopped = explain(failure, run) if failure else None
                else:
                    stopped = advance(machine, steps, run)
                    short = time.perf_counter() - began < BREATH
            result = Result(run.recording, selection.columns, schedule.step, units=selection.units, stopped=stopped)
            if stopped:
                raise failed(f"With seed {seed}: {stopped}", result, run)
            yield result
