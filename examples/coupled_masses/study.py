"""Errors of each coupling scheme from the closed form, and its effect on the energy: numbers and a figure.

Run it with ``python -m bayesftc.examples.coupled_masses.study [figure.png]``. It builds one FMU, which needs a C compiler or the
extra ``fmus`` (ziglang).
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc import cosim
from bayesftc.cosim.judging.figures.plotting import BLACK, SENSOR_COLOURS
from bayesftc.examples.coupled_masses.masses import Masses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DAMPED = Masses(c=4.0)
FREE = Masses()
DURATION = 1.0
STEPS = (50, 100, 200, 400, 800, 1600)
"""Steps per second; the spring has about two periods in it."""
ERRORS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
COARSE = 20
"""Communication steps per second with step doubling, which chooses smaller steps in them."""

WAYS = {
    "Jacobi": cosim.Coupling("jacobi"),
    "Gauss-Seidel": cosim.Coupling("gauss-seidel"),
    "iterated, end held": cosim.Coupling("iterated", tolerance=1e-12),
    "iterated, mean held": cosim.Coupling("iterated", tolerance=1e-12, hold="mean"),
}
STYLES: dict[str, dict[str, Any]] = {
    "Jacobi": {"color": SENSOR_COLOURS[0], "lw": 3.2, "marker": "o", "ms": 9, "mfc": "none"},
    "Gauss-Seidel": {"color": SENSOR_COLOURS[1], "lw": 3.2, "marker": "s", "ms": 5},
    "iterated, end held": {"color": SENSOR_COLOURS[2], "lw": 1.4, "marker": "D", "ms": 4},
    "iterated, mean held": {"color": SENSOR_COLOURS[3], "lw": 1.4, "marker": "^", "ms": 5},
}
"""Where two lines coincide, the first is wide."""

Curve = dict[str, list[float]]


def convergence() -> Curve:
    """Return the largest error of a position (m) by coupling scheme and number of steps."""
    return {
        name: [DAMPED.error(DAMPED.diagram(f"1/{n}").build(way).simulate(DURATION)) for n in STEPS]
        for name, way in WAYS.items()
    }


def doubling() -> Curve:
    """Return the same with step doubling, by the tolerated error of one step."""
    return {
        name: [
            DAMPED.error(DAMPED.diagram(f"1/{COARSE}").build(way, step_error=error).simulate(DURATION))
            for error in ERRORS
        ]
        for name, way in WAYS.items()
    }


def energies(steps: int = 100, duration: float = 2.0) -> tuple[list[float], Curve, dict[str, float]]:
    """Return times, and without a damper the energy of the oscillation over time and the final speed of the centre of mass.

    Both are relative to their initial values.
    """
    curves, times, speeds = {}, [], {}
    for name, way in WAYS.items():
        run = FREE.diagram(f"1/{steps}").build(way).simulate(duration)
        energy = FREE.energy(*(run[signal] for signal in ("one.x", "two.x", "one.v", "two.v")))
        speed = FREE.together(run["one.v"], run["two.v"])
        curves[name], times, speeds[name] = list(energy / energy[0]), list(run.time), float(speed[-1] / speed[0])
    return times, curves, speeds


def orders(errors: Curve) -> dict[str, float]:
    """Return the order of convergence: the slope between the two finest steps."""
    return {name: float(np.log2(e[-2] / e[-1])) for name, e in errors.items()}


def figure(errors: Curve, doubled: Curve, times: list[float], energy: Curve) -> Figure:
    """Return the figure of all three."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(12.5, 4.2), layout="constrained")
    FigureCanvasAgg(made)
    left, middle, right = made.subplots(1, 3)
    h = 1.0 / np.array(STEPS)
    for name in WAYS:
        style = STYLES[name]
        label = f"{name} (order {orders(errors)[name]:.2f})"
        left.loglog(h, errors[name], **style, label=label)
        middle.loglog(ERRORS, doubled[name], **style, label=name)
        right.plot(times, energy[name], color=style["color"], lw=style["lw"], label=name)
    for axis, x, curves, slopes in (
        (left, h, errors, {1: "$h$", 2: "$h^2$"}),
        (middle, np.array(ERRORS), doubled, {1 / 2: "error$^{1/2}$", 2 / 3: "error$^{2/3}$"}),
    ):
        for slope, name in slopes.items():
            ends = np.array([x.min(), x.max()])
            reference = curves["iterated, mean held" if slope not in {1, 1 / 2} else "Jacobi"][-1]
            line = 0.4 * reference * (ends / x[-1]) ** slope
            axis.loglog(ends, line, color=BLACK, ls=":", lw=1.0)
            axis.annotate(name, (ends[0], line[0]), textcoords="offset points", xytext=(14, -4), fontsize=9)
    left.set(xlabel="step h (s)", ylabel="largest error of a position (m)", title="Steps of one size")
    middle.set(
        xlabel="step_error: tolerated error of one step (m, m/s)",
        ylabel="largest error of a position (m)",
        title=f"Steps chosen by doubling, within {1000 // COARSE} ms",
    )
    right.set(xlabel="time (s)", ylabel="energy / initial energy", title="Oscillation without a damper, steps of 10 ms")
    right.set_ylim(0.0, 2.2)
    right.axhline(1.0, color=BLACK, ls=":", lw=1.0)
    for axis, place in ((left, "lower right"), (middle, "lower right"), (right, "upper left")):
        axis.grid(True, which="major", color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        axis.legend(fontsize=8, loc=place, frameon=True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    return made


def main(path: str | None = None) -> dict[str, float]:
    """Print the errors and the energy at the end, write the figure if a path is given, and return the orders."""
    errors = convergence()
    order_of = orders(errors)
    print(f"{'largest error (mm), steps of':30}" + "".join(f"{1e3 / n:>9.3g} ms" for n in STEPS) + "    order")
    for name, row in errors.items():
        print(f"{name:30}" + "".join(f"{1e3 * e:>12.4g}" for e in row) + f"{order_of[name]:>9.2f}")
    doubled = doubling()
    print(f"{'largest error (mm), step_error':30}" + "".join(f"{e:>12.0e}" for e in ERRORS))
    for name, row in doubled.items():
        print(f"{name:30}" + "".join(f"{1e3 * e:>12.4g}" for e in row))
    times, energy, speeds = energies()
    print(f"{'after 2 s (%)':30}{'energy':>24}{'speed of the centre of mass':>32}")
    for name, row in energy.items():
        print(f"{name:30}{100 * row[-1]:>24.4g}{100 * speeds[name]:>32.4g}")
    if path:
        figure(errors, doubled, times, energy).savefig(path, dpi=120)
    return order_of


if __name__ == "__main__":
    main(*sys.argv[1:2])
