"""A position servo follows a ramp and a sine that it knows n samples ahead.

Run it with ``python -m bayesftc.examples.goals_ahead.study [runs] [figure.png]``. It prints the tracking error by the number of
known samples, without a fault and with a sensor that freezes. All loops have the same noise.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.judging.figures.plotting import BLUE, SENSOR_COLOURS
from bayesftc.cosim.types import Floats

PREVIEWS = (0, 1, 2, 5, 10, 20, 50)
"""Numbers of samples of 0.01 s."""
BEGIN, END = 2.0, 10.0
"""Seconds over which the error is evaluated."""


@dataclass(frozen=True)
class Case:
    """A reference and the faults of the sensors."""

    name: str
    reference: cosim.Source
    faults: tuple[cosim.Fault, ...] = ()


CASES = (
    Case("ramp", cosim.Ramp(slope=0.5, start=1.0)),
    Case("sine", cosim.Sine(amplitude=0.5, period=2.0)),
    Case("sine, a sensor freezes", cosim.Sine(amplitude=0.5, period=2.0), (cosim.Freeze(sensor=0, start=4.0),)),
)


def make_loop(case: Case, preview: int) -> cosim.Diagram:
    """Return the closed loop that knows the reference `preview` samples ahead."""
    servo = cosim.FMU(fmus.path("PositionServo"))
    controller = controllers.design(
        servo,
        measured="angle",
        actuated="voltage",
        sensors=2,
        sensor_std=0.002,
        noise={"load": 0.02},
        acceptable_error=0.1,
        acceptable_control=5.0,
        u_min=-12.0,
        u_max=12.0,
        preview=preview,
    )
    return cosim.closed_loop(
        servo,
        controller,
        control="voltage",
        measured="angle",
        sensors=cosim.Sensors(count=2, std=0.002),
        faults=case.faults,
        noise={"load": cosim.Gaussian(std=0.02)},
        reference=case.reference,
    )


def draw(case: Case, traces: dict[int, tuple[Floats, Floats, Floats]]) -> Figure:
    """Return a figure of reference and angle by the number of known samples."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    time, _, reference = next(iter(traces.values()))
    panel.plot(time, reference, color="0.6", lw=2.5, label="reference")
    for (preview, (time, angle, _)), colour in zip(traces.items(), (SENSOR_COLOURS[0], BLUE), strict=True):
        name = f"known {preview} samples ahead" if preview else "not known"
        panel.plot(time, angle, color=colour, lw=1.2, label=f"angle, {name}")
    panel.set_xlim(0.0, 6.0)
    panel.set_xlabel("time (s)")
    panel.set_ylabel("angle (rad)")
    panel.set_title(case.name, fontsize=10, loc="left")
    panel.legend(fontsize=8, frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    return figure


def main(
    runs: int = 20,
    figure: Path | None = None,
    engine: Literal["auto", "compiled", "interpreted"] = "auto",
    previews: tuple[int, ...] = PREVIEWS,
    cases: tuple[Case, ...] = CASES,
) -> dict[tuple[str, int], float]:
    """Print the tracking error by case and number of known samples; return the means."""
    print(f"{'RMSE of the angle (rad), known ahead':40}" + "".join(f"{case.name:>26}" for case in cases))
    table: dict[tuple[str, int], float] = {}
    traces: dict[int, tuple[Floats, Floats, Floats]] = {}
    for preview in previews:
        shown = ""
        for case in cases:
            loop, errors = make_loop(case, preview), []
            for seed in range(runs):
                result = loop.simulate(END, seed=seed, record=["plant.angle", "reference.y"], engine=engine)
                angle, reference = result["plant.angle"], result["reference.y"]
                errors.append(float(np.sqrt(np.mean((angle - reference)[result.time >= BEGIN] ** 2))))
                if seed == 0 and case is cases[-1] and preview in (previews[0], previews[-2]):
                    traces[preview] = result.time, angle, reference
            table[case.name, preview] = float(np.mean(errors))
            half = 1.96 * np.std(errors, ddof=1) / runs**0.5 if runs > 1 else float("nan")
            shown += f"{np.mean(errors):16.5f} ± {half:.5f}"
        print(f"{preview:>3} samples{'':29}{shown}")
    if figure is not None:
        draw(cases[-1], traces).savefig(figure, dpi=110)
    return table


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, Path(sys.argv[2]) if len(sys.argv) > 2 else None)
