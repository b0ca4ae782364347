"""Exported C: the time of a step, compared with the compiled engine, and the size for several states and sensors."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench.measures.full_loop import SETTING

if TYPE_CHECKING:
    from bayesftc.controllers import BayesianController, PrecisionLearner
    from bayesftc.cosim.export.c_file import CFile

SIZES = ((1, 2), (2, 3), (5, 5), (10, 10), (20, 20))
"""Numbers of states and sensors."""

LEARNERS = (
    *(("fixed", 1, m) for m in (2, 8)),
    *(("gamma", 1, m) for m in (2, 8)),
    *(("switching, joint=False", 1, m) for m in (2, 8)),
    *(("switching", 1, m) for m in (2, 3, 4, 6, 8)),
    *((name, 6, 3) for name in ("fixed", "switching, joint=False", "switching")),
)
"""Learners with numbers of states and sensors: the hypotheses of the last learner grow with the sensors, each with the states."""

SAMPLES = 1024
NO_SIZE = "The program 'size' of the binutils was not found."
_FLAGS = ("-O2", "-std=c99", "-ffp-contract=off")

_LOOP = """\
#include "controller.h"

double run(long steps, const double *samples)
{
    static controller c;
    static controller_inputs u;
    static controller_outputs y;
    double total = 0.0;

    controller_init(&c);
    for (long k = 0; k < steps; ++k) {
        for (int i = 0; i < CONTROLLER_IN_Y; ++i) {
            u.y[i] = samples[k % %SAMPLES% * CONTROLLER_IN_Y + i];
        }
        controller_step(&c, &u, &y);
        total += y.u[0];
    }
    return total;
}
"""

_COUNT = """\
#include "counted.h"
#include "controller.c"
#undef double
#include <cstdio>

