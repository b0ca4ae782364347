"""The printed output of ``bayesftc reproduce detection``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection import filterpy as _filterpy
from bayesftc.reproduce.experiments.detection.detectors import rule_of
from bayesftc.reproduce.shared.tables import Form, crossed, listed

if TYPE_CHECKING:
    from rich.console import RenderableType

KNOWS = (
    "SwitchingPrecision, also per sensor, has the true mean times to a fault and to recovery as settings, but not the sizes of "
    "the faults. With default settings it has neither."
)
EDGE = 0.002
"""Least difference in AUC that counts."""
SAME_AS_BETA = "precision"
"""The residual that ranks samples as beta does."""


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the AUC of all residuals and the paper's, its two residuals by stream, calibration, alarms, and the grid."""
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
        yield "The precision ranks the samples as beta does, because all shapes are equal: it is the same residual."
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
    """Return both areas with three digits and without leading zeros: a row has five pairs."""
    return "/".join(f"{auc[name]:.3f}".removeprefix("0") for name in ("beta", "SER"))


def show_alarms(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield false alarms, delays and misses for the first of the rates that set thresholds."""
    alarms, step = report["alarms"], report["settings"]["car"]["step"]
    rate = report["settings"]["false_alarm_rates"][0]
    rule, headline = rule_of(rate), alarms["cells"][0]
    names = [name for name in alarms["fault_free"] if name != SAME_AS_BETA]
    yield listed(
        f"False alarms, thresholds set for {rate:g} per hour of a sensor on fault-free runs",
        {n: {**alarms["fault_free"][n][rule], "faulty": headline["residuals"][n][rule]["all"]} for n in names},
        [
            ("per hour", "{false_alarms_per_hour:.2f}"),
            ("95 %", "{false_alarms_per_hour_ci[0]:.2f}-{false_alarms_per_hour_ci[1]:.2f}"),
            ("s between", lambda of: _whole(of["seconds_between_false_alarms"])),
            ("in alarm", lambda of: f"{100 * of['faulty']['false_share']:.2g} %"),
        ],
        corner="residual",
    )
    yield (
        "The rate per hour, its interval and the mean time between false alarms are from other fault-free runs. In alarm: share "
        "of the fault-free time of the headline's streams with an alarm; there alarms also outlast their faults."
    )
    sizes = sorted(alarms["cells"], key=lambda cell: cell["injection"])
    for kind, unit in (("injection", "m/s"), ("drift", "m/s per second")):
        title = f"{kind.capitalize()} of ... {unit}: median delay in samples of {step:g} s / missed faults in %"
        rows = {n: {f"{cell[kind]:.3g}": cell["residuals"][n][rule][kind] for cell in sizes} for n in names}
        yield from crossed(title, rows, _seen, corner="residual")
    yield listed(
        "Freeze: the same",
        {name: headline["residuals"][name][rule]["freeze"] for name in names},
        [
            ("delay/missed", _seen),
            ("95 %", lambda of: "-".join(map(_whole, of["delay_samples"]["ci"]))),
            ("95 %", lambda of: "-".join(f"{100 * share:.0f}" for share in of["missed_ci"])),
        ],
        corner="residual",
    )
    yield "A missed fault has an infinite delay: '-' means that more than half were missed, most of which ended before an alarm."


def _seen(of: Mapping[str, Any]) -> str:
    return f"{_whole(of['delay_samples']['median'])}/{100 * of['missed_share']:.0f}"


def _whole(number: float | None) -> str:
    return "-" if number is None else f"{number:.0f}"


def show_calibration(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the calibration of the fault probabilities."""
    yield listed(
        "Calibration of the fault probability: expected calibration error (ECE) and Brier score",
        {name: of for name, of in report["calibration"].items() if name != SAME_AS_BETA},
        [
            ("ECE", "{ece[mean]:.4f}"),
            ("95 % interval", "{ece[ci][0]:.4f} to {ece[ci][1]:.4f}"),
            ("widths", "{ece_equal_widths[mean]:.4f}"),
            ("Brier", "{brier[mean]:.4f}"),
        ],
        corner="residual",
    )
    constant = next(iter(report["calibration"].values()))["brier_of_constant"]["mean"]
    yield (
        "ECE is in bins of equal counts, and in the column 'widths' in bins of equal widths. A constant probability has a Brier "
        f"score of {constant:.3f}. The probability is from the learner if it gives one, otherwise from the classifier fitted to "
        "the training part."
    )
