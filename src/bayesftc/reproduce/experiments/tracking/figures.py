"""Figures of the tracking experiment, drawn from its report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLUE, SENSOR_COLOURS
from bayesftc.reproduce.shared.drawing import (
    FURTHER_STYLE,
    ORACLE_STYLE,
    SWITCHING_STYLES,
    colour_bar,
    figure,
    finish,
    heat_map,
    legend,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMOOTHED = 0.2
"""Seconds over which the error over time is averaged, so that lines are distinguishable."""
STYLES: dict[str, dict[str, Any]] = {
    "PL": {"color": BLUE, "lw": 2.8, "zorder": 5},
    "SER FT": {"color": SENSOR_COLOURS[0], "lw": 2.2, "zorder": 4},
    # The two lines coincide, so the upper one is dashed.
    "No FT": {"color": SENSOR_COLOURS[1], "lw": 1.8, "ls": (0, (4, 3)), "zorder": 4},
    "EF-FDI": {"color": SENSOR_COLOURS[4], "lw": 3.6, "zorder": 3},
    **SWITCHING_STYLES,
}
"""Styles of the techniques with separate entries in the legend."""


def error_over_time(report: dict[str, Any]) -> Figure:
    """Return the mean absolute error over time under an injection, with a sine as reference."""
    settings = report["settings"]
    made = figure(9.0, 4.4)
    axis = made.subplots()
    step = settings["car"]["step"]
    width = max(1, round(SMOOTHED / step))
    during = slice(round(settings["fault_start"] / step), round(settings["fault_stop"] / step))
    curves = {name: np.asarray(curve) for name, curve in report["mean_absolute_error"].items()}
    further = [name for name in curves if name not in STYLES and name != "oracle"]
    styles = {**STYLES, "oracle": {**ORACLE_STYLE, "zorder": 8}, **dict.fromkeys(further, FURTHER_STYLE)}
    for name, values in curves.items():
        smooth = np.convolve(values, np.full(width, 1 / width), mode="valid")
        time = step * (1 + np.arange(len(smooth)) + 0.5 * (width - 1))
        axis.plot(time, smooth, label=name, **styles[name])
    axis.axvspan(settings["fault_start"], settings["fault_stop"], color="#D55E00", alpha=0.12, lw=0, label="fault")
    title = f"Injection of {settings['injection']:g} m/s into one of two sensors, sine as reference, {settings['runs']} runs"
    words = {"xlabel": "time (s)", "ylabel": "mean absolute tracking error (m/s)"}
    finish(axis, title, yscale="log", xlim=(0, settings["duration"]), **words)
    _plain_logarithms(axis.yaxis)
    legend(
        axis,
        [*(name for name in STYLES if name in curves), "oracle", "fault"],
        "further techniques, from largest\nto least error in the fault:",
        sorted(further, key=lambda name: -curves[name][during].mean()),
    )
    return made


def errors(report: dict[str, Any]) -> Figure:
    """Return the heat map of every technique in every scenario."""
    scenarios, oracle = report["scenarios"], report["oracle"]
    names = list(next(iter(scenarios.values())))
    values = [[cells[n]["rmse_mean"] for cells in scenarios.values()] for n in names]
    values.append([cell["rmse_mean"] for cell in oracle.values()])
    columns = [kind.replace("/", "\n") for kind in scenarios]
    title = "Tracking error by technique (rows) and by fault and reference (columns)"
    return _map(np.array(values), [*names, "oracle"], columns, title, (9.5, 1.4 + 0.42 * len(values)))


def grid(report: dict[str, Any]) -> Figure | None:
    """Return the heat map of the paper's techniques over faults of all sizes, if they were run."""
    if report["grid"] is None:
        return None
    cells = report["grid"]["scenarios"]
    names = list(next(iter(cells.values())))
    values = np.array([[cells[kind][n]["rmse_mean"] for n in names] for kind in cells])
    title = "Tracking error over faults of all sizes (injection in m/s, drift in m/s per second)"
    return _map(values, [kind.replace("/", ", ") for kind in cells], names, title, (8.0, 1.2 + 0.27 * len(values)))


def _map(values: Any, rows: list[str], columns: list[str], title: str, size: tuple[float, float]) -> Figure:
    from matplotlib.colors import LogNorm

    made = figure(*size)
    axis = made.subplots()
    image = heat_map(axis, values, rows, columns, norm=LogNorm(values.min(), values.max()))
    bar = colour_bar(made, image, axis, "root-mean-square error (m/s)", aspect=30)
    _plain_logarithms(bar.ax.yaxis)
    axis.set_title(title, fontsize=10, loc="left")
    return made


def _plain_logarithms(axis: Any) -> None:
    """Write the numbers of a logarithmic axis as 0.2, 0.5, 1, 2."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


FIGURES = {"tracking_error_over_time": error_over_time, "tracking_errors": errors, "tracking_grid": grid}
