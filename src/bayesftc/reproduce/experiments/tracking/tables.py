"""The printed output of ``bayesftc reproduce tracking``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection import filterpy as _filterpy
from bayesftc.reproduce.shared.residuals import SWITCHING
from bayesftc.reproduce.shared.tables import crossed, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType


COLUMNS, FEW_DIGITS = 3, 5
"""Techniques in one table: class names are long."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the merit table beside the paper's, the errors, the losses of precision learning, and the speed."""
    settings, scenarios, oracle = report["settings"], report["scenarios"], report["oracle"]
    yield _merit(report)
    yield from _orders(report)
    names = list(next(iter(scenarios.values())))
    papers, extra = [n for n in names if n in report["merit"]], [n for n in names if n not in report["merit"]]
    cells = {kind: {**scenarios[kind], "oracle": oracle[kind]} for kind in scenarios}
    title = f"Root-mean-square tracking error (m/s), mean over {settings['runs']} runs"
    form, corner = "{rmse_mean:.3f}", "fault/reference"
    with_oracle = f"{title}; the oracle ignores the faulty sensor"
    yield from crossed(with_oracle, cells, form, [*papers, "oracle"], corner=corner)
    yield _filterpy.show_tracking(report["filterpy"])
    others = f"{title}: techniques that are not in the paper's table"
    yield from crossed(others, cells, form, extra, corner=corner, most=COLUMNS)
    if extra:
        merit = report["total_merit_of_all"]
        ahead = [name for name in merit if merit[name] > merit["PL"]]
        yield (
            f"With {sentence_list(extra)} in the comparison as well, total merits are "
            f"{sentence_list([f'{n} {merit[n]}' for n in sorted(merit, key=merit.__getitem__, reverse=True)])}. "
            + (f"{sentence_list(ahead)} {'is' if len(ahead) == 1 else 'are'} ahead of PL." if ahead else "PL leads.")
        )
    yield from _against_the_papers(report)
    yield from _where_it_loses(report)
    if report["over_oracle"] is not None:
        yield from show_oracle(report["over_oracle"]["cells"])
    speed = report["speed"]
    yield (
        f"Speed: {speed['steps_per_second'] / 1e6:.2f} million closed-loop steps per second with {speed['jobs']} jobs "
        f"({speed['steps']:,} steps in {speed['seconds']:.2f} s), a loop with fmpy and filterpy "
        f"{speed['user_loop_steps_per_second'] / 1e6:.3f} million: {speed['ratio']:.0f} times as fast."
    )


def _merit(report: dict[str, Any]) -> RenderableType:
    ours, papers = report["merit"], report["paper"]["merit"]
    rows = {row: [f"{ours[row][column]:d} ({papers[row][column]:d})" for column in ours] for row in ours}
    totals = [f"{report['total_merit'][c]:d} ({report['paper']['total_merit'][c]:d})" for c in ours]
    title = (
        "Merit, in brackets the paper's: scenarios in which the column's technique tracks significantly better than the row's, "
        "minus those in which it tracks worse"
    )
    return table(title, list(ours), {**rows, "total merit": totals})


def _orders(report: dict[str, Any]) -> Iterator[str]:
    """Yield a sentence for each pair of techniques whose order differs from the paper's."""
    ours, papers = report["total_merit"], report["paper"]["total_merit"]
    for a, b in combinations(ours, 2):
        if (ours[a] - ours[b]) * (papers[a] - papers[b]) < 0:
            yield (
                f"{a} ({ours[a]}) and {b} ({ours[b]}) are in the reverse order of the paper's ({papers[a]} and {papers[b]})."
            )


def _against_the_papers(report: dict[str, Any]) -> Iterator[str]:
    """Yield the merit of the forms of `SwitchingPrecision` against the paper's other techniques."""
    rivals = [name for name in report["merit"] if name != "PL"]
    tests = len(rivals) * len(report["scenarios"])
    table = report["merit_of_all"]
    for name in (name for name in table if name.startswith(SWITCHING)):
        won = sum(table[rival][name] for rival in rivals)
        yield f"{name}: merit {won} of {tests} against {sentence_list(rivals)}."


