"""The tables of a report, as plain data: a heading and rows of texts."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.numbers import with_half
from bayesftc.report.levels import estimate

if TYPE_CHECKING:
    from bayesftc.report.contents import Contents
    from bayesftc.report.pooling import Estimate

ROWS = 60
"""Largest number of rows of a table; the store has all."""
WORST, LEVELS, REASONS, METRICS, CELL = 5, 10, 10, 6, 15
"""Largest numbers of listed runs, of levels with a run of their own in that list, of listed reasons, of metrics with a column, of
values of a factor with rows."""
MOST_TEXT = 2000
"""Most characters of a block's settings."""
NUMBER = re.compile(r"[-−]?(\d[\d.]*(e[-+]?\d+)?|inf|nan)( ± .*| \(.*)?|–|< .*|(None|True|False)")


@dataclass(frozen=True)
class Table:
    """A heading, the names of the columns, rows of texts, and a note below."""

    title: str
    columns: list[str]
    rows: list[list[str]]
    note: str = ""

    @property
    def numeric(self) -> list[bool]:
        """Whether each column has numbers, which are aligned to the right; always false without headings."""
        named = any(self.columns)
        return [named and all(NUMBER.fullmatch(row[i]) for row in self.rows) for i in range(len(self.columns))]


def settings(contents: Contents) -> Table:
    """Return the settings that all runs have in common."""
    description, metadata = contents.description, contents.store.metadata
    versions = metadata.environment.get("versions", {})
    plan = contents.store.plan
    rows = [
        ["duration of a run", str(description.get("duration", ""))],
        ["base step", str(description.get("step", ""))],
        ["points", str(len(plan.points))],
        ["runs", f"{len(contents.table)} of {plan.runs}"],
        ["failed", str(contents.failed)],
        ["computing time", f"{contents.store.seconds:.4g} s, of all cores together"],
        ["recorded", ", ".join(metadata.signals)],
        *([f"block {name}", _shortened(text)] for name, text in description.get("blocks", {}).items()),
        *([f"FMU {name}", f"SHA-256 {digest}"] for digest, name in metadata.fmus.items()),
        ["versions", ", ".join(f"{name} {version}" for name, version in versions.items())],
    ]
    note = (
        "Blocks are shown with the settings of the first point."
        if description.get("blocks") and len(plan.points) > 1
        else ""
    )
    return Table("Settings", ["", ""], [row for row in rows if row[1]], note)


def _shortened(text: str) -> str:
    """Return the settings of a block without the middle of very long ones, such as a table of a thousand values."""
    half = MOST_TEXT // 2
    return (
        text if len(text) <= MOST_TEXT else f"{text[:half]} ... ({len(text) - 2 * half} characters) ... {text[-half:]}"
    )


def design(contents: Contents) -> Table | None:
    """Return the factors and their values."""
    rows = []
    for name in contents.factors:
        values = list(contents.table[name].drop_duplicates())
        shown = ", ".join(map(text_of, values[:8]))
        shown += f", … {text_of(values[-1])}" if len(values) > 8 else ""
        rows.append([contents.heading(name), str(len(values)), shown])
    return Table("Factors", ["factor", "number", "values"], rows) if rows else None


