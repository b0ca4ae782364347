"""The printed output of ``bayesftc reproduce arm``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce.shared.tables import crossed, listed, table

if TYPE_CHECKING:
    from rich.console import RenderableType

LABELS = {
    "none": "no fault tolerance",
    "implicit": "PL, always on",
    "explicit": "PL, on detection",
    "deterministic": "fault known",
    "switching": "SwitchingPrecision",
}
JOINTS = {"faulty": "joint with frozen encoder", "healthy": "joint with healthy encoder"}


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the errors beside the paper's, the results of the detection, and the effect of unpublished settings."""
    yield _errors(report)
    settings = report["settings"]
    names = {
        "explicit": f"The explicit detection (Chebyshev, alpha {settings['alpha']:g}, on encoders and camera)",
        "switching": f"SwitchingPrecision ({', '.join(settings['fault_modes'])}; a fault probability of one half)",
    }
    for name, result in report["detection"].items():
        missed = "in no run" if not result["missed"] else f"in {result['missed']} of {result['n']} runs"
        yield (
            f"{names[name]} detects the frozen encoder after {result['delay_mean'] * 1e3:.0f} ms on average and misses it "
            f"{missed}. Without a fault it blames a sensor in {100 * result['healthy_share']:.2g} % of the time."
        )
    if report["grid"] is not None:
        yield from _grid(report)


def _errors(report: dict[str, Any]) -> RenderableType:
    def cell(technique: str, joint: str) -> str:
        ours, papers = report["mse"][technique][joint], report["paper"].get(technique)
        low, high = ours["ci"]
        return f"{ours['mean']:.2e} ± {(high - low) / 2:.0e}" + (f" ({papers[joint]:.2e})" if papers else " " * 11)

    title = (
        f"Mean squared error of the belief about a joint (rad^2), mean over {report['settings']['runs']} runs ± 95 %, in "
        "brackets the paper's (with the fault known, its predecessor's); PL is precision learning"
    )
    rows = {label: [cell(name, joint) for joint in JOINTS] for name, label in LABELS.items() if name in report["mse"]}
    return table(title, list(JOINTS.values()), rows)


def _grid(report: dict[str, Any]) -> Iterator[RenderableType]:
    forms = {
        "switch": "{:g} s",
        "camera_precision": "precision {:g}",
        "learning_rate": "{:g}",
        "lower_bound": "bound {:g}",
    }
    titles = {
        "none": "No fault tolerance: switch of the goal and precision of the camera",
        "implicit": "PL, always on: learning rate and lower bound of the precision",
    }
    for kind, title in titles.items():
        down, across = (name for name in report["grid"][kind][0] if name in forms)
        cells = {(c[down], c[across]): c for c in report["grid"][kind]}
        rows, columns = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
        table_of = {forms[down].format(r): {c: cells[r, c] for c in columns} for r in rows}
        what = f"{title}; error of the joint with the frozen encoder / the other, 1e-6 rad^2"
        yield from crossed(what, table_of, _millionths, head=forms[across], corner=down.replace("_", " "))
    if further := report["grid"]["switching"]:
        yield listed(
            "SwitchingPrecision with further modes, which show in the error of the belief: joint with the frozen encoder / the "
            "other, rad^2",
            {", ".join(cell["fault_modes"]): cell for cell in further},
            [("error", "{faulty:.2g} / {healthy:.2g}")],
            corner="modes",
        )


def _millionths(cell: dict[str, float]) -> str:
    errors = [cell[joint] for joint in JOINTS]
    return " / ".join(f"{1e6 * error:.{0 if error > 1e-5 else 1}f}" for error in errors)
