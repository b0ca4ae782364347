"""Panels over time, one above the other, for the figures of runs and of recordings."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from datetime import datetime

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LARGEST = 1e300
"""Values beyond it, as of a run that diverges, are drawn there: matplotlib adds margins to the ends of a line."""
MOST_POINTS = 20_000
"""A line with more points than this is thinned, because no print shows more."""
MOST_ROWS = 3
"""If the names of faults need more rows than this, the faults are only shaded."""
ROW = 0.2
"""Height of those rows in inches."""
LETTER = 0.0115
"""Width of a letter of those names, as a share of the panel's width."""
LETTERS = 115.0
"""Letters of a size of 1 point that fit an inch."""
WIDTH, PANEL = 8.0, 2.1
"""Width of a figure and usual height of a panel in inches."""

Span = tuple[float, float, str, str]
"""Begin and end of something in a figure, its name and its colour."""

LONG, VERY_LONG = 3 * 3600.0, 5 * 86400.0
"""Seconds from which a time axis is in hours, and in days."""


def shown_figure() -> Figure:
    """Return an empty figure of pyplot for a user: a notebook shows it below its cell, a script with ``pyplot.show()``."""
    from matplotlib import pyplot

    from bayesftc.cosim.judging.figures.notebook import NotebookFigure

    return pyplot.figure(FigureClass=NotebookFigure) if _in_notebook() else pyplot.figure()


def player_figure() -> Figure:
    """Return an empty figure for an animation, which a notebook shows only as a player: pyplot does not know it there."""
    from bayesftc.cosim.judging.figures.notebook import NotebookFigure

    return NotebookFigure() if _in_notebook() else shown_figure()


def _in_notebook() -> bool:
    """Return whether figures are shown below the cells of a notebook."""
    import matplotlib

    backend = str(matplotlib.get_backend()).lower()
    ipython = sys.modules.get("IPython")
    return "inline" in backend or (backend == "agg" and hasattr(ipython and ipython.get_ipython(), "kernel"))


