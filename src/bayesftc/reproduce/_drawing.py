"""What the figures of all experiments share: the house's colours, and heat maps with their numbers written in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.plotting import BLACK, BLUE, LINES, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, *SENSOR_COLOURS, "#999999")
ORACLE_STYLE: dict[str, Any] = {"color": BLACK, "ls": ":", "lw": 1.4}


def line_style(i: int) -> dict[str, Any]:
    """Return colour and style of the i-th line; the first is broad, so that it shows where the next one lies on it."""
    width = (3.2, 1.5, 2.2, 1.8)[i] if i < 4 else 1.2
    return {
        "color": COLOURS[i % len(COLOURS)],
        "ls": (*LINES[:2], "-", "-.")[i] if i < 4 else LINES[1 + i % 3],
        "lw": width,
    }


def figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def tidy(axis: Axes) -> None:
    """Give an axis the house's grid and no frame above and to the right."""
    axis.grid(True, color="0.9", lw=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=9)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def legend(axis: Axes, **options: Any) -> None:
    """Put the legend beside the axis, where it covers nothing."""
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=9, borderaxespad=0, **options)


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
            axis.text(
                j, i, form.format(value), ha="center", va="center", fontsize=8.5, color="white" if dark else "black"
            )
    return image
