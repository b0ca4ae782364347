"""Figures of the wrong models, drawn from the report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.reproduce._drawing import figure, heat_map
from bayesftc.reproduce._tracking_bench import HEALTHY

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def healthy(report: dict[str, Any]) -> Figure:
    """Return the heat maps of the errors over fixed precision's with healthy sensors."""
    return _maps(report, [HEALTHY], "Tracking error over fixed precision's, healthy sensors", "{:.2f}", 4.0)


def failed(report: dict[str, Any]) -> Figure:
    """Return the heat maps of the errors over the oracle's with one sensor failed."""
    cases = list(next(iter(next(iter(report["oracle"].values())).values())))
    start, stop = (report["settings"][f"fault_{what}"] for what in ("start", "stop"))
    title = f"Tracking error over the oracle's, one of two sensors failed from {start:g} to {stop:g} s of {{:g}} s"
    return _maps(report, cases, title.format(report["settings"]["duration"]), "{:.1f}", 32.0)


def _maps(report: dict[str, Any], cases: list[str], title: str, form: str, limit: float) -> Figure:
    """Return a panel for each case and model; ratios of `limit` and its inverse have the strongest colours."""
    from matplotlib.colors import LogNorm

    errors = report["errors"]
    names = list(next(iter(next(iter(errors.values())).values())))
    conditions = list(report["settings"]["conditions"])
    made = figure(13.0, 0.7 + len(cases) * (0.9 + 0.24 * len(names)))
    axes = made.subplots(len(cases), len(errors), squeeze=False, sharey=True)
    image: Any = None
    for row, case in zip(axes, cases, strict=True):
        for axis, (model, cells) in zip(row, errors.items(), strict=True):
            values = np.array([[cells[c][n][case]["ratio"] for c in conditions] for n in names])
            heads = [c.replace(" ", "\n") for c in conditions]
            image = heat_map(axis, values, names, heads, form, cmap="RdBu_r", norm=LogNorm(1 / limit, limit))
            what = "" if case == HEALTHY else f"{case}, "
            axis.set_title(f"{what}controller's model {model}", fontsize=10, loc="left")
    bar = made.colorbar(image, ax=list(axes.ravel()), pad=0.01, aspect=40, extend="both")
    ticks = [2.0**k for k in range(-10, 11) if 1 / limit <= 2.0**k <= limit]
    bar.set_ticks(ticks, labels=[f"{tick:.3g}" for tick in ticks])
    bar.minorticks_off()
    bar.set_label("ratio of root-mean-square errors", fontsize=9)
    bar.outline.set_visible(False)  # type: ignore[operator]
    made.suptitle(title, fontsize=11, x=0.01, ha="left")
    return made


FIGURES = {"models_healthy": healthy, "models_failed": failed}
