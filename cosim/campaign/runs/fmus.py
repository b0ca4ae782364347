"""The FMUs of a campaign: in the diagram, and named by factors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.runs.pickling import Reduced, pickled
from bayesftc.cosim.errors import FMUError, ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.archive import open_archive


def fmus_of(job: Job) -> dict[str, Path]:
    """Return the FMUs of a campaign, by their SHA-256: those of the first point, wherever they are in it, and of the factors."""
    found: dict[str, Path] = {}

    def note(thing: Any) -> Reduced | None:
        if not isinstance(thing, FMU):
            return None
        path = Path(thing.path)
        found[open_archive(path).digest] = path
        return str, ()

    diagram = job.diagram(0)
    for part in (diagram, *job.plan.points):
        try:
            pickled(part, note)
        except ModelError:  # a block that does not pickle has none that are of use elsewhere
            for node in diagram.nodes:
                note(node.block)
    for path in paths_among(job):
        found[open_archive(path).digest] = path
    return found


def paths_among(job: Job) -> list[Path]:
    """Return the FMUs that factors name by their paths."""
    values = {value for point in job.plan.points for value in point.values() if isinstance(value, str | Path)}
    named = sorted(expanded(value).absolute() for value in values if str(value).endswith(".fmu"))
    found = []
    for path in named:
        try:
            open_archive(path)
        except FMUError:  # the runs will say so
            continue
        found.append(path)
    return found


__all__ = ["fmus_of", "paths_among"]
