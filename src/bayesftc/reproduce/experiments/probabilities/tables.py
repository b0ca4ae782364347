"""The printed output of ``bayesftc reproduce probabilities``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.probabilities.exact_cases import APART, JOINT
from bayesftc.reproduce.shared.tables import Form, crossed, listed, sentence_list, table, written

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_KINDS = 3
"""Number of kinds that are named for a bin."""


def _difference(form: str) -> Form:
    return lambda of: written(of[form], "{largest:.3f} ({rms:.4f})") if form in of else ""


def _of_largest(form: str) -> Form:
    return lambda of: "" if of["largest"]["bin"] is None else written(of, form)


SUMMARY: list[tuple[str, Form]] = [
    ("largest\ndistance", _of_largest("{largest[distance]:.3f}")),
    ("95 %", _of_largest("{largest[ci][0]:.2f} to {largest[ci][1]:.2f}")),
    ("in bin", "{place}"),
    ("calibration\nerror", "{ece:.4f}"),
    ("Brier\nscore", "{brier:.4f}"),
]
EXACT: list[tuple[str, Form]] = [
    *((f"{form}:\nlargest (RMS)", _difference(form)) for form in (JOINT, APART)),
    ("exact\n.05 to .95", "{between:.0%}"),
]


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each range of lengths the reliability of all learners and the causes of gaps; then the exact probabilities."""
    settings = report["settings"]
    for title, learners in report["reliability"].items():
        faults = f"{settings['runs']} runs with random faults of {title}"
        bins = f"largest distance from the diagonal of a bin with {settings['enough']} samples"
        summary = {name: {**of, "place": _bin(settings, of["largest"]["bin"])} for name, of in learners.items()}
        yield listed(f"{faults}: {bins}", summary, SUMMARY, corner="learner")
        rows = {
            _bin(settings, b): {name: {**settings, **of["bins"][b]} for name, of in learners.items()}
            for b in range(settings["bins"])
        }
        few = f"in brackets: of fewer than {settings['enough']}"
        yield from crossed(f"{faults}: share of faulty samples ({few})", rows, _observed, corner="probability")
        for name, of in learners.items():
            yield _causes(settings, name, of)
    for pace in next(iter(report["exact"].values())):
        cells = {name: of[pace] for name, of in report["exact"].items()}
        shape = (
            f"{settings['samples']} samples of two sensors, one mode, {settings['sequences']} sequences of each size"
        )
        yield listed(f"{pace}: difference from the exact fault probability ({shape})", cells, EXACT, corner="mode")
        each = {
            n: [f"{size}: {at['largest']:.2f}" for size, at in of[JOINT]["by_size"].items()] for n, of in cells.items()
        }
        widest = max(map(len, each.values()))
        filled = {name: [*sizes, *[""] * (widest - len(sizes))] for name, sizes in each.items()}
        title = f"{pace}, {JOINT}: largest difference by the fault's size (0: no fault)"
        yield table(title, [""] * widest, filled, corner="mode")


def _bin(settings: Mapping[str, Any], number: int | None) -> str:
    if number is None:
        return ""
    width = 1 / settings["bins"]
    return f"{number * width:.1f}-{(number + 1) * width:.1f}"


def _observed(of: Mapping[str, Any]) -> str:
    if of["observed"] is None:
        return ""
    return f"{of['observed']:.2f}" if of["samples"] >= of["enough"] else f"({of['observed']:.2f})"


def _causes(settings: Mapping[str, Any], name: str, of: Mapping[str, Any]) -> str:
    """Return a sentence on the bins in which a learner is beyond the bar, and the kinds of faults with the largest parts."""
    beyond = [
        (b, each)
        for b, each in enumerate(of["bins"])
        if each["samples"] >= settings["enough"] and abs(each["gap"]) > settings["bar"]
    ]
    if not beyond:
        return f"{name}: within {settings['bar']:g} in every bin with {settings['enough']} samples."
    words = []
    for b, each in beyond:
        kinds = sorted(each["by_kind"].items(), key=lambda item: -abs(item[1]))[:MOST_KINDS]
        words.append(
            f"{_bin(settings, b)} by {each['gap']:+.2f} (" + ", ".join(f"{k} {part:+.2f}" for k, part in kinds) + ")"
        )
    return (
        f"{name}: beyond {settings['bar']:g} in {sentence_list(words)}; in brackets the kinds with the largest parts."
    )
