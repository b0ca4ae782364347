"""What ``bayesftc reproduce models`` prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.models.car import RIGHT, UNKNOWN_LIMIT
from bayesftc.reproduce.experiments.models.run import FIXED
from bayesftc.reproduce.experiments.tracking.bench import HEALTHY
from bayesftc.reproduce.shared.drawing import MOST
from bayesftc.reproduce.shared.tables import interval_widths, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

COLUMNS = 4
"""Techniques beside each other: class names are long."""

Cells = Mapping[str, Mapping[str, Any]]
"""By condition and technique."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each of the controller's models the errors and false alarms, and what is above the bar."""
    settings, errors = report["settings"], report["errors"]
    yield "Conditions: " + "; ".join(f"{name}: {text}" for name, text in settings["conditions"].items()) + "."
    yield _absolute(report)
    for model, cells in errors.items():
        names = [name for name in next(iter(cells.values())) if name != FIXED]
        title = f"Controller's model {model}, healthy sensors"
        yield from _tables(
            f"{title}: tracking error over fixed precision's",
            cells,
            names,
            lambda cell: _digits(cell[HEALTHY]["ratio"]),
        )
        yield interval_widths([(n, c, cells[c][n][HEALTHY]) for c in cells for n in names])
        yield _above(report["above_the_bar"][model], settings["bar"])
        judged = [n for n in names if cells[RIGHT][n][HEALTHY]["alarms"]]
        hours = cells[RIGHT][judged[0]][HEALTHY]["alarms"]["fault_free_hours"]
        yield from _tables(
            f"{title}: false alarms per hour of one sensor (in {hours:.2g} h)",
            cells,
            judged,
            lambda cell: f"{cell[HEALTHY]['alarms']['false_alarms_per_hour']:.0f}",
        )
        yield from _tables(
            f"{title}: share of time in false alarm",
            cells,
            judged,
            lambda cell: f"{cell[HEALTHY]['alarms']['false_share']:.1%}",
        )
        yield from _tables(
            f"{title}: share of time in which the actuator is blamed",
            cells,
            [n for n in names if cells[RIGHT][n][HEALTHY]["actuator_alarms"]],
            lambda cell: f"{cell[HEALTHY]['actuator_alarms']['false_share']:.1%}",
        )
        cases = list(next(iter(report["oracle"][model].values())))
        yield from _tables(
            f"Controller's model {model}, one sensor failed: tracking error over the oracle's, the worst of "
            f"{sentence_list([f'{case} ({case[0]})' for case in cases])}",
            cells,
            [FIXED, *names],
            lambda cell, cases=cases: _worst(cell, cases),  # type: ignore[misc]
        )
        yield interval_widths([(n, f"{case}, {c}", cells[c][n][case]) for c in cells for n in names for case in cases])

    if report["grid"]:
        yield from _of_the_grid(report)


def _of_the_grid(report: dict[str, Any]) -> Iterator[RenderableType]:
    settings = report["settings"]
    models = {settings["unmodelled_time"]: report["errors"]["with disturbance"]}
    models |= {
        float(time): {c: {n: {HEALTHY: e} for n, e in of.items()} for c, of in cells.items()}
        for time, cells in report["grid"].items()
    }
    force, step = settings["unmodelled_force"], settings["car"]["step"]
    worst = {
        f"{force * (step / time) ** 0.5:.0f} N": {
            name: {
                HEALTHY: max((cells[c][name][HEALTHY] for c in cells if c != UNKNOWN_LIMIT), key=lambda e: e["ratio"])
            }
            for name in cells[RIGHT]
        }
        for time, cells in sorted(models.items())
    }
    yield from _tables(
        "Healthy sensors, the random walk of the disturbance in N a step: largest error over fixed precision's in all "
        f"conditions but {UNKNOWN_LIMIT}",
        worst,
        [name for name in next(iter(worst.values())) if name != FIXED],
        lambda cell: _digits(cell[HEALTHY]["ratio"]),
        corner="walk",
    )


def _absolute(report: dict[str, Any]) -> RenderableType:
    errors, oracle = report["errors"], report["oracle"]
    rows = {
        c: [
            *(f"{errors[m][c][FIXED][HEALTHY]['rmse_mean']:.2f}" for m in errors),
            *(f"{max(oracle[m][c].values()):.2f}" for m in errors),
        ]
        for c in report["settings"]["conditions"]
    }
    heads = [f"{who}\n{model.replace(' ', chr(10), 1)}" for who in ("fixed precision", "oracle") for model in errors]
    return table(
        "Root-mean-square tracking error (m/s), by the controller's model: of fixed precision with healthy sensors, and of the "
        "oracle, which ignores the failed sensor (the largest of the faults)",
        heads,
        rows,
        corner="condition",
    )


def _tables(
    title: str, cells: Cells, names: list[str], text: Callable[[Any], str], corner: str = "condition"
) -> Iterator[RenderableType]:
    for first in range(0, len(names), COLUMNS):
        few = names[first : first + COLUMNS]
        rows = {condition: [text(of[name]) for name in few] for condition, of in cells.items()}
        yield table(title, few, rows, corner=corner)


def _worst(cell: Mapping[str, Any], cases: list[str]) -> str:
    case = max(cases, key=lambda case: cell[case]["ratio"])
    return f"{_digits(cell[case]['ratio'])} {case[0]}"


def _digits(x: float) -> str:
    return f"{x:.2f}" if x < 9.995 else f"{x:.1f}" if x < 99.95 else f"{x:.0f}" if x < MOST else f"> {MOST:g}"


def _above(worse: Mapping[str, list[str]], bar: float) -> str:
    if not worse:
        return f"No technique has more than {bar:g} times the error of fixed precision."
    found = [f"{name} ({', '.join(conditions)})" for name, conditions in worse.items()]
    return f"More than {bar:g} times the error of fixed precision: {sentence_list(found)}."
