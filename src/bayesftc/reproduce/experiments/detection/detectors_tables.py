"""Tables of the detection experiment about detectors: alarms at a threshold, and the calibration of fault probabilities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection.detectors import rule_of
from bayesftc.reproduce.shared.tables import table

if TYPE_CHECKING:
    from rich.console import RenderableType

SAME_AS_BETA = "precision"
"""It ranks as beta does."""


def show_alarms(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield false alarms, delays and misses at the first of the rates at which thresholds were set."""
    alarms, step = report["alarms"], report["settings"]["car"]["step"]
    rate = report["settings"]["false_alarm_rates"][0]
    rule, headline = rule_of(rate), alarms["cells"][0]
    names = [name for name in alarms["fault_free"] if name != SAME_AS_BETA]
    yield table(
        f"False alarms, thresholds set for {rate:g} per hour of a sensor on fault-free runs",
        ["per hour", "95 %", "s between", "in alarm"],
        {name: _false(alarms["fault_free"][name][rule], headline["residuals"][name][rule]["all"]) for name in names},
        corner="residual",
    )
    yield (
        "Per hour, its interval and the mean time between false alarms are of other fault-free runs. In alarm is the share of "
        "the fault-free time of the headline's streams that has one: there alarms also outlast their faults."
    )
    sizes = sorted(alarms["cells"], key=lambda cell: cell["injection"])
    for kind, unit in (("injection", "m/s"), ("drift", "m/s per second")):
        columns = {f"{cell[kind]:.3g}": {name: cell["residuals"][name][rule][kind] for name in names} for cell in sizes}
        yield table(
            f"{kind.capitalize()} of ... {unit}: median delay in samples of {step:g} s / missed faults in %",
            list(columns),
            {name: [_seen(cell[name]) for cell in columns.values()] for name in names},
            corner="residual",
        )
    yield table(
        "Freeze: the same",
        ["delay/missed", "95 %", "95 %"],
        {name: _seen_with_intervals(headline["residuals"][name][rule]["freeze"]) for name in names},
        corner="residual",
    )
    yield "Delays count a missed fault as infinite: '-' says that more than half were missed, most of them over before an alarm."


def _false(healthy: Mapping[str, Any], faulty: Mapping[str, Any]) -> list[str]:
    between = healthy["seconds_between_false_alarms"]
    return [
        f"{healthy['false_alarms_per_hour']:.2f}",
        "{:.2f}-{:.2f}".format(*healthy["false_alarms_per_hour_ci"]),
        "-" if between is None else f"{between:.0f}",
        f"{100 * faulty['false_share']:.2g} %",
    ]


def _seen(of: Mapping[str, Any]) -> str:
    return f"{_samples(of['delay_samples']['median'])}/{100 * of['missed_share']:.0f}"


def _seen_with_intervals(of: Mapping[str, Any]) -> list[str]:
    low, high = of["delay_samples"]["ci"]
    return [
        _seen(of),
        f"{_samples(low)}-{_samples(high)}",
        "{:.0f}-{:.0f}".format(*(100 * share for share in of["missed_ci"])),
    ]


def _samples(delay: float | None) -> str:
    return "-" if delay is None else f"{delay:.0f}"


def show_calibration(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield how well the fault probabilities agree with the truth."""
    yield table(
        "Calibration of the fault probability: expected calibration error (ECE) and Brier score",
        ["ECE", "95 % interval", "widths", "Brier"],
        {
            name: [
                f"{of['ece']['mean']:.4f}",
                "{:.4f} to {:.4f}".format(*of["ece"]["ci"]),
                f"{of['ece_equal_widths']['mean']:.4f}",
                f"{of['brier']['mean']:.4f}",
            ]
            for name, of in report["calibration"].items()
            if name != SAME_AS_BETA
        },
        corner="residual",
    )
    constant = next(iter(report["calibration"].values()))["brier_of_constant"]["mean"]
    yield (
        "In bins of equal counts, and beside it in bins of equal widths. A constant probability has a Brier score of "
        f"{constant:.3f}. The probability is the learner's own where it gives one, else that of the classifier that was fitted "
        "on the training part."
    )