def means(contents: Contents) -> Table | None:
    """Return the mean of each metric in each cell of the grid."""
    table = contents.table
    metrics = [m for m in contents.metrics if table[m].notna().any()]
    if not metrics:
        return None
    few = [name for name in contents.others if contents.values(name) <= CELL]
    compared = [contents.compared] if contents.compared else []
    by = [*few[: 4 - len(compared)], *compared]
    cells = list(table.groupby(by, sort=False, dropna=False)) if by else [((), table)]
    shown, rows = metrics[:METRICS], []
    for key, runs in cells[:ROWS]:
        failed = [str(int((runs["status"] == "failed").sum()))] if contents.failed else []
        estimates = [estimate(contents, runs, metric) for metric in shown]
        texts = [mean_text(e, len(runs), contents.positive(m)) for e, m in zip(estimates, shown, strict=True)]
        rows.append([*map(text_of, key), str(len(runs)), *failed, *texts])
    pools = any(runs["point"].nunique() > 1 for _, runs in cells)
    note = "Mean ± half of its 95 % confidence interval (Student's t over seeds)."
    if any(" to " in text for row in rows for text in row[-len(shown) :]):
        note += (
            " In brackets: an interval that would reach below zero, and is cut there, because no value can be negative."
        )
    if pools:
        note += " A row has several points: its mean is over these; its interval covers other noise, not other points."
    if contents.failed or any(table[m].isna().any() for m in shown):
        note += " Runs without a value, such as failed runs, are left out; n is the number of the others."
    note += f" {len(cells) - ROWS} further rows are left out here." if len(cells) > ROWS else ""
    note += f" {len(metrics) - METRICS} further metrics are in the store." if len(metrics) > METRICS else ""
    counts = ["runs", *(["failed"] if contents.failed else [])]
    columns = [*map(contents.heading, by), *counts, *map(contents.heading, shown)]
    return Table("Results", columns, rows, note)


def worst(contents: Contents) -> Table | None:
    """Return the runs with the largest metric, and the worst one of each compared level, with the commands that repeat them."""
    if contents.metric is None:
        return None
    valued = contents.table.dropna(subset=contents.metric)
    ordered = valued.sort_values(contents.metric, ascending=False, kind="stable")
    chosen = ordered.index[:WORST]
    if contents.compared is not None:
        first = ordered.drop_duplicates(contents.compared).index[:LEVELS]
        chosen = ordered.index[ordered.index.isin(chosen.union(first))]
    rows = [
        [
            str(row["run"]),
            *(text_of(row[name]) for name in contents.varied),
            text_of(row[contents.metric]),
            command(contents, row["run"]),
        ]
        for row in ordered.loc[chosen].to_dict("records")
    ]
    title = (
        f"The {min(WORST, len(rows))} runs with the largest {contents.metric}"
        if len(rows) > 1
        else f"The run and its {contents.metric}"
    )
    if len(rows) > WORST:
        title += f", and the worst one of each {contents.compared}"
    note = "Failed runs have no value and are not listed." if contents.failed else ""
    columns = ["run", *map(contents.heading, (*contents.varied, contents.metric)), "repeat with"]
    return Table(title, columns, rows, note) if rows else None


def failures(contents: Contents) -> Table | None:
    """Return the reasons of failed runs, the number of runs of each, and the command that repeats the first."""
    failed = contents.table[contents.table["status"] == "failed"]
    if not len(failed):
        return None
    rows = [
        [str(len(runs)), str(runs["point"].nunique()), str(reason), command(contents, runs["run"].iloc[0])]
        for reason, runs in failed.groupby("reason", sort=False)
    ]
    rows.sort(key=lambda row: -int(row[0]))
    note = f"{len(rows) - REASONS} further reasons are in the store." if len(rows) > REASONS else ""
    title = f"{len(failed)} of {len(contents.table)} runs failed"
    return Table(title, ["runs", "at points", "reason", "repeat the first with"], rows[:REASONS], note)


def command(contents: Contents, run: Any) -> str:
    """Return the command that repeats a run."""
    return f"bayesftc replay {shlex.quote(str(contents.store.path))} {int(run)}"


def text_of(value: Any) -> str:
    """Return the text of a value in a table."""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def mean_text(mean: Estimate, runs: int | None = None, positive: bool = False) -> str:
    """Return a mean, half of its interval or both bounds, and its number of runs if this is not `runs`."""
    if not mean.runs:
        return "–"
    half = mean.half()
    text = with_half(mean.value, half)
    if positive and half > mean.value:
        text = f"{mean.value:.4g} ({{:.2g}} to {{:.2g}})".format(*mean.bounds(positive))
    return text if runs in {None, mean.runs} else f"{text} (n = {mean.runs})"


def p_text(p: float) -> str:
    """Return the text of a p-value in a table."""
    return "–" if p != p else "< 0.001" if p < 0.001 else f"{p:.3f}"
