"""A model exchange FMU, a pendulum, integrated by this package and by fmpy: same binary, tolerances, communication points.

Without an input, fmpy's CVODE continues from one communication point to the next. The integrators here restart at each point,
so a step does not depend on earlier ones. With an input that jumps at every point, as under control, fmpy restarts as well.
"""

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

STEP, RTOL = 0.01, 1e-6
PERIOD = 3.0
"""Period in seconds of the sine that drives it, which is held from point to point."""

Run = Callable[[int], tuple[Floats, float]]
"""Makes the given number of steps; returns the angles and the time in seconds."""

_VARIABLES = (
    ("q", 'causality="output" initial="calculated"', "<Real/>"),
    ("w", 'causality="local" initial="calculated"', "<Real/>"),
    ("der(q)", 'causality="local" initial="calculated"', '<Real derivative="1"/>'),
    ("der(w)", 'causality="local" initial="calculated"', '<Real derivative="2"/>'),
    ("torque", 'causality="input"', '<Real start="0"/>'),
)


def build_pendulum(folder: Path) -> Path:
    """Compile ``pendulum.c``, pack it as an FMU and return its path.

    Raises
    ------
    bayesftc.fmus._compiler.CompilerError
        If there is no compiler, or it fails.
    """
    import fmpy

    from bayesftc.fmus._compiler import compile_library
    from bayesftc.fmus._platforms import host

    folder = folder.absolute()  # the compiler runs in another folder
    library = folder / f"pendulum{fmpy.sharedLibraryExtension}"
    compile_library(Path(__file__).parent, ["pendulum.c"], library, host(), ["m"])
    rows = "".join(
        f'<ScalarVariable name="{name}" valueReference="{i}" variability="continuous" {kind}>{real}</ScalarVariable>'
        for i, (name, kind, real) in enumerate(_VARIABLES)
    )
    unknowns = "".join(f'<Unknown index="{i}"/>' for i in (1, 2, 3, 4))
    description = (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="Pendulum" guid="pendulum" '
        'numberOfEventIndicators="0"><ModelExchange modelIdentifier="pendulum" completedIntegratorStepNotNeeded="true"/>'
        f'<ModelVariables>{rows}</ModelVariables><ModelStructure><Outputs><Unknown index="1" dependencies="1"/></Outputs>'
        '<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives>'
        f"<InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure></fmiModelDescription>"
    )
    path = folder / "pendulum.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
    return path


def torques(steps: int) -> Floats:
    """Return the input at each communication point."""
    values: Floats = 2.0 * np.sin(2 * np.pi / PERIOD * STEP * np.arange(steps + 1))
    return values


def ours(path: Path, solver: str, *, driven: bool) -> Run:
    """Return a run of this package; its time includes making and freeing the instance."""
    from bayesftc import cosim

    diagram = cosim.Diagram(STEP)
    pendulum = diagram.add(cosim.FMU(path, kind="model exchange", solver=solver, rtol=RTOL), "pendulum")
    if driven:
        source = diagram.add(cosim.Sine(amplitude=2.0, period=PERIOD), "torque")
        diagram.connect(source["y"], pendulum["torque"])
    diagram.build()

    def run(steps: int) -> tuple[Floats, float]:
        started = time.perf_counter()
        result = diagram.simulate(steps * diagram.step, record=["pendulum.q"])
        return result["pendulum.q"], time.perf_counter() - started

    return run


def theirs(path: Path, folder: Path, *, driven: bool) -> Run:
    """Return a run of fmpy; its time includes resetting the instance, which stays loaded."""
    import fmpy

    description, unpacked = fmpy.read_model_description(str(path)), fmpy.extract(str(path), str(folder))
    instance = fmpy.instantiate_fmu(unpacked, description, "ModelExchange")

    def run(steps: int) -> tuple[Floats, float]:
        signals = None
        if driven:  # each instant twice, with the values before and after the jump
            times, values = np.repeat(STEP * np.arange(steps + 1), 2)[1:], np.repeat(torques(steps), 2)[:-1]
            signals = np.array(list(zip(times, values, strict=True)), dtype=[("time", "f8"), ("torque", "f8")])
        instance.reset()
        started = time.perf_counter()
        grid: dict[str, Any] = {
            "stop_time": steps * STEP,
            "output_interval": STEP,
            "output": ["q"],
            "record_events": False,
        }
        how: dict[str, Any] = {
            "fmi_type": "ModelExchange",
            "solver": "CVode",
            "relative_tolerance": RTOL,
            "input": signals,
        }
        held: dict[str, Any] = {"model_description": description, "fmu_instance": instance}
        result: Any = fmpy.simulate_fmu(unpacked, **held, **how, **grid)
        return np.asarray(result["q"]), time.perf_counter() - started

    return run


