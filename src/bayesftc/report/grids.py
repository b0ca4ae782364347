"""The metric over the factors: a map of the cells' means, or for each factor a line with intervals, or dots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.report.levels import estimate
from bayesftc.report.svg import INK, error_bars, figure, legend, widen, words

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.report.contents import Contents

MOST = 15
"""Largest number of values of a factor in a map or on a line."""
PANELS = 4
"""Largest number of factors with a panel."""
FEW = 8
"""Largest number of values that all get a tick."""
DOTS = 2_000
"""Largest number of drawn points of a level; more would merge into one area."""


def over_grid(contents: Contents) -> tuple[Figure, str] | None:
    """Return a figure of the metric over the varied factors, and its caption; None without factor or metric."""
    if contents.metric is None or not contents.varied:
        return None
    few = [name for name in contents.others if contents.values(name) <= MOST]
    if len(few) == len(contents.others) >= 2:
        return _maps(contents, contents.metric, few[0], few[1])
    return _panels(contents, contents.metric, (contents.others or contents.varied)[:PANELS])


def _maps(contents: Contents, metric: str, down: str, across: str) -> tuple[Figure, str]:
    levels = list(contents.drawn())
    means = [_cells(contents, level, metric, down, across) for level in levels]
    finite = np.concatenate([m.to_numpy().ravel() for m in means])
    finite = finite[np.isfinite(finite)]
    low, high = float(finite.min()), float(finite.max())
    rows, wide = (max(len(m.axes[i]) for m in means) for i in (0, 1))
    columns = min(len(levels), 3 if wide <= 5 else 2 if wide <= 9 else 1)
    lines = -(-len(levels) // columns)
    made, axes = figure((0.9 + 0.3 * rows) * lines + 0.3, lines, columns)
    for i, (axis, level, mean) in enumerate(zip(axes, levels, means, strict=False)):
        axis.grid(False)
        image = axis.imshow(mean.to_numpy(), aspect="auto", cmap="viridis", vmin=low, vmax=high)
        axis.set_xticks(range(len(mean.columns)), [_short(v) for v in mean.columns])
        axis.set_yticks(range(len(mean.index)), [_short(v) for v in mean.index])
        axis.tick_params(length=0)
        axis.set_xlabel(words(contents.heading(across)))
        axis.set_ylabel(words(contents.heading(down), 20) if i % columns == 0 else "")
        if level is not None:
            axis.set_title(words(contents.name(level)), color=INK, fontsize=9)
        for spine in axis.spines.values():
            spine.set_visible(False)
        _write(axis, mean, image)
    for axis in axes[len(levels) :]:
        axis.set_visible(False)
    bar = made.colorbar(image, ax=axes[: len(levels)], fraction=0.04, aspect=25, pad=0.01)
    bar.set_label(words(contents.heading(metric), 24), color=INK, fontsize=9)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.outline.set_visible(False)  # type: ignore[operator]
    rest = [name for name in contents.others if name not in {down, across}]
    over = f", means over {', '.join(rest)} as well" if rest else ""
    of = f", for each {contents.compared}" if contents.compared else ""
    return made, f"Mean of {metric} over {down} and {across}{of}{over}.{contents.undrawn}"


def _cells(contents: Contents, level: Any, metric: str, down: str, across: str) -> pd.DataFrame:
    """Return the mean of each cell, with rows and columns in the order of the design, or sorted if they are numbers."""
    mean = contents.runs_of(level).groupby([down, across], dropna=False)[metric].mean().unstack()
    return mean.reindex(index=_ordered(contents, down), columns=_ordered(contents, across))


def _ordered(contents: Contents, name: str) -> list[Any]:
    column = contents.table[name].drop_duplicates()
    return list(column.sort_values() if column.dtype.kind in "if" else column)


def _write(axis: Axes, mean: pd.DataFrame, image: Any) -> None:
    """Write each cell's number on it, in black or white, whichever has more contrast."""
    colours = image.cmap(image.norm(mean.to_numpy()))
    size = 8 if mean.shape[1] <= 9 else 6.5
    for i, row in enumerate(mean.to_numpy()):
        for j, value in enumerate(row):
            red, green, blue = (c / 12.92 if c <= 0.04 else ((c + 0.055) / 1.055) ** 2.4 for c in colours[i, j, :3])
            bright = 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.18
            finite = np.isfinite(value)
            ink = INK if not finite else "black" if bright else "white"
            axis.text(j, i, f"{value:.3g}" if finite else "–", ha="center", va="center", fontsize=size, color=ink)


