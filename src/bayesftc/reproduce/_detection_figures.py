"""Figures of the detection experiment, drawn from its report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.reproduce._drawing import COLOURS, figure, heat_map, legend, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(report: dict[str, Any]) -> dict[str, Figure]:
    """Return the figures by name."""
    made = {"detection_roc": roc(report)}
    if report["grid"] is not None:
        made["detection_grid"] = grid(report)
    return made


def roc(report: dict[str, Any]) -> Figure:
    """Return the receiver operating characteristics on the test parts, the paper's two residuals in front."""
    made = figure(8.4, 5.0)
    axis = made.subplots()
    false = report["roc"]["false_positive_rate"]
    names = sorted(report["auc"], key=report["auc"].__getitem__, reverse=True)
    for i, name in enumerate(n for n in names if n not in report["paper"]):
        style: dict[str, Any] = {"color": COLOURS[(i + 2) % len(COLOURS)], "ls": ("--", "-.", ":")[i % 3], "lw": 1.0}
        axis.plot(false, report["roc"]["true_positive_rate"][name], label=_label(report, name), **style)
    for name, colour in (("SER", COLOURS[1]), ("beta", COLOURS[0])):
        axis.plot(false, report["roc"]["true_positive_rate"][name], color=colour, lw=2.6, label=_label(report, name))
    axis.plot([0, 1], [0, 1], color="0.5", ls=":", lw=1.2, label="guessing: AUC 0.5")
    axis.set_xlim(0, 1)
    axis.set_ylim(0, 1.005)
    axis.set_aspect("equal")
    axis.set_xlabel("false positive rate (share of healthy samples)")
    axis.set_ylabel("true positive rate (share of faulty samples)")
    axis.set_title(f"Test parts of {len(report['streams'])} streams, two sensors pooled", fontsize=10, loc="left")
    tidy(axis)
    handles, labels = axis.get_legend_handles_labels()
    order = [*range(len(labels) - 2, len(labels) - 4, -1), *range(len(labels) - 3), len(labels) - 1]
    legend(axis, handles=[handles[i] for i in order], labels=[labels[i] for i in order])
    return made


def _label(report: dict[str, Any], name: str) -> str:
    paper = f" (paper {report['paper'][name]:.3f})" if name in report["paper"] else ""
    return f"{name}: AUC {report['auc'][name]:.3f}{paper}"


def grid(report: dict[str, Any]) -> Figure:
    """Return heat maps over faults and references: the AUC of SER, that of beta, and their difference."""
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
    image: Any = None
    change: Any = None
    for row, reference in zip(axes, references, strict=True):
        ours, base = values(reference, "beta"), values(reference, "SER")
        for axis, name, matrix in ((row[0], "SER", base), (row[1], "beta", ours)):
            image = heat_map(axis, matrix, *marks, "{:.3f}", vmin=least, vmax=1.0)
            axis.set_title(f"{name}, {reference} reference", fontsize=10, loc="left")
        change = heat_map(row[2], ours - base, *marks, "{:+.3f}", cmap="PuOr_r", vmin=-largest, vmax=largest)
        row[2].set_title(f"beta - SER, {reference} reference", fontsize=10, loc="left")
        row[0].set_ylabel("injection (m/s)")
    for axis in axes[-1]:
        axis.set_xlabel("drift (m/s per second)")
    for shown, column, text in ((image, axes[:, :2], "AUC"), (change, axes[:, 2:], "difference in AUC")):
        bar = made.colorbar(shown, ax=column.ravel().tolist(), pad=0.01, aspect=40)
        bar.set_label(text, fontsize=9)
        bar.outline.set_visible(False)
    return made
