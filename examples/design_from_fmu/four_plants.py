"""Four FMUs with a failing sensor: position servo, two masses with a spring, pendulum on a cart, hydro turbine.

Run it with ``python -m bayesftc.examples.design_from_fmu.four_plants [runs] [figure.png]``. `controllers.design` makes a
controller from each FMU alone. It is compared with the same controller without fault tolerance (fixed precisions), and with an
oracle, which leaves out the failing sensor at once (its fault is a dropout). All three have the same noise and the same plant.
For none of the four is a goal for only the next step enough: without a cost of the control it makes the loop unstable.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, SENSOR_COLOURS
from bayesftc.cosim.types import Floats

Traces = dict[tuple[str, str], tuple[Floats, Floats, Floats]]
"""Time, output and goal by case and controller."""

WAYS = ("fault-tolerant", "without", "oracle")
FAILS = {
    cosim.Freeze: "freezes",
    cosim.Drift: "drifts",
    cosim.Injection: "is offset",
    cosim.NoiseIncrease: "gets noisy",
}


@dataclass(frozen=True)
class Case:
    """A plant with its measured and actuated variables, its reference and its fault."""

    plant: str
    goal: str
    unit: str
    measured: tuple[str, ...]
    actuated: str
    std: tuple[float, ...]
    noise: dict[str, float]
    accept: tuple[float, float]
    reference: cosim.Source
    fault: cosim.Fault
    duration: float
    limits: tuple[float, float] = (-np.inf, np.inf)
    offsets: dict[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name in the table and the figure."""
        output = self.measured[self.fault.sensor % len(self.measured)]
        return f"{self.plant}: a sensor of {output} {FAILS[type(self.fault)]}"


CASES = (
    Case(
        "PositionServo",
        goal="angle",
        unit="rad",
        measured=("angle",),
        actuated="voltage",
        std=(0.01,),
        noise={"load": 0.02},
        accept=(0.1, 5.0),
        reference=cosim.Sine(amplitude=0.5, period=4.0),
        fault=cosim.Freeze(sensor=0, start=3.0, stop=7.0),
        duration=10.0,
        limits=(-12.0, 12.0),
    ),
    Case(
        "TwoMasses",
        goal="x2",
        unit="m",
        measured=("x1", "x2"),
        actuated="force1",
        std=(0.01, 0.01),
        noise={"force2": 0.5},
        accept=(0.05, 2.0),
        reference=cosim.Step(time=2.0, after=0.5),
        fault=cosim.Drift(sensor=1, start=4.0, stop=9.0, slope=0.1),
        duration=12.0,
        limits=(-10.0, 10.0),
    ),
    Case(
        "CartPendulum",
        goal="position",
        unit="m",
        measured=("position", "angle"),
        actuated="force",
        std=(0.005, 0.005),
        noise={"torque": 0.02},
        accept=(0.1, 5.0),
        reference=cosim.Step(time=2.0, after=0.3),
        fault=cosim.Injection(sensor=1, start=5.0, stop=9.0, magnitude=0.1),
        duration=12.0,
        limits=(-15.0, 15.0),
    ),
    Case(
        "HydroTurbine",
        goal="power",
        unit="per unit",
        measured=("power",),
        actuated="command",
        std=(0.01,),
        noise={"head": 0.01},
        accept=(0.05, 0.1),
        reference=cosim.Step(time=5.0, before=0.6, after=0.7),
        fault=cosim.NoiseIncrease(sensor=0, start=10.0, stop=30.0, std=0.3),
        duration=40.0,
        limits=(0.2, 1.0),
        offsets={"head": 1.0},
    ),
)


def make_loop(case: Case, way: str) -> cosim.Diagram:
    """Return the closed loop of a case with one of the three controllers."""
    measured = len(case.measured)
    noise = {name: cosim.Gaussian(mean=case.offsets.get(name, 0.0), std=std) for name, std in case.noise.items()}
    return loop_of(
        cosim.FMU(fmus.path(case.plant)),
        case,
        way,
        cosim.Sensors(count=2 * measured, signals=measured, std=case.std * 2),
        noise,
        goal=case.goal,
        u_min=case.limits[0],
        u_max=case.limits[1],
    )


