"""Many runs on all cores with the executors of campaigns: each part of an experiment's runs is a task."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from bayesftc.cosim.campaign.designs.plan import Piece
from bayesftc.cosim.campaign.designs.seeds import hashed_seeds
from bayesftc.cosim.campaign.executors.base import Threads, check_jobs as check_workers
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.run.many import KeepGoing

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram

R = TypeVar("R")
K = TypeVar("K")
Progress = Callable[[str, int, int], None]
"""Called as ``progress(what, done, of)``."""


def check_jobs(jobs: int) -> int:
    """Return the number of threads; raise a ModelError if it is not valid."""
    if jobs is None:
        raise ModelError("jobs is None. It must be a whole number of threads, at least 1.")
    check_workers(jobs)
    return jobs


@dataclass(frozen=True)
class _Tasks(Generic[R]):
    """Tasks as the pieces of a job for an executor."""

    tasks: Sequence[Callable[[], R]]

    def run(self, piece: Piece, keep_going: KeepGoing = lambda: True) -> tuple[int, R]:
        """Do a task; return its number and its result."""
        return piece.index, self.tasks[piece.index]()

    def close(self) -> None:
        """Do nothing: each task frees its resources itself."""


class Batch(NamedTuple, Generic[R]):
    """A loop, the seeds of its runs, and the function that makes some of them, called as ``function(loop, seeds)``."""

    loop: Diagram
    seeds: Sequence[int]
    function: Callable[[Diagram, Sequence[int]], R]


@dataclass(frozen=True)
class Ensemble:
    """The common settings of all runs of an experiment.

    Raises
    ------
    ModelError
        If the seed or the number of threads is not valid.
    """

    seed: int  # of all noise
    jobs: int = 1  # number of threads
    progress: Progress | None = None  # called as ``progress(what, done, of)``

    def __post_init__(self) -> None:
        check_seed(self.seed)
        check_jobs(self.jobs)

    def seeds(self, purpose: str, count: int) -> list[int]:
        """Return seeds for one purpose, see `hashed_seeds`."""
        return hashed_seeds(self.seed, purpose, count)

    def tell(self, what: str, done: int, of: int) -> None:
        """Report the progress, if there is a progress function."""
        if self.progress:
            self.progress(what, done, of)

    def prepare(self, loops: Sequence[Diagram]) -> None:
        """Make one step with each loop, so that all is compiled before the threads start."""
        for i, loop in enumerate(loops):
            self.tell("Preparing", i, len(loops))
            with loop.start(record=[]) as session:
                session.advance(loop.step)

    def run(self, tasks: Sequence[Callable[[], R]], what: str) -> list[R]:
        """Run all tasks on the threads and return their results in order; `what` is the label of the progress.

        Tasks are independent, so the results have the same bits for any number of threads. After Ctrl-C or an error, running
        tasks are completed, so each should be short; the others are dropped.
        """
        results: dict[int, R] = {}
        self.tell(what, 0, len(tasks))
        pieces = [Piece(i, i, i + 1) for i in range(len(tasks))]
        with closing(Threads(self.jobs).run(_Tasks(tasks), pieces)) as done:
            for number, result in done:
                results[number] = result
                self.tell(what, len(results), len(tasks))
        return [results[i] for i in range(len(tasks))]

    def each(self, what: str, batches: Mapping[K, Batch[R]], size: int) -> tuple[dict[K, list[R]], float]:
        """Prepare the loops of all batches, then run them in tasks of `size` runs.

        Return the results of the functions for each batch, in the order of its seeds, and the seconds without the preparation.
        """
        self.prepare([batch.loop for batch in batches.values()])
        groups = {key: chunks(batch.seeds, size) for key, batch in batches.items()}
        tasks = [partial(batch.function, batch.loop, few) for key, batch in batches.items() for few in groups[key]]
        began = time.perf_counter()
        done = iter(self.run(tasks, what))
        seconds = time.perf_counter() - began
        return {key: [next(done) for _ in group] for key, group in groups.items()}, seconds

    def one(self, what: str, batch: Batch[R], size: int) -> list[R]:
        """Run one batch, see `each`."""
        results, _ = self.each(what, {what: batch}, size)
        return results[what]


def chunks(items: Sequence[int], size: int) -> list[Sequence[int]]:
    """Return the items in groups of `size`, the last one smaller."""
    return [items[i : i + size] for i in range(0, len(items), size)]
