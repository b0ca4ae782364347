"""The figure of `Detectability`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, LINES, MARKERS, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.controllers.detection.detectability import Detectability

MULTIPLES = (0.8, 0.9, 1.0, 1.15, 1.35, 1.6, 2.0, 2.5, 3.2, 4.0)
"""Sizes of the drawn delays, as multiples of the smallest detectable one."""

FORMS = {
    "loop": "in the loop, with learned precision",
    "fixed filter": "filter at fixed precision",
    "stream": "without a filter",
}
"""Names in the legend of results that are named by their form."""
COLOURS = (BLUE, SENSOR_COLOURS[0], BLACK, *SENSOR_COLOURS[1:])
AXES = {
    "offset": "offset (sensor's units)",
    "drift": "drift (sensor's units per second)",
    "noise": "standard deviation of additional noise (sensor's units)",
}


def draw(results: Mapping[str, Detectability], figure: Figure) -> Figure:
    """Draw results on an empty figure: the tail of beta without a fault, and the delay for each kind of fault."""
    figure.set_size_inches(9.0, 6.4)
    figure.set_layout_engine("constrained")
    panels = figure.subplots(2, 2)
    _draw_tails(panels[0, 0], results)
    for axis, kind in zip((panels[0, 1], panels[1, 0], panels[1, 1]), AXES, strict=True):
        _draw_delays(axis, results, kind)
    for axis in panels.flat:
        axis.grid(True, which="major", color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=8)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def _look(i: int) -> dict[str, Any]:
    return {"color": COLOURS[i % len(COLOURS)], "ls": LINES[i % len(LINES)], "lw": 1.5}


def _draw_tails(axis: Axes, results: Mapping[str, Detectability]) -> None:
    for i, result in enumerate(results.values()):
        beta = np.linspace(0.5 * result.mean_beta, 1.15 * result.threshold, 60)
        axis.semilogy(beta, np.maximum(result.exceedance(beta), 1e-12), **_look(i))
        axis.plot([result.threshold], [result.false_alarm_probability], "o", ms=6, color=COLOURS[i % len(COLOURS)])
    axis.set_ylim(bottom=0.05 * min(r.false_alarm_probability for r in results.values()), top=1.5)
    axis.set_xlabel("value of beta (sensor's units, squared)")
    axis.set_ylabel("probability that beta is larger")
    axis.set_title("No fault; dot: threshold and false alarms per sample", fontsize=10, loc="left")


def _draw_delays(axis: Axes, results: Mapping[str, Detectability], kind: str) -> None:
    least = np.inf
    for i, (label, result) in enumerate(results.items()):
        smallest = getattr(result, kind)
        sizes = smallest * np.array(MULTIPLES)
        delays = result.delay(kind, sizes)  # type: ignore[arg-type]
        least = min(least, float(delays.min()))
        axis.loglog(sizes, delays, label=FORMS.get(label, label), **_look(i))
        delay = getattr(result, f"{kind}_delay")
        axis.plot([smallest], [delay], MARKERS[i % len(MARKERS)], ms=6, color=COLOURS[i % len(COLOURS)])
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    # A delay below half a sample means an alarm at the first sample.
    axis.set_ylim(bottom=max(0.8 * least, 0.5 * min(result.dt for result in results.values())))
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        side.set_major_formatter(StrMethodFormatter("{x:g}"))
        side.set_minor_formatter(NullFormatter())
    axis.set_xlabel(AXES[kind])
    axis.set_ylabel("expected delay (s)")
    first_result = next(iter(results.values()))
    note = f"{100 * first_result.detection_probability:g} % are detected within {first_result.within:g} s"
    axis.set_title(f"{kind.capitalize()}; mark: {note}", fontsize=10, loc="left")
