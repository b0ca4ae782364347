"""One car in python-control's ``input_output_response``: as its own systems, as a block, and as FMUs."""

from __future__ import annotations

import tempfile
import time
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.cosim.types import Floats

DT = 0.02
A, B = 1 - 5.0 / 100.0 * DT, DT / 100.0


def foreign(folder: Path) -> Path:
    """Return a copy of the shipped car without this package's annotation, so its state is not accessible."""
    from bayesftc import fmus

    path = folder / "car.fmu"
    with zipfile.ZipFile(fmus.path("CruiseControl")) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b"<bayesftc timing", b"<another timing"))
    return path


def cars(folder: Path) -> dict[str, Any]:
    """Return the car in each form, as a python-control system with inputs force and disturbance, and output v."""
    import control

    from bayesftc import cosim, fmus

    names = {"inputs": ["force", "disturbance"], "outputs": ["v"]}
    matrices = control.ss([[A]], [[B, 1.0]], [[1.0]], 0, DT, **names)
    return {
        "nlsys": control.nlsys(
            lambda t, x, u, p: [A * x[0] + B * u[0] + u[1]], lambda t, x, u, p: x, states=1, dt=DT, **names
        ),
        "ss": matrices,
        "block": cosim.StateSpace(matrices).to_control(),
        "fmu": cosim.FMU(fmus.path("CruiseControl")).to_control(DT),
        "foreign": cosim.FMU(foreign(folder)).to_control(DT),
    }


def measure(quick: bool = False) -> Section:
    """Check that all compute the same, and measure them in turns."""
    steps, rounds = (200, 2) if quick else (5_000, 7)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        runs = {name: partial(_response, car, steps) for name, car in cars(Path(folder)).items()}
        reference = runs["nlsys"]()[0]
        for name, run in runs.items():
            np.testing.assert_allclose(run()[0], reference, rtol=1e-12, atol=1e-12, err_msg=name)
        rates = in_turns({name: partial(_rate, run, steps) for name, run in runs.items()}, rounds)
    titles = {"nlsys": "control.nlsys", "ss": "control.ss", "block": "block", "fmu": "FMU of this package"}
    titles |= {"foreign": "other FMU"}
    figures = [Figure(name, title, "steps/s", rates[name]) for name, title in titles.items()]
    for name in ("block", "fmu", "foreign"):
        over = ratios(rates[name], rates["nlsys"])
        figures.append(Figure(f"{name}_over_nlsys", f"{titles[name]} / control.nlsys", "", over))
    return Section("python_control", "python-control: input_output_response of a car", tuple(figures))


def _response(car: Any, steps: int) -> tuple[Floats, float]:
    import control

    times = np.arange(steps) * DT
    inputs = np.vstack([500.0 * np.sin(times), 0.0 * times])
    started = time.perf_counter()
    outputs: Floats = control.input_output_response(car, times, inputs).outputs
    return outputs, time.perf_counter() - started


def _rate(run: Callable[[], tuple[Floats, float]], steps: int) -> float:
    return steps / run()[1]
