"""What ``bayesftc reproduce detection`` prints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection import filterpy as _filterpy
from bayesftc.reproduce.experiments.detection.detectors_tables import show_alarms, show_calibration
from bayesftc.reproduce.shared.tables import Form, crossed, listed

if TYPE_CHECKING:
    from rich.console import RenderableType

KNOWS = (
    "SwitchingPrecision, also per sensor, knows the mean times to a fault and to recovery, but not how large faults are; with "
    "default settings it knows neither."
)
EDGE = 0.002
"""A difference in AUC that is worth a word."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the AUC of all residuals beside the paper's, the paper's two stream by stream, calibration, alarms, and the grid."""
    settings, auc, papers = report["settings"], report["auc"], report["paper"]
    faults, beta = settings["faults"], settings["beta"]
    yield (
        f"Common factor f = {settings['f']:.3f}, with which the state estimation residual (SER) has an AUC of "
        f"{settings['f_auc']:.3f} on other streams: injection {faults['injection']:.2f} m/s, drift {faults['drift']:.2f} m/s per "
        f"second. Beta's forgetting {beta['forgetting']:g} and prior shape {beta['prior_shape']:g} have the highest AUC on the "
        "training parts."
    )
    yield listed(
        f"AUC on the test parts, mean over {len(report['streams'])} streams",
        {name: name for name in auc},
        [
            ("AUC", lambda name: f"{auc[name]:.4f}"),
            ("95 % interval", lambda name: "{:.4f} to {:.4f}".format(*report["auc_ci"][name])),
            ("paper", lambda name: f"{papers[name]:.3f}" if name in papers else ""),
        ],
        corner="residual",
    )
    if "SwitchingPrecision" in auc:
        yield KNOWS
    if "precision" in auc:
        yield "The precision ranks the samples as beta does, for all shapes are the same: it is the same residual."
    low, high = report["difference"]["ci"]
    yield (
        f"Beta minus SER, stream by stream: {report['difference']['mean']:.4f}, 95 % interval {low:.4f} to {high:.4f}; "
        f"{'zero is not in it' if low > 0 or high < 0 else 'zero is in it'}."
    )
    columns: list[tuple[str, Form]] = [("faults", "{faults}"), ("SER", "{auc[SER]:.4f}"), ("beta", "{auc[beta]:.4f}")]
    yield listed("Stream by stream", dict(enumerate(report["streams"])), columns, corner="stream")
    yield _filterpy.show_detection(report["filterpy"])
    yield from show_calibration(report)
    if report["alarms"] is not None:
        yield from show_alarms(report)
    if report["grid"] is not None:
        yield from _grid(report["grid"])


def _grid(cells: list[dict[str, Any]]) -> Iterator[RenderableType]:
    known = {(c["reference"], c["injection"], c["drift"]): c["auc"] for c in cells}
    references = dict.fromkeys(c["reference"] for c in cells)
    injections, drifts = (sorted({c[name] for c in cells}) for name in ("injection", "drift"))
    for reference in references:
        title = f"AUC of beta/SER on the {reference} reference; injection in m/s, drift in m/s per second"
        rows = {f"{i:g}": {d: known[reference, i, d] for d in drifts} for i in injections}
        yield from crossed(title, rows, _pair, head="drift {:g}", corner="injection")
    for reference in references:
        mine = [c for c in cells if c["reference"] == reference]
        wins = sum(c["auc"]["beta"] > c["auc"]["SER"] + EDGE for c in mine)
        losses = sum(c["auc"]["beta"] < c["auc"]["SER"] - EDGE for c in mine)
        yield (
            f"On the {reference} reference beta is above SER by more than {EDGE:g} in {wins} of {len(mine)} cells, and below it "
            f"by as much in {losses}."
        )
    worst = min(cells, key=lambda c: c["auc"]["beta"] - c["auc"]["SER"])
    gap = worst["auc"]["SER"] - worst["auc"]["beta"]
    if gap > 0:
        yield (
            f"Beta loses most, by {gap:.3f}, on the {worst['reference']} reference with an injection of {worst['injection']:g} "
            f"m/s and a drift of {worst['drift']:g} m/s per second."
        )


def _pair(auc: dict[str, float]) -> str:
    """Return both areas with three digits and without their leading zeros: five pairs stand beside each other."""
    return "/".join(f"{auc[name]:.3f}".removeprefix("0") for name in ("beta", "SER"))
