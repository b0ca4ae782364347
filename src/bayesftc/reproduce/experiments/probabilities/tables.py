"""What ``bayesftc reproduce probabilities`` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.probabilities.exact_cases import APART, JOINT
from bayesftc.reproduce.shared.tables import sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_KINDS = 3
"""Kinds that are named for a bin."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each range of lengths the reliability of all learners and what causes its gaps; then the exact probabilities."""
    settings = report["settings"]
    for title, learners in report["reliability"].items():
        faults = f"{settings['runs']} runs with random faults of {title}"
        heads = ["largest\ndistance", "95 %", "in bin", "calibration\nerror", "Brier\nscore"]
        rows = {name: _summary(settings, of) for name, of in learners.items()}
        bins = f"largest distance from the diagonal of a bin with {settings['enough']} samples"
        yield table(f"{faults}: {bins}", heads, rows, corner="learner")
        rows = {
            _bin(settings, b): [_observed(settings, of["bins"][b]) for of in learners.values()]
            for b in range(settings["bins"])
        }
        few = f"in brackets: of fewer than {settings['enough']}"
        yield table(f"{faults}: share of faulty samples ({few})", list(learners), rows, corner="said to be")
        for name, of in learners.items():
            yield _causes(settings, name, of)
    for pace in next(iter(report["exact"].values())):
        cells = {name: of[pace] for name, of in report["exact"].items()}
        shape = (
            f"{settings['samples']} samples of two sensors, one mode, {settings['sequences']} sequences of each size"
        )
        heads = [f"{form}:\nlargest (RMS)" for form in (JOINT, APART)] + ["exact\n.05 to .95"]
        rows = {
            name: [*(_difference(of.get(form)) for form in (JOINT, APART)), f"{of['between']:.0%}"]
            for name, of in cells.items()
        }
        yield table(f"{pace}: difference from the exact fault probability ({shape})", heads, rows, corner="mode")
        each = {name: of[JOINT]["by_size"] for name, of in cells.items()}
        widest = max(map(len, each.values()))
        rows = {
            name: [*(f"{size}: {of['largest']:.2f}" for size, of in sizes.items()), *[""] * (widest - len(sizes))]
            for name, sizes in each.items()
        }
        title = f"{pace}, {JOINT}: largest difference by the fault's size (0: no fault)"
        yield table(title, [""] * widest, rows, corner="mode")


def _summary(settings: Mapping[str, Any], of: Mapping[str, Any]) -> list[str]:
    worst = of["largest"]
    if worst["bin"] is None:
        return ["", "", "", f"{of['ece']:.4f}", f"{of['brier']:.4f}"]
    low, high = worst["ci"]
    return [
        f"{worst['distance']:.3f}",
        f"{low:.2f} to {high:.2f}",
        _bin(settings, worst["bin"]),
        f"{of['ece']:.4f}",
        f"{of['brier']:.4f}",
    ]


def _bin(settings: Mapping[str, Any], number: int) -> str:
    width = 1 / settings["bins"]
    return f"{number * width:.1f}-{(number + 1) * width:.1f}"


def _observed(settings: Mapping[str, Any], of: Mapping[str, Any]) -> str:
    if of["observed"] is None:
        return ""
    return f"{of['observed']:.2f}" if of["samples"] >= settings["enough"] else f"({of['observed']:.2f})"


def _causes(settings: Mapping[str, Any], name: str, of: Mapping[str, Any]) -> str:
    """Say in which bins a learner is beyond the bar, and which kinds of faults bring most of that."""
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
    return f"{name}: beyond {settings['bar']:g} in {sentence_list(words)}; in brackets the parts of the kinds that bring most."


def _difference(of: Mapping[str, Any] | None) -> str:
    return "" if of is None else f"{of['largest']:.3f} ({of['rms']:.4f})"
