"""Notes on settings of a scenario or campaign without effect: a mistake, or a short run of a long scenario; so no error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.blocks.faults.without_effect import (
    late_faults,
    short_faults,
    unconnected,
    unread_sensors,
    unread_variables,
)
from bayesftc.cosim.errors import StepSizeError
from bayesftc.scenario._blocks import faults_among
from bayesftc.scenario._paths import line_of
from bayesftc.scenario._place import Place
from bayesftc.scenario._scenario import Scenario, scenario_of, step_of
from bayesftc.scenario._sections import Simulation

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.campaign import Campaign
    from bayesftc.scenario.campaigns import ScenarioLoop

OF_CAMPAIGNS = [f"simulation.{f.name}" for f in fields(Simulation) if f.name != "dt"]
"""Lines of a scenario that a campaign replaces by its own settings."""


def unused(scenario: Scenario, duration: float | str | Fraction | None = None) -> list[str]:
    """Return a sentence for each fault after the end of the run or between two steps, and for each unused sensor or block.

    Parameters
    ----------
    scenario : Scenario
        The loaded scenario.
    duration : number or str, optional
        Seconds of the run; by default the scenario's.
    """
    try:
        end = rational_step(scenario.simulation.duration if duration is None else duration)
    except StepSizeError:  # the run raises it with its place
        return []
    root = Place(str(scenario.path))
    times = {f"{root / place}": of for place, of in _times(scenario)}
    step = step_of(root, scenario.controller, scenario.simulation)
    late = late_faults({name: [start] for name, (start, _) in times.items()}, end)
    return [*late, *short_faults(times, step), *_unread(root, scenario), *_unconnected(root, scenario)]


def unused_of_campaign(campaign: Campaign, path: str) -> list[str]:
    """Return the sentences of `unused` for a campaign's scenario, and one for each factor without effect."""
    loop: ScenarioLoop = campaign.job.loop  # type: ignore[assignment]
    scenario = scenario_of(loop.content, Path(loop.path))
    points = [{line_of(name, loop.content): value for name, value in p.items()} for p in campaign.job.plan.points]
    of_campaign = [name for name in points[0] if name in OF_CAMPAIGNS]
    starts = {
        place: [point.get(f"{place}.start", start) for point in points]
        for place, (start, _) in _times(scenario)
        if not any(place.startswith(name) for name in points[0])  # a factor replaces the whole fault
    }
    where = Place(loop.path)
    return [
        *(
            f"{Place(path)}: the factor {name!r} has no effect, because a campaign sets it itself. Leave it out."
            for name in of_campaign
        ),
        *late_faults(
            {f"{where / place}": each for place, each in starts.items()}, campaign.job.steps * campaign.job.step
        ),
        *_unread(where, scenario),
        *_unconnected(where, scenario),
    ]


def _times(scenario: Scenario) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the place of each fault in the file, its earliest start, and its latest stop."""
    lists: Mapping[str, Iterable[Any]] = {
        "faults": scenario.faults,
        **{f"input_faults.{name}": faults for name, faults in scenario.input_faults.items()},
    }
    for name, faults in lists.items():
        for i, fault in enumerate(faults):
            yield f"{name}[{i}]", fault.times
    for place, fault in faults_among(scenario.blocks):
        yield place, fault.times


def _unread(root: Place, scenario: Scenario) -> Iterator[str]:
    sensors, model = scenario.sensors, getattr(scenario.controller, "model", None)
    measured = scenario.wiring.measured
    if sensors is not None:
        names = [measured] if isinstance(measured, str) else measured
        yield from unread_variables(f"{root / 'sensors.matrix'}", sensors.matrix, names)
    if isinstance(model, LinearModel):
        yield from unread_sensors(f"{root / 'model.C'}", model.matrix("C"))


def _unconnected(root: Place, scenario: Scenario) -> Iterator[str]:
    """Yield a sentence for each further block that reads no signal, and that nothing reads."""
    parts = [
        *scenario.faults,
        *chain(*scenario.input_faults.values()),
        *(block for block, _ in scenario.blocks.values()),
    ]
    ends = [end for sources, target in scenario.connections for end in (*sources, target)]
    ends += [signal for part in parts for signal in part.named_sources.values()]
    for name in sorted(scenario.blocks.keys() - {end.partition(".")[0] for end in ends}):
        yield unconnected(f"{root / f'blocks.{name}'}", "Connect it in [[connections]]")
