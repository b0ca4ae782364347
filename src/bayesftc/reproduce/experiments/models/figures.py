"""Figures of the wrong models, drawn from the report alone."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.reproduce.experiments.tracking.bench import HEALTHY
from bayesftc.reproduce.shared.drawing import colour_bar, figure, heat_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = {
    "as it is": "the controller estimates the speed",
    "with disturbance": "the controller estimates the speed and an unknown force",
}
"""Descriptions of the controller's models."""


def healthy(report: dict[str, Any]) -> Figure:
    """Return the heat maps of the errors relative to fixed precision with healthy sensors."""
    title = "Healthy sensors: tracking error over that of fixed precision (No FT); red is worse, blue is better"
    return _maps(report, [HEALTHY], title, "{:.2f}", 4.0, columns=1)


def failed(report: dict[str, Any]) -> Figure:
    """Return the heat maps of the errors relative to the oracle with one sensor failed."""
    cases = list(next(iter(next(iter(report["oracle"].values())).values())))
    start, stop = (report["settings"][f"fault_{what}"] for what in ("start", "stop"))
    when = f"from {start:g} to {stop:g} s of {report['settings']['duration']:g} s"
    title = f"One of two sensors failed {when}: tracking error over the oracle's, which ignores it"
    return _maps(report, cases, title, "{:.1f}", 32.0, columns=2)


def _maps(report: dict[str, Any], cases: list[str], title: str, form: str, limit: float, columns: int) -> Figure:
    """Return a panel for each case and model; ratios of `limit` and its inverse have the strongest colours."""
    from matplotlib.colors import LogNorm

    errors, labels = report["errors"], report["settings"]["labels"]
    names = list(next(iter(next(iter(errors.values())).values())))
    panels = list(product(cases, errors))
    rows = len(panels) // columns
    made = figure(3.6 + 6.0 * columns, 1.4 + rows * (0.4 + 0.24 * len(names)))
    axes = made.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    image: Any = None
    for axis, (case, model) in zip(axes.flat, panels, strict=True):
        values = np.array([[of[n][case]["ratio"] for of in errors[model].values()] for n in names])
        image = heat_map(axis, values, names, [""] * len(labels), form, cmap="RdBu_r", norm=LogNorm(1 / limit, limit))
        what = "" if case == HEALTHY else f"{case}; "
        axis.set_title(what + MODELS[model], fontsize=10, loc="left")
    for axis in axes[-1]:
        slanted = {"rotation": 35, "ha": "right", "rotation_mode": "anchor"}
        axis.set_xticks(range(len(labels)), labels.values(), fontsize=9, **slanted)
    bar = colour_bar(made, image, list(axes.ravel()), "ratio of root-mean-square errors", extend="both")
    ticks = [2.0**k for k in range(-10, 11) if 1 / limit <= 2.0**k <= limit]
    bar.set_ticks(ticks, labels=[f"{tick:.3g}" for tick in ticks])
    bar.minorticks_off()
    made.suptitle(title, fontsize=11, x=0.01, ha="left")
    return made


FIGURES = {"models_healthy": healthy, "models_failed": failed}
