"""Choose the default executor of a campaign."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from bayesftc.cosim.block import Block
from bayesftc.cosim.campaign.executors.base import Executor, Threads, cores
from bayesftc.cosim.campaign.executors.dask import DaskCluster
from bayesftc.cosim.campaign.executors.processes import Processes
from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.archive import open_archive

EXECUTORS: tuple[type[Executor], ...] = (Threads, Processes, DaskCluster)
"""All executors of this package."""


def choose_executor(job: Job) -> tuple[Executor, str]:
    """Return the executor for a job, and the reason for it as a sentence.

    It is `Threads` if threads can use all cores: all blocks are compiled, FMUs can have several instances in a process, and no
    FMU computes in Python. Isolated FMUs have separate processes, so that threads suffice for them. The choice considers the
    first point, and the blocks that other points have in its place.

    Parameters
    ----------
    job : Job
        The job.
    """
    if cores() == 1:
        return Threads(), "Threads: this process may use one core."
    against = next(against_threads(job.diagram(0), _blocks(job)), None)
    if against is None:
        return Threads(), "Threads: all blocks are compiled, and no FMU needs a separate process."
    executor = Processes()
    try:
        executor.check(job)
    except ModelError as error:
        return Threads(1), f"One thread: {against}, and processes are impossible. {error}"
    return executor, f"Processes: {against}."


def against_threads(diagram: Diagram, further: Iterable[tuple[str, Block]] = ()) -> Iterator[str]:
    """Yield the reasons why threads cannot run a diagram side by side.

    Parameters
    ----------
    diagram : Diagram
        The diagram; it is built.
    further : iterable of (str, Block)
        Names and blocks that take a place in it.
    """
    schedule = diagram.build().schedule
    for node, definition in zip(schedule.nodes, schedule.definitions, strict=True):
        if definition is not None and not definition.compiled:
            yield f"the block {node.name!r} computes in Python, which runs one thread at a time"
    for name, block in (*((node.name, node.block) for node in diagram.nodes), *further):
        if isinstance(block, FMU) and not block.isolate:
            if block.description.capabilities.get("canBeInstantiatedOnlyOncePerProcess"):
                yield f"the FMU {name!r} allows only one instance per process"
            if "resources/slavemodule.txt" in open_archive(Path(block.path)).names:
                yield f"the FMU {name!r} computes in Python, which runs one thread at a time"


def _blocks(job: Job) -> Iterator[tuple[str, Block]]:
    for point in job.plan.points:
        for name, value in point.items():
            if isinstance(value, Block):
                yield name, value


__all__ = ["EXECUTORS", "against_threads", "choose_executor"]