def _where_it_loses(report: dict[str, Any]) -> Iterator[RenderableType]:
    papers, every = list(report["merit"]), len(report["scenarios"])
    lost = {kind: [n for n in names if n in papers] for kind, names in report["lost"].items()}
    places = [f"on {kind} than {sentence_list(names)}" for kind, names in lost.items() if names]
    yield (
        f"Precision learning (PL) tracks significantly worse {'; '.join(places)}."
        if places
        else "In no scenario does precision learning (PL) track significantly worse than another technique of the paper."
    )
    others = [name for names in report["lost"].values() for name in names if name not in papers]
    if counts := {name: others.count(name) for name in dict.fromkeys(others)}:
        shown = [f"{name} in {count}" for name, count in counts.items()]
        yield f"Other techniques are significantly better than PL in some of the {every} scenarios: {sentence_list(shown)}."
    if report["grid"] is None:
        return
    settings = report["settings"]
    tables = [t for t in report["grid"]["tables"] if t["effdi_duration"] == settings["effdi_duration"]]
    totals = {(t["injection"], t["drift"]): t["total_merit"] for t in tables}
    injections, drifts = (sorted({pair[i] for pair in totals}) for i in (0, 1))

    def leaders(merit: dict[str, int]) -> list[str]:
        return [name for name in merit if merit[name] > merit["PL"]]

    def cell(merit: dict[str, int]) -> str:
        return f"{merit['PL']} : {merit['SER FT']} {'*' if leaders(merit) else ' '}"

    title = "Faults of other sizes: total merit of PL : SER FT; injection in m/s, drift in m/s per second"
    rows = {f"{i:g}": {d: totals[i, d] for d in drifts} for i in injections}
    yield from crossed(title, rows, cell, head="drift {:g}  ", corner="injection")
    if ahead := dict.fromkeys(name for merit in totals.values() for name in leaders(merit)):
        yield f"* {sentence_list(list(ahead))} ahead of PL."
    every = report["grid"]["tables"]
    lost_to = [t for t in every if t["total_merit"]["PL"] < max(t["total_merit"].values())]
    if not lost_to:
        yield f"PL has the highest total merit in all {len(every)} tables of the grid."
        return
    smallest = min(lost_to, key=lambda t: (t["drift"], t["injection"]))
    yield (
        f"The order reverses for large faults: in {len(lost_to)} of the {len(every)} tables of the grid (with all durations of "
        f"EF-FDI) PL does not have the highest total merit. The smallest faults among these are an injection of "
        f"{smallest['injection']:g} m/s with a drift of {smallest['drift']:g} m/s per second. A threshold detects a large fault "
        "at once. Learning needs some samples to lower the precision of a sensor, and more to raise it again."
    )


def show_oracle(cells: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Yield the ratio of each technique for each fault; for techniques with a target, for each reference with a verdict."""
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
    yield from crossed(title, worst, _digits, others, corner="fault", most=FEW_DIGITS)
    for name in forms:
        bars = {f: cells[f"{f}/{references[0]}"]["bar"] for f in faults}
        yield table(
            f"{name}: error over the oracle's ± 95 %, {most:,} runs a cell",
            [*references, "target"],
            {f: [*(_with_interval(ratios[f, r][name]) for r in references), f"{bars[f]:g}"] for f in faults},
            corner="fault",
        )
        yield _verdict(name, cells)


def _verdict(name: str, cells: Mapping[str, Any]) -> str:
    over = {c: cell["ratio"][name] for c, cell in cells.items() if cell["ratio"][name]["ratio"] > cell["bar"]}
    if not over:
        return f"{name} meets the target in all {len(cells)} cells."
    missed = [f"{c} ({cell['ratio']:.4g} for {cells[c]['bar']:g})" for c, cell in over.items()]
    return f"{name} meets the target in {len(cells) - len(over)} of {len(cells)} cells and misses it on {sentence_list(missed)}."


def _with_interval(cell: Mapping[str, Any]) -> str:
    low, high = cell["ratio_ci"]
    return f"{cell['ratio']:.3f} ± {(high - low) / 2:.1g}"


def _digits(x: float) -> str:
    return f"{x:.2f}" if x < 9.995 else f"{x:.1f}"