def exact(steps: int, *, driven: bool) -> Floats:
    """Return the angles from scipy, integrated with a tolerance of 1e-11."""
    from scipy.integrate import solve_ivp

    def right(t: float, x: Floats, u: float) -> list[float]:
        return [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1] + u]

    settings: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
    start = np.array([0.5, 0.0])
    if not driven:
        times = STEP * np.arange(steps + 1)
        angles: Floats = solve_ivp(right, (0.0, times[-1]), start, t_eval=times, args=(0.0,), **settings).y[0]
        return angles
    rows = [start]
    for u in torques(steps)[:-1]:
        rows.append(solve_ivp(right, (0.0, STEP), rows[-1], args=(u,), **settings).y[:, -1])
    return np.array(rows)[:, 0]


def measure(quick: bool = False) -> Section:
    """Measure all in turns, and their distances from the solution."""
    from bayesftc.fmus._compiler import CompilerError

    title = f"Model exchange: a pendulum, steps of {STEP:g} s, tolerance {RTOL:g}"
    steps, rounds = (200, 2) if quick else (5_000, 7)
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        try:
            path = build_pendulum(folder)
        except CompilerError:
            reason = "No C compiler was found, or it failed. Install one for this figure."
            missing = tuple(
                Figure(key, label, "", (), at_least=bar, reason=reason) for key, label, bar in _RATIOS if bar
            )
            return Section("model_exchange", title, missing)
        for driven in (False, True):
            runs = {
                "cvode": ours(path, "cvode", driven=driven),
                "rk45": ours(path, "rk45", driven=driven),
                "fmpy": theirs(path, folder / f"unpacked{driven:d}", driven=driven),
            }
            reference = exact(200, driven=driven)
            errors = {n: float(np.abs(run(200)[0][:201] - reference).max()) for n, run in runs.items()}
            rates = in_turns({n: partial(_rate, run, steps) for n, run in runs.items()}, rounds)
            figures += _figures(driven, rates, errors)
    return Section("model_exchange", title, tuple(figures))


def _rate(run: Run, steps: int) -> float:
    return steps / run(steps)[1]


_RATIOS = (
    ("free_cvode_over_fmpy", "CVODE / fmpy's CVODE, left alone", 1.0),
    ("free_rk45_over_fmpy", "Runge-Kutta / fmpy's CVODE, left alone", None),
    ("driven_cvode_over_fmpy", "CVODE / fmpy's CVODE, driven", 1.0),
    ("driven_rk45_over_fmpy", "Runge-Kutta / fmpy's CVODE, driven", None),
)


def _figures(driven: bool, rates: dict[str, list[float]], errors: dict[str, float]) -> list[Figure]:
    case, words = ("driven", "driven") if driven else ("free", "left alone")
    names = {"cvode": "CVODE", "rk45": "Runge-Kutta", "fmpy": "fmpy's CVODE"}
    notes = {key: f"largest error in 2 s {error:.1g} rad" for key, error in errors.items()}
    done = [
        Figure(f"{case}_{k}", f"{label}, {words}", "steps/s", rates[k], note=notes[k]) for k, label in names.items()
    ]
    for key, label, bar in _RATIOS:
        if key.startswith(case):
            solver = key.removeprefix(f"{case}_").removesuffix("_over_fmpy")
            done.append(Figure(key, label, "", ratios(rates[solver], rates["fmpy"]), at_least=bar))
    return done
