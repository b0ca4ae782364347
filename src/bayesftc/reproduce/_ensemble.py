"""Many runs on all cores: seeds that never meet, and results whose bits do not depend on how many jobs computed them."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import check_seed

if TYPE_CHECKING:
    from bayesftc.cosim.diagram import Diagram

R = TypeVar("R")
Progress = Callable[[str, int, int], None]
"""Called as ``progress(what, done, of)``."""


def seeds(seed: int, purpose: str, count: int) -> list[int]:
    """Return `count` seeds for one purpose of an experiment.

    They are hashed from the experiment's seed and the purpose, so that runs for one purpose (a scenario, finding a setting)
    never share noise with those for another.
    """
    sequence = np.random.SeedSequence((check_seed(seed), zlib.crc32(purpose.encode())))
    return [int(s) for s in sequence.generate_state(count, np.uint64) >> np.uint64(1)]


def check_jobs(jobs: int) -> int:
    """Return the number of threads; raise a ModelError if it cannot be one."""
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise ModelError(f"jobs is {jobs!r}; it must be a whole number of threads, at least 1.")
    return jobs


def in_parallel(
    tasks: Sequence[Callable[[], R]], jobs: int, progress: Progress | None = None, what: str = "Simulating"
) -> list[R]:
    """Run all tasks on `jobs` threads and return their results in the order of the tasks.

    The compiled loop frees the interpreter, so threads use all cores. No task knows which others run, so the results are the
    same bits for any number of jobs. Ctrl-C and errors wait for the tasks that have begun, of which each should be short, and
    drop the rest.

    Parameters
    ----------
    tasks : sequence of callables without arguments
        What to do.
    jobs : int
        Number of threads, at least 1.
    progress : callable, optional
        Called as ``progress(what, done, of)`` after each task.
    what : str
        Name of the work, for the progress.
    """
    results: dict[int, R] = {}

    def report() -> None:
        if progress:
            progress(what, len(results), len(tasks))

    report()
    with ThreadPoolExecutor(check_jobs(jobs)) as pool:
        futures: dict[Future[R], int] = {}
        try:  # also around the submissions: else Ctrl-C there would wait for all of them
            for i, task in enumerate(tasks):
                futures[pool.submit(task)] = i
            for future in as_completed(futures):
                results[futures[future]] = future.result()
                report()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [results[i] for i in range(len(tasks))]


@dataclass(frozen=True)
class Ensemble:
    """What all runs of an experiment have in common.

    Parameters
    ----------
    seed : int
        Of all noise.
    jobs : int
        Number of threads.
    progress : callable, optional
        Called as ``progress(what, done, of)``.

    Raises
    ------
    ModelError
        If the seed or the number of threads cannot be one.
    """

    seed: int
    jobs: int = 1
    progress: Progress | None = None

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_jobs(self.jobs)

    def seeds(self, purpose: str, count: int) -> list[int]:
        """Return seeds for one purpose, see `seeds`."""
        return seeds(self.seed, purpose, count)

    def prepare(self, loops: Sequence[Diagram]) -> None:
        """Make one step with each loop, so that all is compiled before threads would wait for each other's compiling."""
        for i, loop in enumerate(loops):
            if self.progress:
                self.progress("Preparing", i, len(loops))
            loop.simulate(loop.step, record=[])

    def run(self, tasks: Sequence[Callable[[], R]], what: str) -> list[R]:
        """Run all tasks, see `in_parallel`."""
        return in_parallel(tasks, self.jobs, self.progress, what)

    def each(
        self,
        what: str,
        loops: Sequence[Diagram],
        seeds: Sequence[Sequence[int]],
        size: int,
        function: Callable[[Diagram, Sequence[int]], R],
    ) -> tuple[list[list[R]], float]:
        """Run each loop with seeds of its own, after all are prepared.

        Parameters
        ----------
        what : str
            Name of the work, for the progress.
        loops : sequence of Diagram
            What to run.
        seeds : sequence of sequences of int
            For each loop the seeds of its runs.
        size : int
            Number of runs that one task makes.
        function : callable
            Called as ``function(loop, seeds)`` for each task.

        Returns
        -------
        results : list of lists
            For each loop what the function returned, in the order of its seeds.
        seconds : float
            How long that took, without the preparation.
        """
        self.prepare(loops)
        groups = [chunks(own, size) for own in seeds]
        tasks = [partial(function, loop, few) for loop, mine in zip(loops, groups, strict=True) for few in mine]
        began = time.perf_counter()
        done = iter(self.run(tasks, what))
        seconds = time.perf_counter() - began
        return [[next(done) for _ in mine] for mine in groups], seconds


def chunks(items: Sequence[int], size: int) -> list[Sequence[int]]:
    """Return the items in groups of `size`, the last one smaller."""
    return [items[i : i + size] for i in range(0, len(items), size)]
