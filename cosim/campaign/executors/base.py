"""Executors run the pieces of a job and pass on their outcomes as they arrive.

To write an executor you must:

1. return from ``run(job, pieces)`` an iterator of the `Outcome` of each piece, in any order, each once. Take pieces only as fast
   as outcomes are taken, so that waiting outcomes do not fill the memory;
2. run every piece by ``job.run(piece)``, in this process or in another one to which the job was pickled: the bits are the
   same everywhere;
3. stop at once, and leave nothing behind, when the iterator is closed or on Ctrl-C;
4. add it to `EXECUTORS` in ``choice.py``, to ``cosim/__init__.pyi``, to the table of ``docs/reference/campaigns.md``, to the
   command line (`Executor` and `_executor` in ``src/bayesftc/cli/commands/campaigns/campaign.py``), and to `EXAMPLES` of
   ``tests/cosim/campaign/test_executors.py``.
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
from bayesftc.cosim.run.many import KeepGoing

R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
AHEAD = 2
"""Number of pieces for each worker that are being run or wait to be taken."""


class Work(Protocol[R_co]):
    """Work that is done piece by piece, such as a `Job`."""

    def run(self, piece: Piece, keep_going: KeepGoing = ...) -> R_co:
        """Do a piece, in any thread; raise `StoppedFromOutside` if it is no longer needed."""

    def close(self) -> None:
        """Free what all pieces share."""


class Executor(Protocol):
    """Runs the pieces of a job; see the docstring of the module."""

    def run(self, job: Work[R], pieces: Iterable[Piece]) -> Generator[R, None, None]:
        """Yield the outcome of each piece."""


@dataclass(frozen=True)
class Threads:
    """Runs in a pool of threads of this process. The compiled loop releases the interpreter's lock, so they use all cores.

    Parameters
    ----------
    jobs : int, optional
        Number of threads; by default one for each core that this process may use.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=1.0), "noise")
    >>> campaign = cosim.Campaign(diagram, duration=100.0, seeds=4, metrics=[cosim.RMSE("noise.y", name="size")])
    >>> campaign.run(executor=cosim.Threads(2)).table["size"].round(1).tolist()
    [1.0, 1.0, 1.0, 1.0]
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
            waiting: list[Future[R]] = []
            try:
                while True:
                    for piece in islice(left, AHEAD * workers - len(waiting)):
                        waiting.append(pool.submit(job.run, piece, lambda: not stopped.is_set()))
                    if not waiting:
                        return
                    done = wait(waiting, return_when=FIRST_COMPLETED).done
                    finished = [future for future in waiting if future in done]  # in the order of the pieces
                    waiting = [future for future in waiting if future not in done]
                    for future in finished:
                        yield future.result()
            finally:
                stopped.set()
                pool.shutdown(wait=True, cancel_futures=True)
                job.close()


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_jobs(jobs: object) -> None:
    """Refuse a wrong number of workers; None is one for each core."""
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise ModelError(f"jobs is {jobs!r}; it must be a whole number of workers, at least 1.")


__all__ = ["Executor", "Threads", "check_jobs", "cores"]
