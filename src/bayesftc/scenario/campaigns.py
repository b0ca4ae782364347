"""A campaign file: the scenario, the lines that are varied, the number of runs, and what is stored of them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.paths import expanded, is_file
from bayesftc.cosim.blocks.faults.without_effect import noted_elsewhere
from bayesftc.cosim.campaign.designs.design import Design, Grid, Points
from bayesftc.cosim.campaign.designs.samples import LatinHypercube, SaltelliDesign, SobolSequence
from bayesftc.cosim.campaign.runs.metrics import METRICS, Metric
from bayesftc.cosim.errors import BayesFTCError, ScenarioError, did_you_mean
from bayesftc.scenario._files import find_scenario, read_toml
from bayesftc.scenario._paths import known_to_controller, line_of, set_line
from bayesftc.scenario._place import Place
from bayesftc.scenario._scenario import KNOWN, Scenario, is_designed, scenario_of
from bayesftc.scenario._schema import as_table, build, build_one_of, choose
from bayesftc.scenario._sections import with_numbers

if TYPE_CHECKING:
    from bayesftc.cosim.campaign.campaign import Campaign
    from bayesftc.cosim.diagram.diagram import Diagram

SAMPLES = (LatinHypercube, SobolSequence, SaltelliDesign)
"""Designs for ``[[samples]]``."""


MOST = 30
"""Largest number of values of a factor that are checked before the campaign runs."""


@dataclass(frozen=True)
class Runs:
    """Settings of a campaign file besides scenario, factors and metrics; see `bayesftc.cosim.Campaign`.

    Attributes
    ----------
    seeds : int or sequence of int
        Runs of each point, or their seeds.
    seed : int
        The seed from which the seeds of the runs are computed.
    independent : sequence of str
        Factors whose values have different noise.
    record : sequence of str
        Signals to store.
    decimation : int
        Every n-th step is stored.
    time_limit : float
        Largest computing time of a run in seconds. A run that takes longer counts as failed.
    piece : int
        Number of runs that are written at once.
    duration : float or str
        Seconds of each run; by default the scenario's.
    """

    seeds: int | Sequence[int] = 1
    seed: int = 0
    independent: Sequence[str] = ()
    record: Sequence[str] = ()
    decimation: int = 1
    time_limit: float | None = None
    piece: int | None = None
    duration: float | str | None = None


@dataclass(frozen=True)
class ScenarioLoop:
    """The loop of a scenario file with some lines changed: called with factors, it returns the diagram."""

    path: str
    content: Mapping[str, Any] = field(repr=False)

    def __call__(self, **factors: Any) -> Diagram:
        """Return the diagram with these factors: paths of lines, or names as in `bayesftc.cosim.varied`."""
        with noted_elsewhere():
            return self._scenario(factors).loop()

    def _scenario(self, factors: Mapping[str, Any]) -> Scenario:
        content = self.changed(factors)  # what it refuses is the name of a factor, not a value
        try:
            return scenario_of(content, Path(self.path))
        except ScenarioError as error:
            for name in factors:
                if self._is_valid({other: value for other, value in factors.items() if other != name}):
                    raise ScenarioError(_refusal(name, error)) from error
            raise

    def _is_valid(self, factors: Mapping[str, Any]) -> bool:
        try:
            scenario_of(self.changed(factors), Path(self.path))
        except BayesFTCError:
            return False
        return True

    def changed(self, factors: Mapping[str, Any]) -> dict[str, Any]:
        """Return the content of the scenario file with these factors; those of plant and sensors are unknown to the controller.

        Raises
        ------
        ScenarioError
            If two factors refer to one line, or there is no such line.
        """
        lines = {line_of(name, self.content): value for name, value in factors.items()}
        if len(lines) < len(factors):
            raise ScenarioError(
                f"Two of the factors {', '.join(map(repr, factors))} refer to the same line. Leave one out."
            )
        content = self._with(lines)
        known = known_to_controller(lines)
        if len(known) < len(lines) and is_designed(content):
            before = self._with({line: lines[line] for line in known})
            content[KNOWN] = {name: before[name] for name in ("plant", "sensors") if name in before} | content.get(
                KNOWN, {}
            )
        return content

    def _with(self, lines: Mapping[str, Any]) -> dict[str, Any]:
        content = deepcopy(dict(self.content))
        for line in sorted(lines, key=_depth):  # a table before its parts, in any order of the factors
            set_line(content, line, deepcopy(lines[line]))
        return content


def _refusal(factor: str, error: ScenarioError) -> str:
    """Return the message for a factor without which the scenario would be valid."""
    before, dot, last = factor.rpartition(".")
    if error.unknown and error.unknown[0] == last:
        return f"The factor {factor!r} refers to the unknown key {last!r}; {did_you_mean(last, error.unknown[1], before + dot)}"
    return f"The factor {factor!r} has a value that the scenario rejects. {error}"


def load_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read a campaign file and check its content.

    Parameters
    ----------
    path : str or path
        A TOML file, or the name of a shipped campaign. Its scenario is a path relative to it, or the name of a shipped one.

    Returns
    -------
    Campaign
        Ready to run.

    Raises
    ------
    ScenarioError
        If a file cannot be read, or if a key is unknown, missing or of a wrong type. The message names the key and its place.
    BayesFTCError
        If the loop rejects its settings at the first point.
    """
    from bayesftc.cosim.campaign.campaign import Campaign

    file = find_scenario(path, "campaign")
    content, root = dict(read_toml(file)), Place(str(file))
    if "scenario" not in content and "plant" in content:
        raise root.error(
            f"is a scenario, not a campaign file. To run it: bayesftc run {file}. For a campaign, write a file with scenario = "
            f"{file.name!r} and [factors] to vary; bayesftc example tracking prints one."
        )
    root.refuse_unknown(content, ["scenario", "factors", "points", "samples", "metrics", *_names(Runs)])
    if "scenario" not in content:
        raise root.error(
            "lacks 'scenario'. Add scenario = '...': a scenario file beside this file, or the name of a shipped scenario."
        )
    named = content.pop("scenario")
    if not isinstance(named, str):
        raise (root / "scenario").error(
            f"is {named!r}. It must be a file or the name of a shipped scenario, in quotes."
        )
    scenario = _scenario_file(file, named)
    loop = ScenarioLoop(str(scenario.absolute()), with_numbers(read_toml(scenario), scenario))
    design = _design(content, root)
    metrics = _metrics(content.pop("metrics", []), root / "metrics")
    runs: Runs = build(Runs, content, root)
    simulation = scenario_of(loop.content, Path(loop.path)).simulation
    settings = {name: getattr(runs, name) for name in _names(Runs) if name != "duration"}
    try:
        with root.named():
            campaign = Campaign(
                loop, duration=_duration(runs.duration, simulation.duration), grid=design, metrics=metrics, **settings
            )
        _check_values(loop, campaign.job.plan.points)
    except ScenarioError as error:
        raise ScenarioError(f"{root}: {error}") from error
    return campaign


