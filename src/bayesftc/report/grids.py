"""The metric over the grid: each cell's mean by colour and number, or over one factor a line with its intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.report.svg import COLOURS, INK, figure, legend

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from bayesftc.report.contents import Contents

MOST = 15
"""Levels of a factor that a heat map shows."""
MAPS = 4


def over_grid(contents: Contents) -> tuple[Figure, str] | None:
    """Return a figure of the metric's mean over the factors that are varied besides the compared one, and what it shows."""
    metric = contents.metric
    if metric is None or not contents.varied:
        return None
    axes_of = contents.others or [n for n in contents.varied if n != contents.compared]
    few = [name for name in axes_of if contents.table[name].nunique() <= MOST]
    if len(few) >= 2:
        return _maps(contents, metric, few[0], few[1])
    over = next(iter([*few, *axes_of]), None)
    return _lines(contents, metric, over)


def _maps(contents: Contents, metric: str, down: str, across: str) -> tuple[Figure, str]:
    levels = contents.levels()[:MAPS]
    means = [contents.runs_of(level).groupby([down, across])[metric].mean().unstack() for level in levels]
    finite = np.concatenate([m.to_numpy().ravel() for m in means])
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    rows = max(len(m.index) for m in means)
    columns = min(len(levels), 2)
    made, axes = figure((0.9 + 0.32 * rows) * -(-len(levels) // columns) + 0.4, -(-len(levels) // columns), columns)
    image = None
    for axis, level, mean in zip(axes, levels, means, strict=False):
        axis.grid(False)
        image = axis.imshow(mean.to_numpy(), aspect="auto", cmap="viridis", vmin=low, vmax=high)
        axis.set_xticks(range(len(mean.columns)), [_short(v) for v in mean.columns])
        axis.set_yticks(range(len(mean.index)), [_short(v) for v in mean.index])
        axis.set_xlabel(across)
        axis.set_ylabel(down)
        if level is not None:
            axis.set_title(str(level), color=INK, fontsize=9)
        _write(axis, mean, low, high)
    for axis in axes[len(levels) :]:
        axis.set_visible(False)
    if image is not None:
        bar = made.colorbar(image, ax=axes[: len(levels)], shrink=0.8)
        bar.set_label(metric, color=INK, fontsize=9)
        bar.ax.tick_params(labelsize=8, colors=INK)
        bar.outline.set_visible(False)
    rest = [name for name in contents.others if name not in {down, across}]
    return made, f"Mean of {metric} over the grid{'; means over ' + ', '.join(rest) if rest else ''}."


def _write(axis: Axes, mean: pd.DataFrame, low: float, high: float) -> None:
    for i, row in enumerate(mean.to_numpy()):
        for j, value in enumerate(row):
            bright = value > low + 0.6 * (high - low)
            axis.text(j, i, f"{value:.3g}", ha="center", va="center", fontsize=8, color="black" if bright else "white")


def _lines(contents: Contents, metric: str, over: str | None) -> tuple[Figure, str]:
    from bayesftc.cosim.statistics import summary

    made, (axis,) = figure(2.9)
    levels = contents.levels()
    if over is None:  # the compared factor alone
        cells = summary(contents.table, metric, by=[contents.compared or ""])
        at = np.arange(len(cells))
        axis.errorbar(
            at, cells["mean"], yerr=[cells["mean"] - cells["low"], cells["high"] - cells["mean"]], fmt="o", color=COLOURS[0],
            capsize=3,
        )  # fmt: skip
        axis.set_xticks(at, [_short(v) for v in cells[contents.compared]])
        axis.set_xlim(-0.5, len(at) - 0.5)
        axis.set_xlabel(str(contents.compared))
    elif contents.table[over].nunique() > MOST:  # samples of a range: a point each
        for level, colour in zip(levels, COLOURS, strict=False):
            runs = contents.runs_of(level)
            axis.plot(
                runs[over],
                runs[metric],
                ".",
                ms=3,
                alpha=0.5,
                color=colour,
                label=None if level is None else str(level),
            )
        axis.set_xlabel(over)
    else:
        _errorbars(axis, contents, metric, over)
    axis.set_ylabel(metric)
    legend(axis)
    many = over is not None and contents.table[over].nunique() > MOST
    return (
        made,
        f"{metric}{': each run' if many else ', mean and 95 % confidence interval'}{f' over {over}' if over else ''}.",
    )


def _errorbars(axis: Axes, contents: Contents, metric: str, over: str) -> None:
    from bayesftc.cosim.statistics import summary

    values = list(contents.table[over].drop_duplicates())
    numeric = contents.table[over].dtype.kind in "if"
    for level, colour in zip(contents.levels(), COLOURS, strict=False):
        cells = summary(contents.runs_of(level), metric, by=[over])
        at = cells[over] if numeric else [values.index(v) for v in cells[over]]
        axis.errorbar(
            at, cells["mean"], yerr=[cells["mean"] - cells["low"], cells["high"] - cells["mean"]], fmt="o-", ms=4, lw=1.2,
            color=colour, capsize=3, label=None if level is None else str(level),
        )  # fmt: skip
    if not numeric:
        axis.set_xticks(range(len(values)), [_short(v) for v in values])
    axis.set_xlabel(over)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


__all__ = ["over_grid"]