def bare_figure() -> Figure:
    """Return an empty figure outside of pyplot, as for a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    FigureCanvasAgg(figure)
    return figure


def make_panels(heights: Sequence[float], figure: Figure | None = None) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels of these heights in inches, from above, with a common time axis.

    Parameters
    ----------
    heights : sequence of float
        One for each panel.
    figure : Figure, optional
        An empty figure to draw on; by default one outside of pyplot.
    """
    figure = figure or bare_figure()
    figure.set_size_inches(WIDTH, 0.6 + sum(heights))
    figure.set_layout_engine("constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axis in axes:
        plain(axis)
    return figure, list(axes)


def plain(axis: Axes) -> None:
    """Give a panel a grid, small numbers and no frame."""
    axis.grid(True, color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8)
    axis.ticklabel_format(useOffset=False)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def broken(label: str, height: float, size: float = 10.0) -> str:
    """Return a label of a vertical axis, broken into lines that fit the height of the panel.

    Parameters
    ----------
    label : str
        The label. It is broken after points, underscores, hyphens and spaces, and anywhere if that is not enough.
    height : float
        Height of the panel in inches.
    size : float
        Size of the letters in points.
    """
    most, lines = max(int(LETTERS * height / size), 1), [""]
    for part in re.findall(r"[^._ \n-]*[._ \n-]?", label):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > most:
            lines.append("")
        lines[-1] += part.removesuffix("\n")
        while len(lines[-1].rstrip()) > most:
            lines[-1:] = [lines[-1][:most], lines[-1][most:]]
        if part.endswith("\n"):
            lines.append("")
    return "\n".join(line.rstrip() for line in lines)


def thin(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return a line with at most as many points as a print shows."""
    kept = with_peaks(values)
    return time[kept], drawable(values[kept])


def drawable(values: Floats) -> Floats:
    """Return values as far as matplotlib can draw them; those that are not finite stay, and are not drawn."""
    return np.where(np.isfinite(values), np.clip(values, -LARGEST, LARGEST), values)


def with_peaks(values: Floats) -> NDArray[np.intp]:
    """Return the indices of the points of a thinned line: the least and the largest of each few, so that peaks remain."""
    if len(values) <= MOST_POINTS:
        return np.arange(len(values))
    few = -(-len(values) // (MOST_POINTS // 2))
    blocks = np.append(values, np.full(-len(values) % few, np.nan)).reshape(-1, few)
    low, high = (np.where(np.isnan(blocks), limit, blocks) for limit in (np.inf, -np.inf))
    within = np.sort(np.stack([low.argmin(axis=1), high.argmax(axis=1)], axis=1), axis=1)
    return np.asarray((few * np.arange(len(blocks))[:, np.newaxis] + within).ravel())


def thin_marks(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return about as many points as a print shows: one of each few, and outliers; extremes alone would look like more noise."""
    if len(time) <= MOST_POINTS or not np.isfinite(values).any():
        return time[:MOST_POINTS], drawable(values[:MOST_POINTS])
    low, high = np.nanquantile(values, [0.02, 0.98])
    beyond = np.flatnonzero(np.abs(values - 0.5 * (low + high)) > 2.0 * (high - low))
    few = np.arange(0, len(time), -(-len(time) // MOST_POINTS))
    kept = np.union1d(few, beyond[:: 1 + len(beyond) // MOST_POINTS])
    return time[kept], drawable(values[kept])


def name_spans(axis: Axes, time: Floats, spans: Sequence[Span], note: str) -> None:
    """Write names above spans of time in as many rows as necessary; if those are too many, write the note instead."""
    if have_room(time, spans):
        write_names(axis, time, spans, PANEL)
        return
    first = float(time[0]) if len(time) else 0.0
    axis.text(first, 1.02, note, color="0.3", **_style(axis))


def have_room(time: Floats, spans: Sequence[Span]) -> bool:
    """Return whether the names of all spans have room above a panel."""
    return max((row for row, *_ in _placed(time, spans)), default=0) < MOST_ROWS


def write_names(axis: Axes, time: Floats, spans: Sequence[Span], height: float) -> None:
    """Write names above spans of time on a panel with a height in inches, in one row or a few.

    A name is left out where the same one stands beside it already, or where there is no room.
    """
    kept = [span for span in _placed(time, spans, once=True) if span[0] < MOST_ROWS]
    for row, middle, text, colour in kept:
        axis.text(middle, 1.02 + (0.04 + ROW * row) / height, text, ha="center", color=colour, **_style(axis))


def _style(axis: Axes) -> dict[str, Any]:
    return {"fontsize": 8, "va": "bottom", "transform": axis.get_xaxis_transform(), "clip_on": False}


def _placed(time: Floats, spans: Sequence[Span], *, once: bool = False) -> list[tuple[int, float, str, str]]:
    """Return the row, the middle, the text and the colour of each name; with `once` not those that stand beside equal ones."""
    first, last = (float(time[0]), float(time[-1])) if len(time) else (0.0, 0.0)
    rows: list[tuple[float, str]] = []  # the end of the last name in each row, and this name
    placed = []
    for begin, end, text, colour in sorted(spans):
        half = 0.5 * LETTER * (last - first) * (len(text) + 2)
        middle = max(min(0.5 * (begin + end), last - half), min(first + half, 0.5 * (first + last)))
        row = next((i for i, (until, _) in enumerate(rows) if until <= middle - half), len(rows))
        if once and any(name == text for _, name in rows[:row]):
            continue
        rows[row : row + 1] = [(middle + half, text)]
        placed.append((row, middle, text, colour))
    return placed


def legend(axis: Axes) -> None:
    """Put the legend beside a panel, if it has labels; its lines and dots are not transparent."""
    from matplotlib.lines import Line2D

    if axis.get_legend_handles_labels()[0]:
        box = axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8, borderaxespad=0)
        for handle in box.legend_handles:
            if isinstance(handle, Line2D):
                handle.set_alpha(1.0)


def as_dates(time: Floats, origin: datetime) -> Floats:
    """Return times in seconds from an instant as matplotlib's dates, by the clock of the instant."""
    from matplotlib.dates import date2num

    return np.asarray(float(date2num(origin.replace(tzinfo=None))) + time / 86400.0)  # type: ignore[no-untyped-call]


def finish(axes: list[Axes], time: Floats, origin: datetime | None = None) -> None:
    """Label the time below the lowest panel, limit all panels to it, write their numbers, and align their labels.

    With the `origin` of `as_dates`, the times are those dates. Long times without dates are in hours or days.
    """
    label = "time (s)"
    span = float(time[-1] - time[0]) if len(time) > 1 else 0.0
    if origin is None and span > LONG:
        unit, seconds = ("d", 86400.0) if span > VERY_LONG else ("h", 3600.0)
        _tick_in(axes[-1], seconds)
        label = f"time ({unit})"
    if origin is not None:
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator, zone = AutoDateLocator(), origin.tzname()
        axes[-1].xaxis.set_major_locator(locator)
        axes[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        label = f"time ({zone})" if zone else "time"
    axes[-1].set_xlabel(label)
    if len(time) > 1:
        axes[-1].set_xlim(float(time[0]), float(time[-1]))
    for axis in axes:
        _write_exponents(axis)
    figure: Any = axes[0].figure
    figure.align_ylabels(axes)
    # Labels are aligned beside the widest numbers, which are known only when the panels have their sizes.
    figure.get_layout_engine().execute(figure)


def _tick_in(axis: Axes, unit: float) -> None:
    """Put ticks at round multiples of a unit of time, given in seconds, and write them in it."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    class InUnit(MaxNLocator):
        def tick_values(self, vmin: float, vmax: float) -> list[float]:
            return [unit * tick for tick in super().tick_values(vmin / unit, vmax / unit)]

    axis.xaxis.set_major_locator(InUnit(nbins="auto", steps=[1, 2, 2.5, 5, 10]))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t / unit:g}"))


def _write_exponents(axis: Axes) -> None:
    """Write the exponent of very small or large numbers beside each, as 2e-05, because names of faults stand above the axis."""
    from matplotlib.ticker import ScalarFormatter, StrMethodFormatter

    formatter, (low, high) = axis.yaxis.get_major_formatter(), sorted(axis.get_ylim())
    if isinstance(formatter, ScalarFormatter):
        formatter.set_locs([tick for tick in axis.get_yticks() if low <= tick <= high])
        if formatter.get_offset():
            axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
