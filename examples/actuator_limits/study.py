"""A car whose engine has limits: integral action winds up at them, unless the controller knows them.

Run it with ``python -m bayesftc.examples.actuator_limits.study [figure.png]``. A PI controller and an `LQGController` with an
estimated load drive the same car to the same speeds, each with and without knowledge of the limits. It prints overshoot and
settling time. All four have the same sensor noise.
"""

import sys
from pathlib import Path
from typing import Literal

import control
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayesftc import controllers, cosim
from bayesftc.cosim.block import Block
from bayesftc.cosim.judging.figures.plotting import BLUE, SENSOR_COLOURS

DT = 0.1
LOW, HIGH = -1500.0, 1500.0
"""N: limits of engine and brakes."""
FAST, SLOW = 25.0, 10.0
"""m/s: the goal from 1 s on, and from 80 s on."""
END = 140.0
BAND = 0.5
"""m/s: the speed has settled when it stays within this distance of the goal."""

CAR = control.ss([[-0.04]], [[1e-3]], [[1.0]], 0, inputs=["force"], outputs=["v"])
"""1000 kg, with a drag of 40 N per m/s."""
LOAD = 150.0
"""N: headwind, which no controller knows."""


def pi(low: float = -np.inf, high: float = np.inf) -> Block:
    """Return a PI controller whose integral stays within limits, as the integrator's settings say."""
    inside = cosim.Diagram(DT)
    error = inside.add(cosim.Sum("+-"), "error")
    proportional, rate = inside.add(cosim.Gain(600.0), "proportional"), inside.add(cosim.Gain(60.0), "rate")
    integral = inside.add(cosim.Integrator(low=low, high=high), "integral")
    total = inside.add(cosim.Sum("++"), "total")
    inside.connect(error["y"], proportional["u"])
    inside.connect(error["y"], rate["u"])
    inside.connect(rate["y"], integral["u"])
    inside.connect([proportional["y"], integral["y"]], total["u"])
    return cosim.Subsystem(inside, inputs={"goal": "error.u[0]", "y": "error.u[1]"}, outputs={"u": "total.y"})


def lqg(low: float = -np.inf, high: float = np.inf) -> Block:
    """Return the regulator with an estimated load, whose prediction uses the limited control."""
    noise, variance = 1e-4, 0.05**2
    model = controllers.LinearModel.from_control(CAR, process_covariance=noise, sensor_covariance=variance, dt=DT)
    return controllers.LQGController(
        model.with_disturbance(15.0**2),
        goal_covariance=0.5**2,
        control_covariance=500.0**2,
        u_min=low,
        u_max=high,
        initial_covariance=[0.01, 100.0**2],
        precision=controllers.FixedPrecision(),
    )


CONTROLLERS = {
    "PI, limits not known": pi,
    "PI, integrator with limits": lambda: pi(LOW, HIGH),
    "LQG, limits not known": lqg,
    "LQG with u_min, u_max": lambda: lqg(LOW, HIGH),
}


def make_loop(name: str) -> cosim.Diagram:
    """Return the loop of a controller; the engine clips what it gets, whatever the controller knows."""
    plant = control.ss(CAR.A, np.hstack([CAR.B, CAR.B]), CAR.C, 0, inputs=["force", "load"], outputs=["v"])
    return cosim.closed_loop(
        cosim.StateSpace(plant),
        CONTROLLERS[name](),
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=1, std=0.05),
        input_faults={"force": cosim.Clipping(low=LOW, high=HIGH, name="engine")},
        noise={"load": cosim.Constant(-LOAD)},
        reference=cosim.Table([0.0, 1.0, 80.0], [0.0, FAST, SLOW], interpolate=False),
        dt=DT,
    )


def figures_of(result: cosim.Result) -> dict[str, float]:
    """Return how far the speed goes beyond its goals (m/s), and the time until it has settled (s)."""
    time, v = result.time, result["plant.v"]
    up, down = (time >= 1.0) & (time < 80.0), time >= 80.0
    figures = {"overshoot": float(v[up].max()) - FAST, "undershoot": SLOW - float(v[down].min())}
    for name, part, goal, start in (("settled", up, FAST, 1.0), ("settled again", down, SLOW, 80.0)):
        outside = time[part & (np.abs(v - goal) > BAND)]
        figures[name] = float(outside[-1]) + DT - start
    return figures


def draw(results: dict[str, cosim.Result]) -> Figure:
    """Return a figure of the speed, and of the force that each controller requests."""
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    speed, force = figure.subplots(2, 1, sharex=True)
    looks = [(SENSOR_COLOURS[0], "-"), (SENSOR_COLOURS[0], "--"), (BLUE, "-"), (BLUE, "--")]
    first = next(iter(results.values()))
    speed.plot(first.time, first["reference.y"], color="0.6", lw=2.5, label="goal")
    force.axhspan(LOW / 1e3, HIGH / 1e3, color="0.93", lw=0, label="what the engine can do")
    for (name, result), (colour, line) in zip(results.items(), looks, strict=True):
        speed.plot(result.time, result["plant.v"], color=colour, ls=line, lw=1.2, label=name)
        force.plot(result.time, result["controller.u"].ravel() / 1e3, color=colour, ls=line, lw=1.2)
    speed.set_ylabel("speed (m/s)")
    force.set_ylabel("requested force (kN)")
    force.set_xlabel("time (s)")
    force.set_ylim(-9.0, 9.0)
    speed.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    force.legend(fontsize=8, frameon=False, loc="upper right")
    for panel in (speed, force):
        panel.spines[["top", "right"]].set_visible(False)
    return figure


def main(
    figure: Path | None = None, engine: Literal["auto", "compiled", "interpreted"] = "auto"
) -> dict[str, dict[str, float]]:
    """Print overshoot and settling time of each controller; return them."""
    columns = ("overshoot", "undershoot", "settled", "settled again")
    print(f"{'':28}" + "".join(f"{column:>16}" for column in columns))
    table: dict[str, dict[str, float]] = {}
    results: dict[str, cosim.Result] = {}
    for name in CONTROLLERS:
        results[name] = make_loop(name).simulate(END, seed=1, engine=engine)
        table[name] = figures_of(results[name])
        shown = (f"{table[name][c]:.2f} {'s' if c.startswith('settled') else 'm/s'}" for c in columns)
        print(f"{name:28}" + "".join(f"{text:>16}" for text in shown))
    if figure is not None:
        draw(results).savefig(figure, dpi=110)
    return table


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
