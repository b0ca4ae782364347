"""The printed output of ``bayesftc reproduce models``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.models.car import RIGHT, UNKNOWN_LIMIT
from bayesftc.reproduce.experiments.models.run import FIXED
from bayesftc.reproduce.experiments.tracking.bench import HEALTHY
from bayesftc.reproduce.shared.drawing import MOST
from bayesftc.reproduce.shared.tables import crossed, interval_widths, sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType

COLUMNS = 4
"""Techniques in one table: class names are long."""

ALARMS = (
    ("false alarms per hour of one sensor (in {:.2g} h)", "alarms", "{healthy[alarms][false_alarms_per_hour]:.0f}"),
    ("share of time in which a healthy sensor is blamed", "alarms", "{healthy[alarms][false_share]:.1%}"),
    ("share of time with an actuator alarm", "actuator_alarms", "{healthy[actuator_alarms][false_share]:.1%}"),
)
"""The tables of alarms with healthy sensors: title, key of the report, and form."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield for each of the controller's models the errors, the false alarms, and the cells above the bar."""
    settings, errors = report["settings"], report["errors"]
    yield "Conditions: " + "; ".join(f"{name}: {text}" for name, text in settings["conditions"].items()) + "."
    yield _absolute(report)
    for model, cells in errors.items():
        names = [name for name in next(iter(cells.values())) if name != FIXED]
        title = f"Controller's model {model}, healthy sensors"
        ratios = f"{title}: tracking error over fixed precision's"
        yield from crossed(ratios, cells, _ratio, names, corner="condition", most=COLUMNS)
        yield interval_widths([(n, c, cells[c][n][HEALTHY]) for c in cells for n in names])
        yield _above(report["above_the_bar"][model], settings["bar"])
        for what, kind, form in ALARMS:
            judged = [n for n in names if cells[RIGHT][n][HEALTHY][kind]]
            hours = cells[RIGHT][judged[0]][HEALTHY][kind]["fault_free_hours"] if judged else 0.0
            each = f"{title}: {what.format(hours)}"
            yield from crossed(each, cells, form, judged, corner="condition", most=COLUMNS)
        cases = list(next(iter(report["oracle"][model].values())))
        words = sentence_list([f"{case} ({case[0]})" for case in cases])
        failed = (
            f"Controller's model {model}, one sensor failed: tracking error over the oracle's, the worst of {words}"
        )
        worst = {c: {n: {case: of[n][case]["ratio"] for case in cases} for n in of} for c, of in cells.items()}
        yield from crossed(failed, worst, _worst, [FIXED, *names], corner="condition", most=COLUMNS)
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
    title = (
        "Healthy sensors, the random walk of the disturbance in N per step: largest error over fixed precision's in all "
        f"conditions but {UNKNOWN_LIMIT}"
    )
    names = [name for name in report["errors"]["with disturbance"][RIGHT] if name != FIXED]
    worst = {
        f"{force * (step / time) ** 0.5:.0f} N": {
            n: max(cells[c][n][HEALTHY]["ratio"] for c in cells if c != UNKNOWN_LIMIT) for n in names
        }
        for time, cells in sorted(models.items())
    }
    yield from crossed(title, worst, _digits, names, corner="walk", most=COLUMNS)


def _absolute(report: dict[str, Any]) -> RenderableType:
    errors, oracle = report["errors"], report["oracle"]
    rows = {}
    for c in report["settings"]["conditions"]:
        numbers = [errors[m][c][FIXED][HEALTHY]["rmse_mean"] for m in errors]
        rows[c] = [f"{x:.2f}" for x in (*numbers, *(max(oracle[m][c].values()) for m in errors))]
    heads = [f"{who}\n{model.replace(' ', chr(10), 1)}" for who in ("fixed precision", "oracle") for model in errors]
    title = (
        "Root-mean-square tracking error (m/s), by the controller's model: of fixed precision with healthy sensors, and of the "
        "oracle, which ignores the failed sensor (the largest of the faults)"
    )
    return table(title, heads, rows, corner="condition")


def _ratio(cell: Mapping[str, Any]) -> str:
    return _digits(cell[HEALTHY]["ratio"])


def _worst(ratios: Mapping[str, float]) -> str:
    case = max(ratios, key=ratios.__getitem__)
    return f"{_digits(ratios[case])} {case[0]}"


def _digits(x: float) -> str:
    return f"{x:.2f}" if x < 9.995 else f"{x:.1f}" if x < 99.95 else f"{x:.0f}" if x < MOST else f"> {MOST:g}"


def _above(worse: Mapping[str, list[str]], bar: float) -> str:
    if not worse:
        return f"No technique has more than {bar:g} times the error of fixed precision."
    found = [f"{name} ({', '.join(conditions)})" for name, conditions in worse.items()]
    return f"More than {bar:g} times the error of fixed precision: {sentence_list(found)}."
