"""Runs in worker processes on this machine."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass

from bayesftc.cosim.campaign.designs.plan import Piece
from bayesftc.cosim.campaign.executors.base import R, Threads, Work, check_jobs
from bayesftc.cosim.campaign.executors.crew import Crew
from bayesftc.cosim.campaign.runs.pickling import pickled


@dataclass(frozen=True)
class Processes:
    """Runs in worker processes: for FMUs that allow one instance per process, and for blocks and metrics in Python.

    It works on Linux and macOS. Elsewhere the campaign ends with a `BayesFTCError` before its first run.

    The campaign is pickled, once for each process. With cloudpickle (in the extra ``campaign``) this includes functions and
    blocks that a script or notebook defines. A script needs no ``if __name__ == "__main__"``.

    A run that ends its process, or hangs in a step beyond the time limit, counts as failed. The other runs continue.

    Parameters
    ----------
    jobs : int, optional
        Number of processes; by default one for each core that this process may use.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=1.0), "noise")
    >>> campaign = cosim.Campaign(diagram, duration=100.0, seeds=4, metrics=[cosim.RMSE("noise.y", name="size")])
    >>> campaign.run(executor=cosim.Processes(2)).table["size"].round(1).tolist()
    [1.0, 1.0, 1.0, 1.0]
    """

    jobs: int | None = None

    def __post_init__(self) -> None:
        check_jobs(self.jobs)

    def check(self, job: object) -> None:
        """Raise a `ModelError` if a job cannot be sent to other processes."""
        pickled(job)

    def run(self, job: Work[R], pieces: Iterable[Piece]) -> Generator[R, None, None]:
        """See `Executor.run`."""
        yield from Threads(self.jobs).run(Crew(pickled(job)), pieces)


__all__ = ["Processes"]
