"""Common parts of all figures: colours, axes, legends, and heat maps with numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLACK, SENSOR_COLOURS
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ORACLE_STYLE: dict[str, Any] = {"color": BLACK, "ls": ":", "lw": 1.4}
FURTHER_STYLE: dict[str, Any] = {"color": "0.6", "ls": "-", "lw": 0.9}
"""Style of techniques that are not in the paper: there are too many for separate colours."""
SWITCHING_STYLES: dict[str, dict[str, Any]] = {
    "SwitchingPrecision": {"color": SENSOR_COLOURS[2], "lw": 2.4, "zorder": 6},
    "SwitchingPrecision, per sensor": {"color": SENSOR_COLOURS[3], "lw": 1.7, "ls": (0, (5, 2)), "zorder": 7},
    "SwitchingPrecision, default": {"color": SENSOR_COLOURS[2], "lw": 1.7, "ls": (0, (1, 1.2)), "zorder": 7},
}
"""Styles of these forms, which come closest to the best possible detector."""


def figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def tidy(axis: Axes) -> None:
    """Give an axis the common grid, without a frame at the top and on the right."""
    axis.grid(True, color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def finish(axis: Axes, title: str = "", **settings: Any) -> None:
    """Give an axis settings (as for ``Axes.set``), a title on the left, and the common style."""
    axis.set(**settings)
    if title:
        axis.set_title(title, fontsize=10, loc="left")
    tidy(axis)


def diagonal(axis: Axes, label: str | None = None) -> None:
    """Draw the line on which both axes have the same value, from 0 to 1."""
    axis.plot([0, 1], [0, 1], color="0.3", ls=":", lw=1.2, label=label)


def colour_bar(figure: Figure, image: Any, axes: Any, label: str, **options: Any) -> Any:
    """Add the scale of a heat map's colours beside its axes, and return it; options are those of ``Figure.colorbar``."""
    bar = figure.colorbar(image, ax=axes, **{"pad": 0.01, "aspect": 40, **options})
    bar.set_label(label, fontsize=9)
    bar.outline.set_visible(False)  # type: ignore[operator]
    return bar


def legend(axis: Axes, lines: Sequence[str], title: str = "", group: Sequence[str] = ()) -> None:
    """Put the legend beside the axis.

    The labels of `lines` have one entry each, in this order. The names of a `group` are below the title, which has a single line
    in `FURTHER_STYLE` for all of them.
    """
    from matplotlib.lines import Line2D

    handles_of = dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    entries = [(handles_of[label], label) for label in lines]
    if group:
        entries += [(Line2D([], [], **FURTHER_STYLE), title), (Line2D([], [], ls="none"), "\n".join(group))]
    handles, labels = zip(*entries, strict=True)
    beside: dict[str, Any] = {
        "loc": "upper left",
        "bbox_to_anchor": (1.01, 1.0),
        "borderaxespad": 0,
        "alignment": "left",
    }
    axis.legend(handles, labels, frameon=False, fontsize=9, **beside)


MOST = 999.0
"""Larger numbers are shown as "> 999": they only mean that the plant was lost."""


def heat_map(
    axis: Axes, values: Floats, rows: Sequence[str], columns: Sequence[str], form: str = "{:.2f}", **options: Any
) -> Any:
    """Draw a matrix as colours with its numbers in the cells; options are those of ``imshow``. Return the image."""
    options = {"cmap": "viridis", "aspect": "auto", **options}
    image: Any = axis.imshow(values, **options)
    axis.set_xticks(range(len(columns)), columns, fontsize=9)
    axis.set_yticks(range(len(rows)), rows, fontsize=9)
    axis.tick_params(length=0)
    for side in axis.spines.values():
        side.set_visible(False)
    axis.set_xticks(np.arange(1, len(columns)) - 0.5, minor=True)
    axis.set_yticks(np.arange(1, len(rows)) - 0.5, minor=True)
    axis.grid(True, which="minor", color="white", lw=1.5)
    axis.tick_params(which="minor", length=0)
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = image.cmap(image.norm(value))
            dark = 0.3 * red + 0.59 * green + 0.11 * blue < 0.5
            colour = "white" if dark else "black"
            words = form.format(value) if value < MOST else f"> {MOST:g}"
            text = axis.text(j, i, words, ha="center", va="center", fontsize=8.5, color=colour)
            text.set_in_layout(False)  # it fits in its cell, and measuring each text takes as long as drawing it
    return image
