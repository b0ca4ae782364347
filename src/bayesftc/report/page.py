"""The page: what a campaign can say is put into the template, in the order in which one asks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from bayesftc.cosim._campaign.extras import extra
from bayesftc.cosim._campaign.reading import StoredCampaign
from bayesftc.report import tables
from bayesftc.report.bands import error_bands
from bayesftc.report.contents import Contents
from bayesftc.report.detection import read_detection, reliability_figure, roc_figure
from bayesftc.report.grids import over_grid
from bayesftc.report.svg import to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawn = tuple["Figure", str] | None


@dataclass(frozen=True)
class Part:
    """A heading with a figure, a table, or both."""

    title: str
    svg: str = ""
    caption: str = ""
    table: tables.Table | None = None


def report(
    store: StoredCampaign, *, metric: str | None = None, compare: str | None = None, title: str | None = None
) -> str:
    """Return the report of a campaign as one page of HTML, which needs nothing else.

    Parameters
    ----------
    store : StoredCampaign
        The campaign.
    metric, compare : str, optional
        Which metric counts, and which factor's levels are compared; see `Contents`.
    title : str, optional
        The question of the campaign; by default the name of its folder.

    Raises
    ------
    StoreError
        If it has no run yet.
    UnknownNameError
        If there is no such metric or factor.
    ModelError
        If jinja2 is not installed.
    """
    jinja2 = extra("jinja2", "A report")
    contents = Contents(store, metric, compare)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=False)
    environment.tests["number_text"] = lambda text: bool(re.fullmatch(r"[-−]?[\d.]+(e[-+]?\d+)?( ± .*)?|–|< .*", text))
    template = environment.from_string(files("bayesftc.report").joinpath("page.html").read_text(encoding="utf-8"))
    page: str = template.render(
        title=title or store.path.resolve().name,
        lead=_lead(contents),
        findings=_findings(contents),
        parts=list(_parts(contents)),
        failures=tables.failures(contents),
        design=tables.design(contents),
        settings=tables.settings(contents),
        files=contents.description.get("files", {}),
    )
    return page


def _parts(contents: Contents) -> Iterator[Part]:
    results = tables.means(contents)
    drawn = over_grid(contents)
    if results or drawn:
        yield _part("Results", lambda: drawn, results)
    comparison = tables.comparison(contents)
    if comparison:
        yield Part(comparison.title, table=comparison)
    bands = error_bands(contents)
    if bands:
        yield _part("Over time", lambda: bands)
    detection = read_detection(contents)
    if detection and detection.runs:
        yield _part("Detection", lambda: roc_figure(detection))
        if detection.is_probability:
            yield _part("Reliability", lambda: reliability_figure(detection))
    worst = tables.worst(contents)
    if worst:
        yield Part(worst.title, table=worst)


def _part(title: str, draw: Callable[[], Drawn], table: tables.Table | None = None) -> Part:
    made = draw()
    if made is None:
        return Part(title, table=table)
    picture, caption = made
    return Part(title, to_svg(picture, f"{title}: {caption}"), caption, table)


def _lead(contents: Contents) -> str:
    factors = ", ".join(contents.varied) or "the seed alone"
    runs, points = len(contents.table), contents.table["point"].nunique()
    whole = "" if runs == contents.store.plan.runs else f" of {contents.store.plan.runs}: the campaign is not whole"
    return f"{runs} runs{whole} at {points} point{'s' if points != 1 else ''}; varied: {factors}."


def _findings(contents: Contents) -> list[str]:
    """Return what the numbers say, in a sentence or two."""
    from bayesftc.cosim.statistics import summary

    metric, factor = contents.metric, contents.compared
    if metric is None:
        return []
    if factor is None:
        (row,) = summary(contents.table, metric).to_dict("records")
        return [f"{metric} is {tables.interval_text(row)} on average over {row['n']} runs."]
    rows = summary(contents.table, metric, by=[factor]).sort_values("mean").to_dict("records")
    best, last = rows[0], rows[-1]
    ratio = f" ({last['mean'] / best['mean']:.3g} times as much)" if best["mean"] > 0 else ""
    return [
        f"Over all points {metric} is lowest with {factor} = {tables.text_of(best[factor])}: {best['mean']:.4g} on average; "
        f"with {tables.text_of(last[factor])} it is {last['mean']:.4g}{ratio}."
    ]


__all__ = ["report"]
