"""Plants from five other tools, each with two redundant sensors, one of which fails during tracking.

Run it with ``python -m bayesftc.examples.foreign_fmus.closed_loops [runs]``. `controllers.design` makes a controller from each
FMU alone. It is compared with the same controller without fault tolerance (fixed precisions), and with an oracle, which leaves
out the failing sensor at once. Tools that are not installed are named and left out.
"""

import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from bayesftc import cosim
from bayesftc.examples.design_from_fmu.four_plants import WAYS, loop_of
from bayesftc.examples.foreign_fmus.makers import MAKERS, MissingTool


@dataclass(frozen=True)
class Case:
    """A plant's measured and actuated variables, its reference, and the fault of one of the two sensors."""

    tool: str
    measured: str
    actuated: str
    dt: float
    std: float
    accept: tuple[float, float]
    reference: cosim.Source
    fault: cosim.Fault
    duration: float
    noise: dict[str, float] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    offsets: dict[str, float] = field(default_factory=dict)


CASES = (
    Case(
        "PythonFMU",
        measured="level",
        actuated="pump",
        dt=0.5,
        std=0.002,
        accept=(0.01, 5e-4),
        reference=cosim.Step(time=60.0, before=0.1, after=0.15),
        fault=cosim.Injection(sensor=0, start=90.0, stop=150.0, magnitude=0.05),
        duration=180.0,
        noise={"pump": 2e-5},
    ),
    Case(
        "PythonFMU3",
        measured="air",
        actuated="heater",
        dt=60.0,
        std=0.1,
        accept=(0.5, 1.0),
        reference=cosim.Step(time=7200.0, before=18.0, after=21.0),
        fault=cosim.Injection(sensor=1, start=10800.0, stop=18000.0, magnitude=3.0),
        duration=21600.0,
        noise={"heater": 0.05},
    ),
    Case(
        "CasADi",
        measured="y",
        actuated="torque",
        dt=0.05,
        std=0.01,
        accept=(0.02, 5.0),
        reference=cosim.Sine(amplitude=0.5, period=6.0),
        fault=cosim.Freeze(sensor=0, start=6.0, stop=14.0),
        duration=18.0,
        noise={"torque": 0.1},
    ),
    Case(
        "OpenModelica",
        measured="y",
        actuated="f",
        dt=0.005,
        std=0.001,
        accept=(0.005, 500.0),
        reference=cosim.Step(time=0.5, after=0.05),
        fault=cosim.Injection(sensor=1, start=1.0, stop=2.0, magnitude=-0.02),
        duration=2.5,
        noise={"f": 5.0},
        settings={"kind": "model exchange", "parameters": {"fixed.s0": 0.5}},
    ),
    Case(
        "qfmu",
        measured="y1",
        actuated="u1",
        dt=0.02,
        std=0.01,
        accept=(0.05, 2.0),
        reference=cosim.Sine(amplitude=1.0, period=6.0),
        fault=cosim.Freeze(sensor=1, start=6.0, stop=14.0),
        duration=18.0,
        noise={"u1": 0.05},
    ),
)


def make_loop(case: Case, file: Path, way: str) -> cosim.Diagram:
    """Return the closed loop of a case with one of the three controllers."""
    uncertain = case.tool.startswith("Python") or None  # the linear model of a nonlinear plant is not exact
    sensors = cosim.Sensors(count=2, std=case.std)
    return loop_of(cosim.FMU(file, **case.settings), case, way, sensors, dt=case.dt, disturbance=uncertain)


def main(
    runs: int = 5,
    engine: Literal["auto", "compiled", "interpreted"] = "auto",
    cases: tuple[Case, ...] = CASES,
) -> dict[tuple[str, str], float]:
    """Print the error during the fault for each plant and controller, and the fault probabilities; return the means."""
    print(
        f"{'RMSE of the output during the fault':40}" + "".join(f"{way:>16}" for way in WAYS) + "   fault probabilities"
    )
    table: dict[tuple[str, str], float] = {}
    with TemporaryDirectory() as folder:
        for case in cases:
            try:
                file = MAKERS[case.tool](Path(folder))
            except MissingTool as missing:
                print(f"{case.tool:40}{missing}")
                continue
            (start, stop), shown, probabilities = case.fault.times, "", ""
            for way in WAYS:
                loop, errors = make_loop(case, file, way), []
                for seed in range(runs):
                    result = loop.simulate(case.duration, seed=seed, engine=engine)
                    failing = (result.time >= start) & (result.time < stop)
                    error = result[f"plant.{case.measured}"] - result["reference.y"]
                    errors.append(float(np.sqrt(np.mean(error[failing] ** 2))))
                    if way == "fault-tolerant":
                        worst = result["controller.fault_probability"][failing].mean(axis=0).round(2)
                        probabilities = f"{worst.tolist()}, sensor {case.fault.sensor} fails"
                table[case.tool, way] = float(np.mean(errors))
                shown += f"{np.mean(errors):16.4g}"
            print(f"{case.tool + ': ' + file.name:40}{shown}   {probabilities}")
    return table


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # these FMUs do not state the dependencies of their outputs
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
