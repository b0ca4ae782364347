"""Figures of the detection experiment, drawn from its report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLUE, SENSOR_COLOURS
from bayesftc.reproduce.shared.calibration import OWN
from bayesftc.reproduce.shared.drawing import (
    FURTHER_STYLE,
    SWITCHING_STYLES,
    colour_bar,
    diagonal,
    figure,
    finish,
    heat_map,
    legend,
)
from bayesftc.reproduce.shared.residuals import LABELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RANKS_LIKE_BETA = "precision"
"""The learned precision ranks samples as beta does, because no sample is missing and all shapes are equal."""


def roc(report: dict[str, Any]) -> Figure:
    """Return the receiver operating characteristics on the test parts, with the paper's residuals and fault modes in front."""
    made = figure(8.4, 4.8)
    axis = made.subplots()
    false, auc = report["roc"]["false_positive_rate"], report["auc"]
    styles = {**SWITCHING_STYLES, "beta": {"color": BLUE, "lw": 2.8}, "SER": {"color": SENSOR_COLOURS[0], "lw": 2.2}}
    front = {name: styles[name] for name in styles if name in auc}
    further = sorted((n for n in auc if n not in {*front, RANKS_LIKE_BETA}), key=auc.__getitem__, reverse=True)
    for name in further:
        axis.plot(false, report["roc"]["true_positive_rate"][name], **FURTHER_STYLE)
    for name, style in front.items():
        axis.plot(false, report["roc"]["true_positive_rate"][name], label=_label(report, name), **style)
    diagonal(axis, "guessing: AUC 0.5")
    axis.set_aspect("equal", anchor="W")
    words = {"xlabel": "false positive rate (share of healthy samples)"}
    words |= {"ylabel": "true positive rate (share of faulty samples)"}
    title = f"Test parts of {len(report['streams'])} streams, two sensors pooled"
    finish(axis, title, xlim=(0, 1), ylim=(0, 1.005), **words)
    named = [*(_label(report, name) for name in front), "guessing: AUC 0.5"]
    legend(axis, named, "further residuals, with their AUC:", [f"{auc[name]:.3f}  {name}" for name in further])
    return made


def _label(report: dict[str, Any], name: str) -> str:
    paper = f" (paper {report['paper'][name]:.3f})" if name in report["paper"] else ""
    return f"{LABELS.get(name, name)}: AUC {report['auc'][name]:.3f}{paper}"


def grid(report: dict[str, Any]) -> Figure | None:
    """Return heat maps over faults and references, if they were run: the AUC of SER, of beta, and their difference."""
    if report["grid"] is None:
        return None
    cells = report["grid"]
    references = list(dict.fromkeys(c["reference"] for c in cells))
    injections, drifts = (sorted({c[name] for c in cells}) for name in ("injection", "drift"))
    known = {(c["reference"], c["injection"], c["drift"]): c["auc"] for c in cells}

    def values(reference: str, name: str) -> Any:
        return np.array([[known[reference, i, d][name] for d in drifts] for i in injections])

    made = figure(12.0, 2.7 * len(references) + 0.6)
    axes = made.subplots(len(references), 3, squeeze=False)
    largest = max(abs(c["auc"]["beta"] - c["auc"]["SER"]) for c in cells)
    least = min(min(c["auc"][n] for n in ("SER", "beta")) for c in cells)
    marks = [f"{i:g}" for i in injections], [f"{d:g}" for d in drifts]
    image = change = None
    for row, reference in zip(axes, references, strict=True):
        ours, base = values(reference, "beta"), values(reference, "SER")
        for axis, name, matrix in ((row[0], "SER", base), (row[1], "beta", ours)):
            image = heat_map(axis, matrix, *marks, "{:.3f}", vmin=least, vmax=1.0)
            axis.set_title(f"{name}, {reference} reference", fontsize=10, loc="left")
        change = heat_map(
            row[2], np.round(ours - base, 3) + 0.0, *marks, "{:+.3f}", cmap="PuOr_r", vmin=-largest, vmax=largest
        )
        row[2].set_title(f"beta - SER, {reference} reference", fontsize=10, loc="left")
        row[0].set_ylabel("injection (m/s)")
    for axis in axes[-1]:
        axis.set_xlabel("drift (m/s per second)")
    for shown, column, text in ((image, axes[:, :2], "AUC"), (change, axes[:, 2:], "difference in AUC")):
        colour_bar(made, shown, column.ravel().tolist(), text)
    return made


def calibration(report: dict[str, Any]) -> Figure:
    """Return the reliability diagram of the learners' (otherwise the classifiers') fault probabilities, in equal bins."""
    own = [name for name, of in report["calibration"].items() if of["of"] == OWN]
    names = own or list(report["paper"])
    made = figure(6.6, 5.4)
    axis, below = made.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    diagonal(axis, "calibrated")
    styles = [(BLUE, "o", "-"), *((colour, mark, "--") for colour, mark in zip(SENSOR_COLOURS, "svD^P", strict=False))]
    for name, (colour, mark, line) in zip(names, styles, strict=False):
        of = report["calibration"][name]
        bins = [b for b in of["diagram"]["equal_widths"] if b["ci"] is not None]
        x, y = ([b[key] for b in bins] for key in ("predicted", "observed"))
        error = np.abs(np.array([b["ci"] for b in bins]).T - y)
        label = f"{LABELS.get(name, name)}: ECE {of['ece']['mean']:.3f}"
        look = {"color": colour, "ls": line, **SWITCHING_STYLES.get(name, {}), "lw": 1.6, "marker": mark, "ms": 4.5}
        axis.errorbar(x, y, error, capsize=2.5, label=label, **look)
        below.plot(x, [100 * b["share"] for b in bins], **look)
    title = f"{len(report['streams'])} streams; bars: 95 % intervals; ECE: expected calibration error"
    finish(axis, title, ylim=(-0.03, 1.03), ylabel="share of faulty samples")
    axis.legend(frameon=False, fontsize=9, loc="upper left")
    finish(below, yscale="log", ylabel="% of samples", xlabel="fault probability")
    return made


FIGURES = {"detection_roc": roc, "detection_calibration": calibration, "detection_grid": grid}
