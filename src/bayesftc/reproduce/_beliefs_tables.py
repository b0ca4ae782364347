"""What ``bayesftc reproduce beliefs`` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce._beliefs import SETTINGS
from bayesftc.reproduce._tables import interval_widths, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

SHORT = {"injection": "inj."}
"""What heads columns that are narrow."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each form the errors over the oracle's, with fine and coarse sensors, the worst of them, and the detection."""
    settings = report["settings"]
    factor = settings["factor"]
    meant = "; ".join(f"{name}: {', '.join(of)}" for name, of in SETTINGS.items())
    yield (
        f"Each row has settings of all modes that are {factor:g} times as large (x {factor:g}) or as small (/ {factor:g}) as in "
        f"the first ({meant})."
    )
    title = f"error over that of the oracle, which ignores the faulty sensor ({settings['runs']} runs a cell)"
    for form, rows in report["errors"].items():
        yield _errors(f"{form}: {title}", rows)
        coarse = report["coarse"]["errors"][form]
        yield _errors(f"{form}, sensors with a resolution of {settings['resolution']:g} m/s: {title}", coarse)
        yield interval_widths(
            [(row, c, of) for cells in (rows, coarse) for row in cells for c, of in cells[row].items()]
        )
        yield _worst(form, report["worst"][form])
    for form, rows in report["detection"].items():
        yield from _streams(form, settings["streams"], rows)


def _errors(title: str, rows: Mapping[str, Any]) -> RenderableType:
    heads = ["\n".join(SHORT.get(word, word) for word in cell.split()) for cell in next(iter(rows.values()))]
    shown = {row: [f"{of['ratio']:.3f}" for of in cells.values()] for row, cells in rows.items()}
    return table(title, heads, shown, corner="settings")


def _worst(form: str, worst: Mapping[str, Any]) -> str:
    low, high = worst["over_unchanged_ci"]
    return (
        f"{form}: in no cell has a row more than {worst['over_unchanged']:.3f} times the error of the first (95 %: {low:.3f} to "
        f"{high:.3f}); the largest is that of {worst['row']}, {worst['cell']}, {worst['ratio']:.3f} times the oracle's."
    )


def _streams(form: str, streams: int, rows: Mapping[str, Any]) -> Iterator[RenderableType]:
    measures = {"AUC": "auc", "ECE": "ece"}
    heads = product(next(iter(rows.values())), measures)
    yield table(
        f"{form}, streams of the detection experiment, whose mean times the first row knows: AUC and expected calibration error "
        f"(ECE), mean over {streams} streams",
        ["\n".join([name, *size.split(", ")]) for size, name in heads],
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
