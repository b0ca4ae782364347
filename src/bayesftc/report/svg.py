"""Figures as SVG text in the page itself. They have the colours of the page, so they suit dark mode and print, too."""

from __future__ import annotations

import io
import re
import textwrap
import warnings
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GRID = "#010203", "#040506"
"""Placeholders for the colours of the page's text and of thin lines; no other part of a figure has these colours."""
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", INK)
"""Colours of Okabe and Ito (2008), which colour-blind readers can distinguish, on white and on black."""
LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKERS = ("o", "^", "s", "D", "v", "P")
WIDTH = 8.6
"""Width of all figures in inches."""
LEAST_SPAN = 1e-4
"""Least span of an axis, relative to its values."""


class Style(NamedTuple):
    """The style of a level, the same in all figures of a page."""

    colour: str
    line: Any
    marker: str


def styles() -> list[Style]:
    """Return the distinct styles, which differ in colour and in line or marker."""
    return [Style(*each) for each in zip(COLOURS, LINES, MARKERS, strict=True)]


def words(text: Any, width: int = 36, lines: int = 3) -> str:
    """Return a text for a figure, wrapped and cut to a number of lines, without formulas."""
    wrapped = textwrap.wrap(str(text), width) or [""]
    if len(wrapped) > lines:
        wrapped = [*wrapped[: lines - 1], f"{wrapped[lines - 1][: width - 2]} …"]
    shown = "\n".join(wrapped).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown  # matplotlib leaves labels with "_" out of legends


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
    """Give an axis the page's text colour and a thin grid, without a frame at the top and on the right."""
    axis.set_facecolor("none")
    axis.grid(True, color=GRID, lw=0.6)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=8, colors=INK)
    axis.ticklabel_format(useOffset=False)
    for side, spine in axis.spines.items():
        spine.set_visible(side in {"left", "bottom"})
        spine.set_color(INK)
    for text in (axis.xaxis.label, axis.yaxis.label, axis.title):
        text.set_color(INK)
        text.set_fontsize(9)


def widen(axis: Axes) -> None:
    """Let a vertical axis span a ten thousandth of its values or more: smaller steps would have labels of many digits."""
    low, high = axis.get_ylim()
    least = LEAST_SPAN * max(abs(low), abs(high))
    if high - low < least:
        middle = (low + high) / 2
        axis.set_ylim(middle - least / 2, middle + least / 2)


def error_bars(axis: Axes, x: Any, y: Any, half: Any, style: Style, label: str | None) -> None:
    """Draw values with halves of their intervals, or what lies below and above them, in a level's style."""
    look: dict[str, Any] = {"fmt": style.marker, "ls": style.line, "color": style.colour}
    axis.errorbar(x, y, yerr=half, ms=4, lw=1.2, capsize=3, label=label, **look)


def legend(axis: Axes, columns: int = 3) -> None:
    """Put a legend above an axis, if it has labels."""
    handles, _ = axis.get_legend_handles_labels()
    if handles:
        above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
        axis.legend(ncols=min(len(handles), columns), frameon=False, fontsize=8, labelcolor=INK, **above)


def to_svg(made: Figure, description: str) -> str:
    """Return a figure as an ``svg`` element; the description is for screen readers."""
    from html import escape

    from matplotlib import rc_context

    for fonts in ("path", "none"):  # if the font lacks letters, the browser's fonts are used
        text = io.StringIO()
        with (
            rc_context({"svg.fonttype": fonts, "svg.hashsalt": description}),
            warnings.catch_warnings(record=True) as caught,
        ):
            warnings.simplefilter("always")
            made.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
        if not any("Glyph" in str(warning.message) for warning in caught):
            break
    svg = text.getvalue()
    svg = re.sub(r"<!--.*?-->\s*", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace(INK, "currentColor").replace(GRID, "var(--line)")
    for i, colour in enumerate(COLOURS[:-1]):  # the page sets brighter ones for dark mode
        svg = svg.replace(colour.lower(), f"var(--c{i})")
    svg = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', "", svg, count=1)
    # One page has several figures, so the identifiers of their parts must differ.
    prefix = f"f{zlib.crc32(description.encode()):x}-"  # the same in each process
    svg = re.sub(r'\bid="', f'id="{prefix}', svg)
    svg = svg.replace("url(#", f"url(#{prefix}").replace('href="#', f'href="#{prefix}')
    head = f'<svg role="img" aria-label="{escape(description, quote=True)}"'
    return svg.replace("<svg", head, 1)
