"""What a scenario or campaign says to no effect, in sentences: a slip, or a short run of a long scenario, and so no error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.errors import StepSizeError
from bayesftc.scenario._paths import line_of
from bayesftc.scenario._place import Place
from bayesftc.scenario._scenario import Scenario, scenario_of
from bayesftc.scenario._sections import Simulation

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.campaign import Campaign
    from bayesftc.scenario.campaigns import ScenarioLoop

OF_CAMPAIGNS = [f"simulation.{f.name}" for f in fields(Simulation) if f.name != "dt"]
"""Lines of a scenario that a campaign has itself."""


def unused(scenario: Scenario, duration: float | str | Fraction | None = None) -> list[str]:
    """Return a sentence for each fault that comes after the end of a run, and each sensor or variable that nobody reads.

    Parameters
    ----------
    scenario : Scenario
        As it is loaded.
    duration : number or str, optional
        Seconds of the run, where it is not the scenario's.
    """
    try:
        end = rational_step(scenario.simulation.duration if duration is None else duration)
    except StepSizeError:  # of which the run says more
        return []
    root = Place(str(scenario.path))
    starts = {place: [start] for place, start in _starts(scenario)}
    return [*_late(root, starts, end), *_unread(root, scenario)]


def unused_of_campaign(campaign: Campaign, path: str) -> list[str]:
    """Return the same of the scenario of a campaign file, and a sentence for each factor that changes nothing."""
    loop: ScenarioLoop = campaign.job.loop  # type: ignore[assignment]
    scenario = scenario_of(loop.content, Path(loop.path))
    points = [{line_of(name, loop.content): value for name, value in p.items()} for p in campaign.job.plan.points]
    of_campaign = [name for name in points[0] if name in OF_CAMPAIGNS]
    starts = {
        place: [point.get(f"{place}.start", start) for point in points]
        for place, start in _starts(scenario)
        if not any(place.startswith(name) for name in points[0])  # of which it is unknown what takes its place
    }
    where = Place(loop.path)
    return [
        *(
            f"{Place(path)}: the factor {name!r} changes nothing: a campaign has its own; leave it out."
            for name in of_campaign
        ),
        *_late(where, starts, campaign.job.steps * campaign.job.step),
        *_unread(where, scenario),
    ]


def _starts(scenario: Scenario) -> Iterator[tuple[str, float]]:
    """Yield where each fault stands in the file, and when it starts."""
    lists: Mapping[str, Iterable[Any]] = {
        "faults": scenario.faults,
        **{f"input_faults.{name}": faults for name, faults in scenario.input_faults.items()},
    }
    for name, faults in lists.items():
        for i, fault in enumerate(faults):
            yield f"{name}[{i}]", fault.start


def _late(root: Place, starts: Mapping[str, list[float]], end: Fraction) -> Iterator[str]:
    for place, values in starts.items():
        first = min(values)
        if first >= end:
            yield (
                f"{root / place} starts at {first:g} s, but the run ends at {show(end)} s, so that there is no such fault in it."
            )


def _unread(root: Place, scenario: Scenario) -> Iterator[str]:
    """Yield what is read by nobody, by rows and columns of zeros."""
    sensors, model = scenario.sensors, getattr(scenario.controller, "model", None)
    if sensors is not None and sensors.matrix is not None:
        matrix = np.asarray(sensors.matrix)
        measured = [scenario.wiring.measured] if isinstance(scenario.wiring.measured, str) else scenario.wiring.measured
        for i in np.flatnonzero(~matrix.any(axis=1)):
            yield f"{root / 'sensors.matrix'} has a row of zeros, so that sensor {i} reads nothing of the plant."
        if len(measured) == matrix.shape[1]:
            for j in np.flatnonzero(~matrix.any(axis=0)):
                yield f"{root / 'sensors.matrix'} has a column of zeros, so that no sensor reads {measured[int(j)]!r}."
    if isinstance(model, LinearModel):
        for i in np.flatnonzero(~model.matrix("C").any(axis=1)):
            yield f"{root / 'model.C'} has a row of zeros, so that the controller does not use sensor {i}."
