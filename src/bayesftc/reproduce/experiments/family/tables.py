"""The printed output of ``bayesftc reproduce family``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.family.groups import Figures, by_group
from bayesftc.reproduce.shared.tables import Form, crossed, interval_widths, table

if TYPE_CHECKING:
    from rich.console import RenderableType

MARK = "*"
"""The mark of a ratio above the bar."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the errors relative to the oracle, blame and delays of detecting learners, and each learner's worst case."""
    settings, cells = report["settings"], report["table"]
    learners = list(settings["learners"])
    title = f"root-mean-square error over that of the oracle, {settings['runs']} runs a case ({MARK}: above {settings['bar']:g})"
    yield from crossed(title, cells, lambda cell: _ratio(cell, settings["bar"]), learners, corner="case")
    kept = [(case, name, cell) for case, of in cells.items() for name, cell in of.items() if not cell["lost"]]
    if kept:
        yield interval_widths(kept)
    tell = [n for n in learners if any(of[n]["false_share"] is not None for of in cells.values())]
    if tell:
        title = "share of healthy sensors' time with an alarm, in percent"
        yield from crossed(title, cells, lambda cell: _percent(cell["false_share"]), tell, corner="case")
        title = "median time to an alarm in seconds, and share of faults without"
        yield from crossed(title, cells, _delay, tell, corner="case")
    groups = by_group(report)
    kinds: list[tuple[str, Form, list[str]]] = [
        ("geometric mean", _mean, learners),
        ("worst", _worst, learners),
        ("share of healthy sensors' time with an alarm in percent, mean", lambda of: _percent(of.false_share), tell),
    ]
    for what, form, names in kinds:
        yield from crossed(f"{what} of the cases of a group", groups, form, names, corner="group")
    rows = {}
    for name in learners:
        summary = report["summary"][name]
        worst, mean = ("lost" if n is None else f"{n:.2f}" for n in (summary["worst"]["ratio"], summary["mean"]))
        above, behind = (str(len(summary[which])) for which in ("above_the_bar", "behind_the_best"))
        rows[name] = [mean, worst, above, behind, summary["worst"]["case"]]
    above, behind = f"above {settings['bar']:g}", f"{settings['behind']:g} behind the best"
    heads = ["geometric mean", "worst", above, behind, "worst case"]
    yield table(f"of {len(cells)} cases", heads, rows, corner="learner")


def _ratio(cell: dict[str, Any], bar: float) -> str:
    if cell["lost"]:
        return f"lost {cell['lost']}{MARK}"
    return f"{shown_ratio(cell['ratio'])}{MARK if cell['ratio'] > bar else ' '}"


def _mean(figures: Figures) -> str:
    return "lost" if figures.lost else f"{figures.mean:.2f}"


def _worst(figures: Figures) -> str:
    return f"lost {figures.lost}" if figures.lost else shown_ratio(figures.worst)


def shown_ratio(ratio: float) -> str:
    """Return a ratio with two decimals, or none if it is large."""
    return f"{ratio:{'.2f' if ratio < 100.0 else '.0f'}}"


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.2f}"


def _delay(cell: dict[str, Any]) -> str:
    if cell["missed_share"] is None:
        return ""
    median = "-" if cell["delay"] is None else f"{cell['delay']:.2f}"
    return median + (f" ({cell['missed_share']:.0%})" if cell["missed_share"] else "")
