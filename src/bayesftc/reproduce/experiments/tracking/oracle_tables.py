"""What ``bayesftc reproduce tracking`` prints of errors over the oracle's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.shared.tables import crossed, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

COLUMNS = 5
"""Techniques beside each other: class names are long."""


def show(cells: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Yield the ratio of each technique at each fault, those with an aim at each reference, and where that is missed."""
    ratios = {tuple(name.split("/")): cell["ratio"] for name, cell in cells.items()}
    faults, references = (list(dict.fromkeys(key[i] for key in ratios)) for i in (0, 1))
    every = next(iter(ratios.values()))
    most = max(cell["n"] for cell in every.values())
    forms = [name for name, cell in every.items() if cell["n"] == most]
    others = [name for name in every if name not in forms]
    title = (
        "Error over that of the oracle, which ignores the faulty sensor (root mean squares over all runs): the largest of all "
        "references; injections in m/s, drifts in m/s per second"
    )
    worst = {f: {n: max(ratios[f, r][n]["ratio"] for r in references) for n in others} for f in faults}
    yield from crossed(title, worst, _digits, others, corner="fault", most=COLUMNS)
    for name in forms:
        bars = {f: cells[f"{f}/{references[0]}"]["bar"] for f in faults}
        yield table(
            f"{name}: error over the oracle's ± 95 %, {most:,} runs a cell",
            [*references, "aim"],
            {f: [*(_with_interval(ratios[f, r][name]) for r in references), f"{bars[f]:g}"] for f in faults},
            corner="fault",
        )
        yield _verdict(name, cells)


def _verdict(name: str, cells: Mapping[str, Any]) -> str:
    over = {c: cell["ratio"][name] for c, cell in cells.items() if cell["ratio"][name]["ratio"] > cell["bar"]}
    if not over:
        return f"{name} meets the aim in all {len(cells)} cells."
    missed = [f"{c} ({cell['ratio']:.4g} for {cells[c]['bar']:g})" for c, cell in over.items()]
    return f"{name} meets the aim in {len(cells) - len(over)} of {len(cells)} cells, and misses it on {sentence_list(missed)}."


def _with_interval(cell: Mapping[str, Any]) -> str:
    low, high = cell["ratio_ci"]
    return f"{cell['ratio']:.3f} ± {(high - low) / 2:.1g}"


def _digits(x: float) -> str:
    return f"{x:.2f}" if x < 9.995 else f"{x:.1f}"
