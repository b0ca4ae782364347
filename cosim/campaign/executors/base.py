"""Who makes the runs: an executor has the pieces of a job done and hands their outcomes on as they come.

To write an executor you must:

1. return from ``run(job, pieces)`` an iterator of the `Outcome` of each piece, in any order, each once, which asks for pieces
   only as fast as outcomes are taken, so that those that wait do not fill the memory;
2. have every piece done by ``job.run(piece)``, in this process or in another one to which the job was pickled: the bits are the
   same wherever that is;
3. stop at once, and leave nothing behind, when the iterator is closed or Ctrl-C comes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Protocol, TypeVar

from bayesftc.cosim.campaign.designs.plan import Piece
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.run.many import Wanted

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
AHEAD = 2
"""Pieces for each worker that are made or wait to be taken."""


class Work(Protocol[R_co]):
    """What is done piece by piece: a `Job` is."""

    def run(self, piece: Piece, wanted: Wanted = ...) -> R_co:
        """Do a piece, in any thread; raise `StoppedFromOutside` when it is no longer wanted."""

    def close(self) -> None:
        """Free what all pieces have shared."""


class Executor(Protocol):
    """Has the pieces of a job done; see the module's text."""

    def run(self, job: Work[R], pieces: Iterable[Piece]) -> Generator[R, None, None]:
        """Yield the outcome of each piece."""


@dataclass(frozen=True)
class Threads:
    """Runs on threads of this process: the compiled loop frees the interpreter, so they use all cores.

    Parameters
    ----------
    jobs : int, optional
        Number of threads; by default one for each core that this process may use.
    """

    jobs: int | None = None

    def __post_init__(self) -> None:
        check_jobs(self.jobs)

    def run(self, job: Work[R], pieces: Iterable[Piece]) -> Generator[R, None, None]:
        """See `Executor.run`."""
        left = iter(pieces)
        workers = self.jobs or cores()
        stopped = threading.Event()
        with ThreadPoolExecutor(workers, thread_name_prefix="campaign") as pool:
            waiting: set[Future[R]] = set()
            try:
                while True:
                    for piece in islice(left, AHEAD * workers - len(waiting)):
                        waiting.add(pool.submit(job.run, piece, lambda: not stopped.is_set()))
                    if not waiting:
                        return
                    done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield future.result()
            finally:
                stopped.set()
                pool.shutdown(wait=True, cancel_futures=True)
                job.close()


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_jobs(jobs: object) -> None:
    """Refuse what is no number of workers; None is one for each core."""
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise ModelError(f"jobs is {jobs!r}; it must be a whole number of workers, at least 1.")


__all__ = ["Executor", "Threads", "check_jobs", "cores"]