def loop_of(
    plant: cosim.FMU,
    case: Any,
    way: str,
    sensors: cosim.Sensors,
    noise: Mapping[str, Any] | None = None,
    **settings: Any,
) -> cosim.Diagram:
    """Return a plant with one of the three controllers, designed with the case's values and further settings."""
    controller = controllers.design(
        plant,
        measured=case.measured,
        actuated=case.actuated,
        sensors=sensors.count,
        sensor_std=case.std,
        noise=case.noise,
        acceptable_error=case.accept[0],
        acceptable_control=case.accept[1],
        precision=controllers.SwitchingPrecision() if way == "fault-tolerant" else controllers.FixedPrecision(),
        **settings,
    )
    fault = case.fault
    if way == "oracle":
        fault = cosim.Dropout(sensor=fault.sensor, start=fault.start, stop=fault.stop)
    return cosim.closed_loop(
        plant,
        controller,
        control=case.actuated,
        measured=case.measured,
        sensors=sensors,
        faults=[replace(fault, name="fault")],
        noise=noise,
        reference=case.reference,
    )


def draw(cases: tuple[Case, ...], traces: Traces) -> Figure:
    """Return a figure with a panel for each plant: its goal and its output with each controller (grey: a sensor fails)."""
    figure = Figure(figsize=(8.0, 2.3 * len(cases)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(cases), 1, squeeze=False)[:, 0]
    looks = dict(zip(WAYS, ((BLUE, "-"), (SENSOR_COLOURS[0], "-"), (BLACK, ":")), strict=True))
    for case, panel in zip(cases, panels, strict=True):
        panel.axvspan(case.fault.start, case.fault.stop, color="0.93", lw=0)
        time, _, reference = traces[case.name, WAYS[0]]
        panel.plot(time, reference, color="0.6", lw=1.0, label="goal")
        shown = [reference]
        for way in ("without", "fault-tolerant", "oracle"):
            time, output, _ = traces[case.name, way]
            panel.plot(time, output, color=looks[way][0], ls=looks[way][1], lw=1.2, label=way)
            shown += [output] if way != "without" else []
        low, high = min(s.min() for s in shown), max(s.max() for s in shown)
        panel.set_ylim(low - 0.5 * (high - low), high + 0.5 * (high - low))
        panel.set_ylabel(f"{case.goal} ({case.unit})")
        panel.set_title(case.name, fontsize=10, loc="left")
        panel.tick_params(labelsize=8)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].legend(fontsize=8, frameon=False, ncols=4, loc="upper right")
    panels[-1].set_xlabel("time (s)")
    return figure


def main(
    runs: int = 20,
    figure: Path | None = None,
    engine: Literal["auto", "compiled", "interpreted"] = "auto",
    cases: tuple[Case, ...] = CASES,
) -> dict[tuple[str, str], float]:
    """Print the error during the fault for each plant and controller; return the means."""
    print(f"{'RMSE of the goal output during the fault':56}" + "".join(f"{way:>20}" for way in WAYS))
    table: dict[tuple[str, str], float] = {}
    traces: Traces = {}
    for case in cases:
        shown = ""
        for way in WAYS:
            loop = make_loop(case, way)
            record = [f"plant.{case.goal}", "reference.y"]
            errors, (start, stop) = [], case.fault.times
            for seed in range(runs):
                result = loop.simulate(case.duration, seed=seed, record=record, engine=engine)
                error = result[f"plant.{case.goal}"] - result["reference.y"]
                failing = (result.time >= start) & (result.time < stop)
                errors.append(float(np.sqrt(np.mean(error[failing] ** 2))))
                if seed == 0:
                    traces[case.name, way] = result.time, result[f"plant.{case.goal}"], result["reference.y"]
            table[case.name, way] = float(np.mean(errors))
            half = 1.96 * np.std(errors, ddof=1) / runs**0.5 if runs > 1 else float("nan")
            shown += f"{np.mean(errors):13.4f} ± {half:.4f}"
        print(f"{case.name + f' ({case.unit})':56}{shown}")
    if figure is not None:
        draw(cases, traces).savefig(figure, dpi=110)
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, Path(sys.argv[2]) if len(sys.argv) > 2 else None)
