"""The printed output of ``bayesftc reproduce bound``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.experiments.detection.tables import KNOWS
from bayesftc.reproduce.shared.tables import Form, listed, sentence_list, written

if TYPE_CHECKING:
    from rich.console import RenderableType

MEAN, INTERVAL = "{mean:.4f}", "{ci[0]:.3f}-{ci[1]:.3f}"
COLUMNS: list[tuple[str, Form]] = [
    ("AUC", lambda row: written(row["of"], MEAN)),
    ("95 %", lambda row: written(row["of"], INTERVAL)),
    ("of bound", lambda row: written(row["ratio"], MEAN) if row["ratio"] else ""),
    ("95 %", lambda row: written(row["ratio"], INTERVAL) if row["ratio"] else ""),
]


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the AUC of each residual beside the bound's for each size of the faults, and how the bound converged."""
    streams = report["settings"]["streams"]
    yield (
        "The bound is the posterior of a filter with the true mean times to faults and recovery and the faults' sizes: no "
        f"detector ranks samples better. It has {report['particles']} hypotheses; with half as many the AUC of a stream changes "
        f"by at most {report['moved']:.4f} ("
        + sentence_list([f"{d['particles']}: {min(d['auc']):.4f} to {max(d['auc']):.4f}" for d in report["doublings"]])
        + ")."
    )
    for cell in report["cells"]:
        size = f"Injection {cell['injection']:g} m/s, drift {cell['drift']:g} m/s per second"
        rows = {name: {"of": of, "ratio": cell["ratio"].get(name)} for name, of in cell["auc"].items()}
        yield listed(f"{size}: mean over {streams} streams", rows, COLUMNS, corner="residual")
    yield KNOWS
    errors = [cell["calibration"]["ece"]["mean"] for cell in report["cells"]]
    yield f"The bound is calibrated: its expected calibration error is {min(errors):.4f} to {max(errors):.4f}."