def _check_values(loop: ScenarioLoop, points: Sequence[Mapping[str, Any]]) -> None:
    """Check each factor's values, one at a time, before hundreds of runs fail because of one.

    A value that an FMU or a block rejects passes: its runs are recorded as failed.

    Raises
    ------
    ScenarioError
        If the scenario is not valid with one of the values.
    """
    for name in points[0]:
        values: list[Any] = []
        for point in points:
            if len(values) < MOST and not any(point[name] is value or point[name] == value for value in values):
                values.append(point[name])
        for value in values[1:]:  # the first is checked already
            try:
                loop(**{**points[0], name: value})
            except ScenarioError:
                raise
            except BayesFTCError:
                continue


def described(path: str | os.PathLike[str], campaign: Campaign) -> dict[str, Any]:
    """Return what a store keeps of a campaign file besides the common metadata: the scenario, and the texts of the files."""
    assert isinstance(campaign.job.loop, ScenarioLoop)
    return {"scenario": dict(campaign.job.loop.content), "files": _texts(path)}


def _texts(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the text of a campaign file, and of its scenario."""
    file = find_scenario(path, "campaign")
    scenario = _scenario_file(file, read_toml(file)["scenario"])
    return {key: file.read_text(encoding="utf-8-sig") for key, file in (("campaign", file), ("scenario", scenario))}


def _scenario_file(file: Path, named: str) -> Path:
    given = expanded(named)
    beside = file.absolute().parent / given
    of_a_file = given.suffix == ".toml" or given.parent != Path()
    if is_file(beside) or (of_a_file and not is_file(given)):
        return find_scenario(beside)  # which names the files that are there
    return find_scenario(named)


def _duration(given: float | str | None, otherwise: float | str) -> float | str | Fraction:
    return otherwise if given is None else given


def _names(cls: Any) -> list[str]:
    return list(cls.__dataclass_fields__)


def _design(content: dict[str, Any], root: Place) -> Design | None:
    """Remove the designs from a file's content and return their product."""
    designs: list[Design] = []
    if "points" in content:
        points = content.pop("points")
        with (root / "points").named():
            designs.append(Points(points))
    samples = content.pop("samples", [])
    for i, table in enumerate([samples] if isinstance(samples, Mapping) else samples):
        place = root / "samples" / i
        cls, rest = choose(SAMPLES, table, place)
        ranges = as_table(rest.pop("ranges", None), place / "ranges")
        designs.append(
            build(cls, rest, place, given={"ranges": {n: _range(r) for n, r in ranges.items()}}, of_kind=True)
        )
    if "factors" in content:
        place = root / "factors"
        factors = as_table(content.pop("factors"), place)
        with place.named():
            designs.append(Grid({name: _values(values, place / name) for name, values in factors.items()}))
    return reduce(lambda one, other: one * other, designs) if designs else None


def _range(given: Any) -> Any:
    """Return a range: whole numbers with both ends included, if both ends are whole."""
    if isinstance(given, list) and len(given) == 2 and all(type(end) is int for end in given):
        return range(given[0], given[1] + 1)
    return tuple(given) if isinstance(given, list) else given


def _values(given: Any, place: Place) -> Any:
    """Return the values of a factor. A table has labels, and so does a list of tables with a ``label`` or ``kind``."""
    if isinstance(given, Mapping):
        return dict(given)
    if not isinstance(given, list):
        raise place.error(f"is {given!r}. It must be a list of values, or a table with a value for each label.")
    if any(isinstance(value, Mapping | list) for value in given):
        return {_label(value, i): _without_label(value) for i, value in enumerate(given)}
    return given


def _label(value: Any, i: int) -> Any:
    if not isinstance(value, Mapping):
        return str(value) if isinstance(value, list) else value
    return value.get("label") or value.get("kind") or f"value {i}"


def _without_label(value: Any) -> Any:
    return {name: item for name, item in value.items() if name != "label"} if isinstance(value, Mapping) else value


def _metrics(given: Any, place: Place) -> list[Metric]:
    if not isinstance(given, list):
        raise place.error(f"is {given!r}. It must be a list of tables, such as [[metrics]] with kind = 'RMSE'.")
    return [
        build_one_of(METRICS, {"kind": table} if isinstance(table, str) else table, place / i)
        for i, table in enumerate(given)
    ]


def _depth(path: str) -> int:
    return path.count(".") + path.count("[")
