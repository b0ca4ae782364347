"""What ``bayesftc reproduce arm`` prints."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce._tables import table

if TYPE_CHECKING:
    from rich.console import RenderableType

LABELS = {
    "none": "no fault tolerance",
    "implicit": "PL, always on",
    "explicit": "PL, on detection",
    "deterministic": "told of the fault",
}
JOINTS = {"faulty": "joint with frozen encoder", "healthy": "joint with healthy encoder"}


def show(report: dict[str, Any]) -> Iterator[RenderableType]:
    """Yield the errors beside the paper's, how the explicit detection did, and what unpublished settings are worth."""
    yield _errors(report)
    found, settings = report["detection"], report["settings"]
    missed = "in no run" if not found["missed"] else f"in {found['missed']} of {found['n']} runs"
    yield (
        f"The explicit detection (Chebyshev, alpha {settings['alpha']:g}, on encoders and camera) finds the frozen encoder after "
        f"{found['delay_mean'] * 1e3:.0f} ms on average and misses it {missed}; without a fault it sees one in "
        f"{100 * found['healthy_share']:.2g} % of the time."
    )
    if report["grid"] is not None:
        yield from _grid(report)


def _errors(report: dict[str, Any]) -> RenderableType:
    def cell(technique: str, joint: str) -> str:
        ours, papers = report["mse"][technique][joint], report["paper"][technique][joint]
        low, high = ours["ci"]
        return f"{ours['mean']:.2e} ± {(high - low) / 2:.0e} ({papers:.2e})"

    title = (
        f"Mean squared error of the belief about a joint (rad^2), mean over {report['settings']['runs']} runs ± 95 %, in "
        "brackets the paper's (the last row its predecessor's); PL is precision learning"
    )
    rows = {label: [cell(name, joint) for joint in JOINTS] for name, label in LABELS.items()}
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
        yield table(
            f"{title}; error of the joint with the frozen encoder / the other, 1e-6 rad^2",
            [forms[across].format(column) for column in columns],
            {
                forms[down].format(row): [
                    f"{_millionths(cells[row, column]['faulty'])} / {_millionths(cells[row, column]['healthy'])}"
                    for column in columns
                ]
                for row in rows
            },
            corner=down.replace("_", " "),
        )


def _millionths(value: float) -> str:
    return f"{1e6 * value:.{0 if value > 1e-5 else 1}f}"