def _panels(contents: Contents, metric: str, names: list[str]) -> tuple[Figure, str]:
    columns = min(len(names), 2)
    lines = -(-len(names) // columns)
    made, axes = figure(2.7 * lines + 0.2, lines, columns)
    dots = bars = False
    for i, (axis, name) in enumerate(zip(axes, names, strict=False)):
        numeric = contents.table[name].dtype.kind in "if"
        if numeric and contents.values(name) > MOST:
            _dots(axis, contents, metric, name)
            dots = True
        else:
            _bars(axis, contents, metric, name)
            bars = True
        axis.set_xlabel(words(contents.heading(name)))
        axis.set_ylabel(words(contents.heading(metric), 30) if i % columns == 0 else "")
        widen(axis)
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    legend(axes[0])
    marks = [
        *(["dots are points of the design, each the mean of its runs"] if dots else []),
        *(["means with 95 % confidence intervals over seeds"] if bars else []),
    ]
    pooled = (
        " All other factors vary as well."
        if len(contents.varied) > 1 + (contents.compared not in {None, *names})
        else ""
    )
    return made, f"{metric} over {', '.join(names)}: {'; '.join(marks)}.{pooled}{contents.undrawn}"


def _dots(axis: Axes, contents: Contents, metric: str, name: str) -> None:
    for level, style in contents.drawn().items():
        points = contents.runs_of(level).groupby("point").agg({name: "first", metric: "mean"})
        if len(points) > DOTS:
            points = points.sample(DOTS, random_state=0)
        look: dict[str, Any] = {"ms": 3.5, "mew": 0, "alpha": 0.7, "color": style.colour}
        axis.plot(points[name], points[metric], style.marker, **look, label=_name(contents, level))


def _bars(axis: Axes, contents: Contents, metric: str, name: str) -> None:
    values = _ordered(contents, name)[:MOST]
    numeric = contents.table[name].dtype.kind in "if"
    is_compared = name == contents.compared
    drawn = {None: next(iter(contents.drawn().values()))} if is_compared else contents.drawn()
    for i, (level, style) in enumerate(drawn.items()):
        runs = contents.table if is_compared else contents.runs_of(level)
        means = [estimate(contents, runs[runs[name] == value], metric) for value in values]
        # Names are drawn side by side; numbers stay at their places on the scale.
        at = np.array(values, dtype=float) if numeric else np.arange(len(values)) + 0.12 * (i - (len(drawn) - 1) / 2)
        bounds = [e.bounds(contents.positive(metric)) for e in means]
        sides = [(e.value - low, high - e.value) for e, (low, high) in zip(means, bounds, strict=True)]
        half = np.nan_to_num(np.array(sides).T)
        drawn_as = style if numeric else style._replace(line="none")
        error_bars(
            axis, at, [e.value for e in means], half, drawn_as, label=None if is_compared else _name(contents, level)
        )
    if numeric and len(values) <= FEW:
        axis.set_xticks(values, [_short(v) for v in values])
    if not numeric:
        axis.set_xticks(range(len(values)), [words(_short(v), 14) for v in values])
        axis.set_xlim(-0.5, len(values) - 0.5)


def _name(contents: Contents, level: Any) -> str | None:
    name = contents.name(level)
    return name and words(name, 32, 1)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else words(value, 18, 1)
