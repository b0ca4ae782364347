"""The page: the report's content in the template, with the results first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.store.reading import StoredCampaign
from bayesftc.report import comparisons, tables
from bayesftc.report.bands import error_bands
from bayesftc.report.contents import Contents
from bayesftc.report.detection import alarm_table, reliability_figure, roc_figure, why_no_detection
from bayesftc.report.grids import over_grid
from bayesftc.report.scores import read_detection
from bayesftc.report.svg import to_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawn = tuple["Figure", str] | None


@dataclass(frozen=True)
class Part:
    """A heading with a figure, a table, or both; and a table with details."""

    title: str
    svg: str = ""
    caption: str = ""
    table: tables.Table | None = None
    more: tables.Table | None = None


def report(
    store: StoredCampaign, *, metric: str | None = None, compare: str | None = None, title: str | None = None
) -> str:
    """Return the report of a campaign as one self-contained page of HTML.

    Parameters
    ----------
    store : StoredCampaign
        The campaign.
    metric, compare : str, optional
        The main metric, and the factor whose levels are compared; see `Contents`.
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
        yield _part("Results", drawn, results)
    comparison, cells = comparisons.overall(contents), comparisons.in_cells(contents)
    if comparison:
        yield Part(comparison.title, table=comparison, more=cells)
    bands = error_bands(contents)
    if bands:
        yield _part("Over time", bands)
    detection = read_detection(contents)
    if detection:
        yield _part("Detection", roc_figure(contents, detection), alarm_table(contents, detection))
        reliability = reliability_figure(contents, detection)
        if reliability:
            yield _part("Reliability", reliability)
    elif why := why_no_detection(contents, detection):
        yield Part("Detection", caption=why)
    worst = tables.worst(contents)
    if worst:
        yield Part(worst.title, table=worst)


def _part(title: str, drawn: Drawn, table: tables.Table | None = None) -> Part:
    if drawn is None:
        return Part(title, table=table)
    picture, caption = drawn
    return Part(title, to_svg(picture, f"{title}: {caption}"), caption, table)


def _lead(contents: Contents) -> str:
    runs, points = len(contents.table), contents.table["point"].nunique()
    whole = (
        "" if runs == contents.store.plan.runs else f" of {contents.store.plan.runs} (the campaign is not complete yet)"
    )
    varied = f"; varied: {', '.join(contents.varied)}" if contents.varied else ""
    failed = f"; {contents.failed} failed" if contents.failed else ""
    return f"{_count(runs, 'run')}{whole} at {_count(points, 'point')}{failed}{varied}."


def _findings(contents: Contents) -> list[str]:
    """Return the findings in a sentence or two."""
    if contents.metric is None and contents.candidates:
        return [f"No run has a value of {', '.join(contents.candidates)}."]
    return comparisons.sentences(contents)


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"
