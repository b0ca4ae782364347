"""What ``bayesftc reproduce bound`` prints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection.tables import KNOWS
from bayesftc.reproduce.shared.tables import sentence_list, table

if TYPE_CHECKING:
    from rich.console import RenderableType


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the AUC of each residual beside the bound's for each size of the faults, and how the bound converged."""
    streams = report["settings"]["streams"]
    yield (
        "The bound is the posterior of a filter that knows how often faults come and go and how large they are: no detector "
        f"ranks better. It keeps {report['particles']} hypotheses; half as many change the AUC of no stream by more than "
        f"{report['moved']:.4f} ("
        + sentence_list([f"{d['particles']}: {min(d['auc']):.4f} to {max(d['auc']):.4f}" for d in report["doublings"]])
        + ")."
    )
    for cell in report["cells"]:
        yield table(
            f"Injection {cell['injection']:g} m/s, drift {cell['drift']:g} m/s per second: mean over {streams} streams",
            ["AUC", "95 %", "of bound", "95 %"],
            {name: _row(cell, name) for name in cell["auc"]},
            corner="residual",
        )
    yield KNOWS
    errors = [cell["calibration"]["ece"]["mean"] for cell in report["cells"]]
    yield f"The bound is calibrated: its expected calibration error is {min(errors):.4f} to {max(errors):.4f}."


def _row(cell: dict[str, Any], name: str) -> list[str]:
    shown = [cell["auc"][name], *([cell["ratio"][name]] if name in cell["ratio"] else [])]
    return [text for of in shown for text in (f"{of['mean']:.4f}", "{:.3f}-{:.3f}".format(*of["ci"]))]
