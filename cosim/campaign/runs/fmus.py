"""Find the FMUs of a campaign: in the diagram, and in factors."""

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
    """Return the FMUs of a campaign by their SHA-256: those anywhere in the first point, and those of the factors."""
    paths: dict[str, Path] = {}

    def note(value: Any) -> Reduced | None:
        if not isinstance(value, FMU):
            return None
        path = Path(value.path)
        paths[open_archive(path).digest] = path
        return str, ()

    diagram = job.diagram(0)
    for part in (diagram, *job.plan.points):
        try:
            pickled(part, note)
        except ModelError:  # if a block cannot be pickled, the job cannot either: note only the blocks that are FMUs
            for node in diagram.nodes:
                note(node.block)
    for path in paths_among(job):
        paths[open_archive(path).digest] = path
    return paths


def paths_among(job: Job) -> list[Path]:
    """Return the FMUs that factors name by their paths."""
    values = {value for point in job.plan.points for value in point.values() if isinstance(value, str | Path)}
    named = sorted(expanded(value).absolute() for value in values if str(value).endswith(".fmu"))
    readable = []
    for path in named:
        try:
            open_archive(path)
        except FMUError:  # the runs will fail with this error
            continue
        readable.append(path)
    return readable


__all__ = ["fmus_of", "paths_among"]
