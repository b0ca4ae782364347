"""The tables of a report, as plain data: a heading and rows of texts."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.report.contents import Contents

ROWS = 60
"""Of a table; the store has all."""
WORST = 5


@dataclass(frozen=True)
class Table:
    """A heading, the names of the columns, rows of texts, and what is to be said below."""

    title: str
    columns: list[str]
    rows: list[list[str]]
    note: str = ""


def settings(contents: Contents) -> Table:
    """Return what the campaign was: what is common to all runs."""
    said, metadata = contents.description, contents.store.metadata
    versions = metadata.environment.get("versions", {})
    blocks = said.get("blocks", {})
    rows = [
        ["duration of a run", str(said.get("duration", ""))],
        ["base step", str(said.get("step", ""))],
        ["points", str(len(contents.store.plan.points))],
        ["runs", f"{len(contents.table)} of {contents.store.plan.runs}"],
        ["failed", str(int((contents.table["status"] == "failed").sum()))],
        ["computing time", f"{contents.store.seconds:.4g} s"],
        *([f"block {name}", text] for name, text in blocks.items()),
        *([f"FMU {name}", f"SHA-256 {digest}"] for digest, name in metadata.fmus.items()),
        ["versions", ", ".join(f"{name} {version}" for name, version in versions.items())],
    ]
    return Table("Settings", ["", ""], [row for row in rows if row[1]])


def design(contents: Contents) -> Table:
    """Return the factors and their values."""
    rows = []
    for name in contents.factors:
        values = list(contents.table[name].drop_duplicates())
        shown = ", ".join(map(text_of, values[:8]))
        rows.append([name, str(len(values)), shown + (f", … {text_of(values[-1])}" if len(values) > 8 else "")])
    return Table("Factors", ["factor", "values", "which"], rows)


def means(contents: Contents) -> Table | None:
    """Return the mean of each metric in each cell of the grid."""
    from bayesftc.cosim.statistics import summary

    metrics = [m for m in contents.metrics if contents.table[m].notna().any()][:6]
    if not metrics:
        return None
    few = [name for name in contents.varied if contents.table[name].nunique() <= 15]
    own_factor = [contents.compared] if contents.compared else []
    by = [*[name for name in few if name != contents.compared][: 4 - len(own_factor)], *own_factor]
    cells = summary(contents.table, metrics, by=by)
    keys = list(cells[by].drop_duplicates().itertuples(index=False, name=None)) if by else [()]
    place = {(tuple(row[name] for name in by), row["metric"]): row for row in cells.to_dict("records")}
    rows = []
    for key in keys[:ROWS]:
        own = [place.get((tuple(key), metric)) for metric in metrics]
        runs = next((row["n"] + row["left_out"] for row in own if row), 0)
        rows.append([*map(text_of, key), str(runs), *map(interval_text, own)])
    note = "Mean ± half of the 95 % confidence interval (Student's t)."
    note += f" {len(keys) - ROWS} further rows are in the store." if len(keys) > ROWS else ""
    return Table("Results", [*by, "runs", *metrics], rows, note)


def comparison(contents: Contents) -> Table | None:
    """Return the differences between the levels of the compared factor, in each cell of the others."""
    from bayesftc.cosim.statistics import compare

    if contents.compared is None or contents.metric is None:
        return None
    by, how = contents.others, "paired t-tests, run by run with the same noise"
    try:
        found = compare(contents.table, contents.metric, contents.compared, by=by or None, correction="holm")
    except ModelError:
        try:
            by = [n for n in by if contents.table[n].nunique() <= 15]
            found = compare(
                contents.table, contents.metric, contents.compared, by=by or None, paired=False, correction="holm"
            )
            how = "Welch's t-tests"
        except ModelError:
            return None
    rows = [
        [
            *(text_of(row[name]) for name in by),
            f"{row['first']} − {row['second']}",
            interval_text({"mean": row["difference"], "high": row["high"]}),
            f"{row['effect']:.3g}",
            p_text(row["p_corrected"]),
        ]
        for row in found.to_dict("records")
    ]
    note = f"By {how}; p corrected for {len(found)} tests by Holm. Effect: Cohen's d."
    note += f" {len(rows) - ROWS} further rows are left out." if len(rows) > ROWS else ""
    columns = [*by, contents.compared, f"difference of {contents.metric}", "effect", "p"]
    return Table("Comparison", columns, rows[:ROWS], note)


def worst(contents: Contents) -> Table | None:
    """Return the runs with the largest metric, each with the command that makes it again."""
    if contents.metric is None:
        return None
    ordered = contents.table.sort_values(contents.metric, ascending=False, na_position="last", kind="stable")
    rows = [
        [
            str(row["run"]),
            *(text_of(row[name]) for name in contents.varied),
            text_of(row[contents.metric]),
            command(contents, row["run"]),
        ]
        for row in ordered.head(WORST).to_dict("records")
        if row[contents.metric] == row[contents.metric]
    ]
    title = f"The {len(rows)} runs with the largest {contents.metric}"
    return Table(title, ["run", *contents.varied, contents.metric, "once more"], rows) if rows else None


def failures(contents: Contents) -> Table | None:
    """Return why runs have failed, how many of each reason, and the command that repeats the first."""
    failed = contents.table[contents.table["status"] == "failed"]
    if not len(failed):
        return None
    rows = []
    for reason, runs in failed.groupby("reason", sort=False):
        rows.append([str(len(runs)), str(reason), command(contents, runs["run"].iloc[0])])
    rows.sort(key=lambda row: -int(row[0]))
    note = f"{len(rows) - 10} further reasons are in the store." if len(rows) > 10 else ""
    return Table(f"{len(failed)} runs have failed", ["runs", "reason", "the first of them once more"], rows[:10], note)


def command(contents: Contents, run: Any) -> str:
    """Return the command that makes a run again."""
    return f"bayesftc replay {shlex.quote(str(contents.store.path))} {int(run)}"


def text_of(value: Any) -> str:
    """Return a value as it stands in a table."""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def interval_text(row: Mapping[Any, Any] | None) -> str:
    """Return a mean and half of its interval."""
    if row is None or row["mean"] != row["mean"]:
        return "–"
    half = row["high"] - row["mean"]
    return f"{row['mean']:.4g}" + (f" ± {half:.2g}" if half == half else "")


def p_text(p: float) -> str:
    """Return a probability as it stands in a table."""
    return "–" if p != p else "< 0.001" if p < 0.001 else f"{p:.3f}"


__all__ = ["Table", "comparison", "design", "failures", "means", "settings", "worst"]
