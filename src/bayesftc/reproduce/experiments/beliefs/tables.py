"""The printed output of ``bayesftc reproduce beliefs``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.beliefs.run import SETTINGS
from bayesftc.reproduce.shared.tables import crossed, interval_widths, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

SHORT = {"injection": "inj.", "healthy": "no fault"}
"""Short words for the heads of narrow columns."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each form the errors relative to the oracle (fine and coarse), the worst, the detection, the learned modes."""
    settings = report["settings"]
    factor = settings["factor"]
    meant = "; ".join(f"{name}: {', '.join(of)}" for name, of in SETTINGS.items())
    yield (
        f"In each row some settings of all modes are multiplied (x {factor:g}) or divided (/ {factor:g}) by {factor:g}, compared "
        f"with the first row ({meant})."
    )
    title = f"error over that of the oracle, which ignores the faulty sensor ({settings['runs']} runs a cell)"
    for form, rows in report["errors"].items():
        yield from _errors(f"{form}: {title}", rows)
        coarse = report["coarse"]["errors"][form]
        yield from _errors(f"{form}, sensors with a resolution of {settings['resolution']:g} m/s: {title}", coarse)
        both = [(row, c, of) for cells in (rows, coarse) for row in cells for c, of in cells[row].items()]
        yield interval_widths(both)
        yield _worst(form, report["worst"][form])
    judged = f"mean over {settings['streams']} streams"
    for form, rows in report["detection"].items():
        known = "with their mean times in the first row: AUC and expected calibration error (ECE)"
        title = f"{form}, streams of the detection experiment, {known}, {judged}"
        yield from _streams(title, {"AUC": "auc", "ECE": "ece"}, rows)
    for form, learned in report["learned"].items():
        source = f"learned from other streams ({settings['training_streams']}) without labels"
        title = f"{form}, {source}: AUC, expected calibration error (ECE) and Brier score, {judged}"
        yield from _streams(title, {"AUC": "auc", "ECE": "ece", "Brier": "brier"}, learned["scores"])
        yield _fits(form, learned["fits"])


def _errors(title: str, rows: Mapping[str, Any]) -> Iterator[RenderableType]:
    return crossed(title, rows, "{ratio:.3f}", head=lambda cell: "\n".join(_short(cell).split()), corner="settings")


def _worst(form: str, worst: Mapping[str, Any]) -> str:
    low, high = worst["over_unchanged_ci"]
    return (
        f"{form}: the largest error, relative to the first row, is {worst['over_unchanged']:.3f} (95 %: {low:.3f} to "
        f"{high:.3f}), for {worst['row']}, {worst['cell']}; this is {worst['ratio']:.3f} times the oracle's."
    )


def _streams(title: str, measures: Mapping[str, str], rows: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Yield the means of measures for each row and size of the faults, and their intervals."""
    heads = product(next(iter(rows.values())), measures)
    yield table(
        title,
        ["\n".join([name, *_short(size).split(", ")]) for size, name in heads],
        {
            row: [f"{of[m]['mean']:.3f}" for of in cells.values() for m in measures.values()]
            for row, cells in rows.items()
        },
        corner="settings",
    )
    entries = [of for cells in rows.values() for of in cells.values()]
    widest = {name: max((of[m]["ci"][1] - of[m]["ci"][0]) / 2 for of in entries) for name, m in measures.items()}
    yield (
        "The 95 % intervals are "
        + sentence_list([f"+-{half:.3f} ({name})" for name, half in widest.items()])
        + " at most."
    )


def _fits(form: str, fits: Mapping[str, Any]) -> RenderableType:
    """Return a table of the progress of each learning; the learned modes are in the JSON file."""
    rows = {}
    for size, fit in fits.items():
        found = fit["log_likelihood"]
        fall = max((before - after for before, after in pairwise(found)), default=0.0)
        steps = [str(len(found)), "yes" if fit["settled"] else "no", f"{found[0]:.0f}"]
        rows[_short(size)] = [*steps, f"{found[-1] - found[0]:.0f}", f"{max(fall, 0.0):.0f}"]
    heads = ["itera-\ntions", "settled", "log-likelihood\nat first (nats)", "rises by", "falls in an\niteration by"]
    return table(f"{form}: learning", heads, rows, corner="faults")


def _short(name: str) -> str:
    return " ".join(SHORT.get(word, word) for word in name.split())