int main()
{
    static controller c;
    static controller_inputs u;
    static controller_outputs y;

    controller_init(&c);
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < CONTROLLER_IN_Y; ++i) {
            u.y[i] = Counted(0.1 * i + k);
        }
        operations = functions = 0;
        controller_step(&c, &u, &y);
    }
    std::printf("%ld %ld %zu", operations, functions, sizeof c + sizeof u + sizeof y);
    return 0;
}
"""


def controller_of(states: int, sensors: int, precision: PrecisionLearner | None = None) -> BayesianController:
    """Return a controller for the car with one state, otherwise for a random linear model; by default with gamma learning."""
    from bayesftc import controllers

    s = SETTING
    precision = precision or controllers.GammaPrecision(forgetting=s.forgetting, prior_shape=s.prior_shape)
    if states == 1:
        model = controllers.LinearModel(
            [[s.a]],
            [[s.b]],
            np.ones((sensors, 1)),
            process_covariance=s.process_variance,
            sensor_covariance=s.sensor_std**2,
            dt=s.step,
        )
        return controllers.BayesianController(model, precision=precision, initial_mean=s.start_speed)
    rng = np.random.default_rng(states)
    dynamics = 0.9 * np.eye(states) + 0.05 * np.eye(states, k=1) + 0.05 * np.eye(states, k=-1)
    model = controllers.LinearModel(
        dynamics,
        rng.normal(size=(states, 2)),
        rng.normal(size=(sensors, states)),
        process_covariance=1e-3,
        sensor_covariance=0.01,
        dt=s.step,
    )
    return controllers.BayesianController(model, precision=precision, control_covariance=1.0)


def measure(quick: bool = False) -> Section:
    """Check that C and engine compute the same, measure both in turns, and then the sizes."""
    from bayesftc.fmus._compiler import why_no_compiler

    title = "Controllers as C, with gamma learning where no learner is named"
    if why_no_compiler():
        return Section("export", title, (Figure("c", "a step in C", "ns", [], reason=why_no_compiler()),))
    steps, rounds = (20_000, 3) if quick else (500_000, 15)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        figures = _speed(Path(folder), steps, rounds)
        for states, sensors in SIZES[:2] if quick else SIZES:
            figures += _size(Path(folder) / f"{states}x{sensors}", states, sensors)
        for i, (name, states, sensors) in enumerate(LEARNERS[:1] if quick else LEARNERS):
            figures += _learner(Path(folder) / str(i), name, states, sensors, steps // 10)
    return Section("export", title, tuple(figures))


def _speed(folder: Path, steps: int, rounds: int) -> list[Figure]:
    from bayesftc.cosim.blocks.sources import Constant, Gaussian
    from bayesftc.cosim.diagram.diagram import Diagram

    controller = controller_of(1, 2)
    _written(folder, controller)
    in_c = _loop(folder)
    diagram, idle = Diagram(controller.sample_time), Diagram(controller.sample_time)
    node = diagram.add(controller, "controller")
    diagram.connect(diagram.add(Constant(0.0), "goal")["y"], node["goal"])  # the default in the C code
    for each in (diagram, idle):  # `idle` is the same without the controller
        sensors = each.add(Gaussian(mean=SETTING.start_speed, std=[0.1, 0.1]), "sensors")
        if each is diagram:
            diagram.connect(sensors["y"], node["y"])
    short = diagram.simulate((SAMPLES - 1) * diagram.step, seed=1, record=["controller.u", "sensors.y"])
    samples = np.ascontiguousarray(short["sensors.y"])
    run = partial(in_c, ctypes.c_long(steps), ctypes.c_void_p(samples.ctypes.data))
    once = in_c(ctypes.c_long(SAMPLES), ctypes.c_void_p(samples.ctypes.data))
    np.testing.assert_allclose(once, np.sum(short["controller.u"]), rtol=1e-12)  # sums in another order
    simulate = partial(diagram.simulate, steps * diagram.step, record=["controller.u"])
    alone = partial(idle.simulate, steps * idle.step, record=["sensors.y"])
    taken = in_turns({"c": partial(_cpu, run), "engine": partial(_cpu, simulate), "idle": partial(_cpu, alone)}, rounds)
    scale = 1e9 / steps
    c = [seconds * scale for seconds in taken["c"]]
    engine = [(a - b) * scale for a, b in zip(taken["engine"], taken["idle"], strict=True)]
    return [
        Figure("c", "a step in C, 2 sensors, processor time", "ns", c, at_most=100.0),
        Figure("engine", "a step of the compiled engine, without its sources", "ns", engine),
        Figure("c_over_engine", "C / compiled engine", "", ratios(c, engine)),
    ]


def _cpu(run: Any) -> float:
    started = time.process_time()
    run()
    return time.process_time() - started


def _size(folder: Path, states: int, sensors: int) -> list[Figure]:
    folder.mkdir()
    controller = controller_of(states, sensors)
    started = time.perf_counter()
    file = _written(folder, controller)
    writing = time.perf_counter() - started
    started = time.perf_counter()
    _compile(folder, ["controller.c"], "-c", "-o", "fast.o")
    compiling = time.perf_counter() - started
    _compile(folder, ["controller.c"], "-Os", "-c", "-o", "small.o")
    operations, memory, reason = _counted(folder)
    size, title = f"{states}x{sensors}", f"{states} states, {sensors} sensors"
    figures = [
        Figure(f"write_{size}", f"{title}: writing", "s", [writing], at_most=5.0),
        Figure(f"compile_{size}", f"{title}: compiling (-O2)", "s", [compiling], at_most=10.0),
        Figure(f"lines_{size}", f"{title}: lines", "", [float(file.source.count("\n"))]),
        Figure(f"operations_{size}", f"{title}: floating-point operations", "", operations, reason=reason),
        Figure(f"memory_{size}", f"{title}: RAM, inputs and outputs too", "bytes", memory, reason=reason),
    ]
    for name, flag in (("fast", "-O2"), ("small", "-Os")):
        flash = _flash(folder / f"{name}.o")
        why = None if flash else NO_SIZE
        figures.append(Figure(f"flash_{name}_{size}", f"{title}: flash ({flag})", "bytes", flash, reason=why))
    return figures


def _learner(folder: Path, name: str, states: int, sensors: int, steps: int) -> list[Figure]:
    """Return size and time of a controller with a learner, so many states and sensors."""
    from bayesftc import controllers

    learners: dict[str, PrecisionLearner] = {
        "fixed": controllers.FixedPrecision(),
        "gamma": controllers.GammaPrecision(),
        "switching, joint=False": controllers.SwitchingPrecision(joint=False),
        "switching": controllers.SwitchingPrecision(),
    }
    folder.mkdir()
    _written(folder, controller_of(states, sensors, learners[name]))
    run = _loop(folder)
    rng = np.random.default_rng(sensors)
    samples = (SETTING.start_speed if states == 1 else 0.0) + 0.1 * rng.normal(size=(SAMPLES, sensors))
    started = time.process_time()
    run(ctypes.c_long(steps), ctypes.c_void_p(samples.ctypes.data))
    taken = (time.process_time() - started) / steps
    _compile(folder, ["controller.c"], "-Os", "-c", "-o", "small.o")
    _, memory, reason = _counted(folder)
    flash = _flash(folder / "small.o")
    title, key = f"{name}, {sensors} sensors", f"{name}_{sensors}"
    if states > 1:
        title, key = f"{name}, {states} states, {sensors} sensors", f"{name}_{states}x{sensors}"
    return [
        Figure(f"flash_{key}", f"{title}: flash (-Os)", "bytes", flash, reason=None if flash else NO_SIZE),
        Figure(f"memory_{key}", f"{title}: RAM, inputs and outputs too", "bytes", memory, reason=reason),
        Figure(f"time_{key}", f"{title}: a step in C (-O2), processor time", "us", [1e6 * taken]),
    ]


def _loop(folder: Path) -> Any:
    """Return the compiled function that runs a controller for a number of steps over given samples."""
    (folder / "loop.c").write_text(_LOOP.replace("%SAMPLES%", str(SAMPLES)))
    _compile(folder, ["controller.c", "loop.c"], "-shared", "-fPIC", "-o", "loop.so", "-lm")
    run = ctypes.CDLL(str(folder / "loop.so")).run
    run.restype = ctypes.c_double
    return run


def _written(folder: Path, controller: BayesianController) -> CFile:
    from bayesftc.cosim.export.c_file import write_c
    from bayesftc.cosim.export.program import program_of

    file = write_c(program_of(controller, name="controller"))
    (folder / "controller.h").write_text(file.header)
    (folder / "controller.c").write_text(file.source)
    return file


def _compile(folder: Path, sources: list[str], *options: str) -> None:
    from bayesftc.fmus._compiler import compiler_command

    subprocess.run([*compiler_command(None), *_FLAGS, *sources, *options], cwd=folder, check=True, capture_output=True)


def _counted(folder: Path) -> tuple[list[float], list[float], str | None]:
    """Return the operations of a step, including square roots and the like, and the bytes of its data."""
    compiler = next((path for name in ("c++", "g++", "clang++") if (path := shutil.which(name))), None)
    if compiler is None:
        return [], [], "No C++ compiler was found, which is needed to count operations."
    (folder / "count.cpp").write_text(_COUNT)
    shutil.copy(Path(__file__).with_name("counted.h"), folder)
    subprocess.run([compiler, "-w", "count.cpp", "-o", "count", "-lm"], cwd=folder, check=True, capture_output=True)
    done = subprocess.run([str(folder / "count")], check=True, capture_output=True, text=True)
    operations, functions, memory = map(float, done.stdout.split())
    return [operations + functions], [memory], None


def _flash(compiled: Path) -> list[float]:
    if shutil.which("size") is None:
        return []
    done = subprocess.run(["size", str(compiled)], check=True, capture_output=True, text=True)
    return [float(done.stdout.splitlines()[1].split()[0])]
