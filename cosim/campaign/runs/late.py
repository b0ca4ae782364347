"""Faults after the end of a campaign's runs, of a diagram or of a function that makes one."""

from __future__ import annotations

from collections.abc import Iterator

from bayesftc.cosim.blocks.faults.without_effect import late_faults
from bayesftc.cosim.campaign.runs.job import Job, fault_starts
from bayesftc.cosim.diagram.diagram import Diagram

TRIED = 100
"""Largest number of points at which a function is called: beyond, a fault may have an effect, and nothing is claimed."""


def faults_after_the_end(job: Job) -> Iterator[str]:
    """Yield a sentence for each fault that starts at or after the end of the run at every point."""
    end = job.steps * job.step
    starts = _of_diagram(job.loop, job) if isinstance(job.loop, Diagram) else _of_function(job)
    yield from late_faults({f"The fault {name!r}": values for name, values in starts.items()}, end)


def _of_diagram(loop: Diagram, job: Job) -> dict[str, list[object]]:
    points = job.plan.points
    return {
        name: [point.get(f"{name}.start", start) for point in points]
        for name, start in fault_starts(loop).items()
        if name not in points[0]  # a factor replaces the whole fault
    }


def _of_function(job: Job) -> dict[str, list[object]]:
    """Return the starts of the faults that are late at every point: the function is called until there are none."""
    end = job.steps * job.step
    late: dict[str, list[object]] = {name: [start] for name, start in job.starts.items()}
    for point in range(1, len(job.plan.points) + 1):
        late = {name: values for name, values in late.items() if any(late_faults({name: values}, end))}
        if not late or point == len(job.plan.points):
            break
        if point == TRIED:
            return {}
        try:
            starts = fault_starts(job.diagram(point))
        except Exception:  # noqa: BLE001 - the runs of this point fail with this reason
            continue
        late = {name: [*values, starts[name]] if name in starts else values for name, values in late.items()}
    return late


__all__ = ["faults_after_the_end"]
