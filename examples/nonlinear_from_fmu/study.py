"""Where the FMU's own equations are better than a linear design, and where not: arm and pendulum on a cart, the same noise.

    python -m bayesftc.examples.nonlinear_from_fmu.study 20 nonlinear_from_fmu.png    # prints two tables, draws the figure

The arm swings with a growing amplitude. The pendulum begins at a growing angle. A run is lost if a joint of the arm is more
than 1 rad from its goal, or if the pendulum falls below the horizontal.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import binomtest

from bayesftc.cosim.errors import SimulationError
from bayesftc.cosim.statistics import interval
from bayesftc.cosim.types import Floats
from bayesftc.examples.nonlinear_from_fmu.loops import (
    DESIGN,
    FMU,
    LOAD,
    PERIOD,
    SAME_GOALS,
    arm_controller,
    arm_errors,
    arm_loop,
    cart_controller,
    cart_loop,
)

AMPLITUDES = (0.1, 0.5, 1.0, 1.5, 2.0, 2.5)
ANGLES = (0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6)
ARM_WAYS = (FMU, SAME_GOALS, DESIGN, LOAD)
CART_WAYS = (FMU, DESIGN)

Outcome = tuple[float, bool]
"""The RMS error of a run, and whether it is lost."""


def arm_runs(way: str, amplitude: float, seeds: Sequence[int]) -> list[Outcome]:
    """Return the outcome of each run of the arm: the error of both joints in rad."""
    loop = arm_loop(arm_controller(way), amplitude)
    found = []
    for seed in seeds:
        errors = arm_errors(loop.simulate(2 * PERIOD, seed=seed), amplitude)
        found.append((float(np.sqrt((errors**2).mean())), bool(np.abs(errors).max() > 1.0)))
    return found


def cart_runs(way: str, angle: float, seeds: Sequence[int]) -> list[Outcome]:
    """Return the outcome of each run of the cart: the error of its position in m."""
    loop = cart_loop(cart_controller(way, angle), angle)
    found = []
    for seed in seeds:
        try:
            result = loop.simulate(6.0, seed=seed)
        except SimulationError:  # numbers beyond all bounds
            found.append((np.inf, True))
            continue
        lost = bool(np.abs(result["plant.angle"]).max() > np.pi / 2)
        found.append((float(np.sqrt((result["plant.position"] ** 2).mean())), lost))
    return found


Table = dict[str, dict[float, list[Outcome]]]


def study(
    runs: Callable[[str, float, Sequence[int]], list[Outcome]], ways: Sequence[str], sizes: Sequence[float], count: int
) -> Table:
    """Return the outcomes of all runs by controller and size."""
    seeds = range(count)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a linear design that does not fit says so
        return {way: {size: runs(way, size, seeds) for size in sizes} for way in ways}


def cell(outcomes: Sequence[Outcome]) -> str:
    """Return the mean error in mrad or mm with its 95 % interval over the runs that are not lost, and the share of lost ones."""
    errors = 1e3 * np.array([error for error, lost in outcomes if not lost])
    lost = len(outcomes) - len(errors)
    low, high = binomtest(lost, len(outcomes)).proportion_ci()
    share = f"{100 * lost / len(outcomes):.0f} % lost ({100 * low:.0f} to {100 * high:.0f})" if lost else ""
    if len(errors) < 2:
        return share
    mean, (below, _) = errors.mean(), interval(errors)
    return f"{mean:.2f} ± {mean - below:.2f}" + (f", {share}" if share else "")


def show(title: str, table: Table) -> None:
    """Print a table in Markdown."""
    print(f"| {title} | {' | '.join(table)} |\n|{'---|' * (len(table) + 1)}")
    for size in next(iter(table.values())):
        print(f"| {size:g} | {' | '.join(cell(found[size]) for found in table.values())} |")
    print()


def draw(arm: Table, cart: Table, file: str) -> None:
    """Draw the arm's errors, and the share of pendulums that fall."""
    from bayesftc.cosim.judging.figures.panels import bare_figure
    from bayesftc.cosim.judging.figures.plotting import BLUE, LINES, SENSOR_COLOURS

    figure = bare_figure()
    figure.set_size_inches(9.0, 3.6)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2)
    colours = dict(zip(ARM_WAYS, (BLUE, *SENSOR_COLOURS), strict=False))
    for i, (way, found) in enumerate(arm.items()):
        kept = {size: [e for e, lost in outcomes if not lost] for size, outcomes in found.items()}
        sizes = [size for size, errors in kept.items() if len(errors) > 1]
        means: Floats = np.array([np.mean(kept[size]) for size in sizes])
        bars = [float(np.mean(kept[size]) - interval(np.array(kept[size]))[0]) for size in sizes]
        left.errorbar(sizes, means, bars, linestyle=LINES[i % len(LINES)], color=colours[way], label=way, capsize=2)
    for i, (way, found) in enumerate(cart.items()):
        shares = [100 * np.mean([lost for _, lost in outcomes]) for outcomes in found.values()]
        right.plot(list(found), shares, LINES[i % len(LINES)], color=colours[way], label=way, marker=".")
    left.set(yscale="log", xlabel="amplitude of the arm (rad)", ylabel="RMS error (rad)")
    right.set(xlabel="first angle of the pendulum (rad)", ylabel="lost runs (%)", ylim=(-2, 102))
    for axis in (left, right):
        axis.legend(fontsize=8, frameon=False)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    figure.savefig(file, dpi=150)


def main() -> None:
    """Print both tables; with a name of a file, draw the figure."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    arm = study(arm_runs, ARM_WAYS, AMPLITUDES, count)
    show("amplitude (rad): error in mrad", arm)
    cart = study(cart_runs, CART_WAYS, ANGLES, count)
    show("first angle (rad): error in mm", cart)
    if len(sys.argv) > 2:
        draw(arm, cart, sys.argv[2])


if __name__ == "__main__":
    main()
