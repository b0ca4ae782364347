"""Tables of the detection experiment about detectors: alarms at a threshold, and the calibration of fault probabilities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection.detectors import rule_of
from bayesftc.reproduce.shared.tables import crossed, listed

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
        "Per hour, its interval and the mean time between false alarms are of other fault-free runs. In alarm is the share of "
        "the fault-free time of the headline's streams that has one: there alarms also outlast their faults."
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
    yield "Delays count a missed fault as infinite: '-' says that more than half were missed, most of them over before an alarm."


def _seen(of: Mapping[str, Any]) -> str:
    return f"{_whole(of['delay_samples']['median'])}/{100 * of['missed_share']:.0f}"


def _whole(number: float | None) -> str:
    return "-" if number is None else f"{number:.0f}"


def show_calibration(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield how well the fault probabilities agree with the truth."""
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
        "In bins of equal counts, and beside it in bins of equal widths. A constant probability has a Brier score of "
        f"{constant:.3f}. The probability is the learner's own where it gives one, else that of the classifier that was fitted "
        "on the training part."
    )
