"""Figures as text that stands in the page itself: their ink is that of the page, so they are read by night and in print, too."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

from bayesftc.cosim.plotting import SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GRID = "#010203", "#040506"
"""Stand for the colour of the page's text, and of thin lines; nothing else has these."""
COLOURS = SENSOR_COLOURS
WIDTH = 8.6
"""Of all figures, in inches."""


def figure(height: float, rows: int = 1, columns: int = 1, *, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    """Return an empty figure of the page's width, and its axes row by row."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    made = Figure(figsize=(WIDTH, height), layout="constrained", facecolor="none")
    FigureCanvasSVG(made)
    axes = list(made.subplots(rows, columns, sharex=sharex, squeeze=False).ravel())
    for axis in axes:
        tidy(axis)
    return made, axes


def tidy(axis: Axes) -> None:
    """Give an axis the page's ink, a thin grid and no frame above and to the right."""
    axis.set_facecolor("none")
    axis.grid(True, color=GRID, lw=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8, colors=INK)
    for side, spine in axis.spines.items():
        spine.set_visible(side in {"left", "bottom"})
        spine.set_color(INK)
    for text in (axis.xaxis.label, axis.yaxis.label, axis.title):
        text.set_color(INK)
        text.set_fontsize(9)


def legend(axis: Axes) -> None:
    """Name what an axis shows, above it, if there is anything to name."""
    handles, _ = axis.get_legend_handles_labels()
    if handles:
        axis.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(len(handles), 4), frameon=False, fontsize=8, labelcolor=INK,
            borderaxespad=0.2,
        )  # fmt: skip


def to_svg(made: Figure, description: str) -> str:
    """Return a figure as an ``svg`` element; the description is for those who cannot see it."""
    from html import escape

    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.fonttype": "path", "svg.hashsalt": description}):
        made.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor").replace(GRID, "var(--line)")
    svg = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", svg, count=1)
    # Several figures stand in one page: what their parts are called must differ.
    prefix = f"f{abs(hash_of(description)):x}-"
    svg = re.sub(r'\bid="', f'id="{prefix}', svg)
    svg = svg.replace("url(#", f"url(#{prefix}").replace('href="#', f'href="#{prefix}')
    head = f'<svg role="img" aria-label="{escape(description, quote=True)}"'
    return svg.replace("<svg", head, 1)


def hash_of(text: str) -> int:
    """Return a number for a text, the same in each process."""
    import zlib

    return zlib.crc32(text.encode())


__all__ = ["COLOURS", "GRID", "INK", "figure", "hash_of", "legend", "tidy", "to_svg"]
