"""How often the true parameters are within two standard errors: 100 recordings of each kind.

    python -m bayesftc.examples.fitted_car.study fit_coverage.png     # prints a table, draws the figure; some minutes

Errors in units of the standard error should be standard normal: within 2 in 95.4 % of cases.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from scipy.stats import norm

from bayesftc import cosim
from bayesftc.cosim.types import Floats
from bayesftc.examples.fitted_car.recordings import CAR, NAMES, NOISE, RANGES, TRUE, recording, with_faults

KINDS: dict[str, dict[str, Any]] = {
    "no fault": {},
    "a fault and a gap": {"faulty": True},
    "a fault and a gap, all samples count": {"faulty": True, "weigh": None},
    "coloured noise (0.8)": {"colour": 0.8},
    "coloured noise, a fault and a gap": {"colour": 0.8, "faulty": True},
}


def errors(
    *,
    faulty: bool = False,
    colour: float = 0.0,
    offset: float = 0.0,
    weigh: Any = "learner",
    count: int = 100,
    rows: int = 1500,
) -> Floats:
    """Return the errors of the parameters in standard errors (count x parameters).

    Parameters
    ----------
    faulty : bool
        Whether each recording has a fault and a gap.
    colour : float
        Autocorrelation of the noise.
    offset : float
        Constant offset of the second sensor, in standard deviations of the noise.
    weigh : "learner", callable or None
        As for `cosim.fit`.
    count, rows : int
        Number of recordings, and of rows of each.
    """
    found = []
    for seed in range(count):
        table = recording(seed, rows, colour=colour)
        table["v1"] += offset * NOISE
        fitted = cosim.fit(
            CAR, with_faults(table, seed) if faulty else table, RANGES, **NAMES, held_out=0.0, weigh=weigh
        )
        found.append([(fitted.parameters[name] - value) / fitted.std[name] for name, value in TRUE.items()])
    return np.array(found)


def draw(found: dict[str, Floats], file: str) -> None:
    """Draw the share of errors within each multiple of the standard error, beside that of normal errors."""
    from bayesftc.cosim.judging.figures.panels import bare_figure
    from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, LINES, SENSOR_COLOURS

    figure = bare_figure()
    figure.set_size_inches(7.0, 3.6)
    figure.set_layout_engine("constrained")
    axis = figure.add_subplot()
    places = np.linspace(0.0, 5.0, 201)
    axis.plot(places, 2 * norm.cdf(places) - 1, color=BLACK, lw=2.5, alpha=0.35, label="normal errors")
    for i, (kind, z) in enumerate(found.items()):
        share = np.mean(np.abs(z).ravel()[:, None] <= places, axis=0)
        axis.plot(places, share, LINES[i % len(LINES)], color=(BLUE, *SENSOR_COLOURS)[i], lw=1.2, label=kind)
    axis.axvline(2.0, color="0.7", lw=0.8)
    axis.set(
        xlim=(0, 5), ylim=(0, 1.01), xlabel="standard errors from the true value", ylabel="share of parameters within"
    )
    axis.legend(fontsize=8, frameon=False, loc="lower right")
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.savefig(file, dpi=150)


def main() -> None:
    """Print the table; with a name of a file, draw the figure."""
    found = {}
    print(f"{'':40}{'within 2':>10}{'spread':>8}")
    for kind, settings in KINDS.items():
        z = found[kind] = errors(**settings)
        print(f"{kind:40}{np.mean(np.abs(z) < 2):>10.1%}{z.std():>8.2f}", flush=True)
    if len(sys.argv) > 1:
        draw(found, sys.argv[1])


if __name__ == "__main__":
    main()
