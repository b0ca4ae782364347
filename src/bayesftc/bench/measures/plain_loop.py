"""The shipped car under proportional control: the compiled engine in one call and step by step, a loop in C, a plain fmpy loop.

All make the same calls of the same binary in the same order, and record every `EVERY`-th speed.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import CAR, Unpacked, unpacked_fmu
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram

STEP = 0.02
GAIN, OFFSET = -800.0, 16_000.0  # force = 800 (20 m/s - v)
EVERY = 100

Loop = Callable[[int], tuple[Floats, float]]
"""Makes the given number of steps; returns the recorded speeds and the time in seconds."""


def loop_diagram() -> Diagram:
    """Return the loop as a diagram."""
    from bayesftc import cosim, fmus

    diagram = cosim.Diagram(STEP)
    car = diagram.add(cosim.FMU(fmus.path(CAR), inputs=["force"]), "car")
    controller = diagram.add(cosim.Gain(GAIN, offset=OFFSET), "controller")
    diagram.connect(car["v"], controller["u"])
    diagram.connect(controller["y"], car["force"])
    return diagram


def engine_loop() -> Loop:
    """Return the loop in the compiled engine; its time includes making and freeing the FMU's instance."""
    diagram = loop_diagram()
    diagram.build()

    def run(steps: int) -> tuple[Floats, float]:
        started = time.perf_counter()
        result = diagram.simulate(steps * diagram.step, record=["car.v"], decimation=EVERY)
        return result["car.v"], time.perf_counter() - started

    return run


def live_loop() -> Loop:
    """Return the loop as a live run, which Python advances by one step a call, as in front of real time."""
    diagram = loop_diagram()

    def run(steps: int) -> tuple[Floats, float]:
        speeds = np.empty(steps // EVERY + 1)
        with diagram.start(record=["car.v"]) as session:
            speeds[0] = session.advance(0)["car.v"][0]
            started = time.perf_counter()
            for k in range(1, steps + 1):
                piece = session.advance(STEP)
                if k % EVERY == 0:
                    speeds[k // EVERY] = piece["car.v"][-1]
            return speeds, time.perf_counter() - started

    return run


def c_loop(car: Unpacked, library: Any) -> Loop:
    """Return the loop of ``c_loop.c`` over the FMU's own functions."""
    function = library.c_loop
    numbers = [*[ctypes.c_uint] * 2, *[ctypes.c_double] * 3, *[ctypes.c_longlong] * 2]
    function.argtypes = [*[ctypes.c_void_p] * 4, *numbers, ctypes.c_void_p]

    def run(steps: int) -> tuple[Floats, float]:
        recording = np.empty(steps // EVERY + 1)
        with car.slave() as slave:
            pointers = (
                ctypes.cast(f, ctypes.c_void_p)
                for f in (slave.dll.fmi2GetReal, slave.dll.fmi2SetReal, slave.dll.fmi2DoStep)
            )
            arguments = (slave.component, *pointers, car.references["v"], car.references["force"])
            started = time.perf_counter()
            status = function(*arguments, GAIN, OFFSET, STEP, steps, EVERY, recording.ctypes.data)
            seconds = time.perf_counter() - started
        if status:
            raise RuntimeError("The car's FMU returned an error to the C loop.")
        return recording, seconds

    return run


def fmpy_loop(car: Unpacked) -> Loop:
    """Return the loop in plain Python over fmpy's own methods."""

    def run(steps: int) -> tuple[Floats, float]:
        speeds = []
        v_reference, force_reference = [car.references["v"]], [car.references["force"]]
        with car.slave() as slave:
            get_real, set_real, do_step = slave.getReal, slave.setReal, slave.doStep
            started = time.perf_counter()
            for k in range(steps):
                v = get_real(v_reference)[0]
                if k % EVERY == 0:
                    speeds.append(v)
                set_real(force_reference, [OFFSET + GAIN * v])
                do_step(k * STEP, STEP)
            if steps % EVERY == 0:
                speeds.append(get_real(v_reference)[0])
            seconds = time.perf_counter() - started
        return np.array(speeds), seconds

    return run


def compile_c_loop(folder: Path) -> Any:
    """Compile ``c_loop.c`` and load it.

    Raises
    ------
    bayesftc.fmus._compiler.CompilerError
        If there is no compiler, or it fails.
    """
    from bayesftc.fmus._compiler import compile_library
    from bayesftc.fmus._platforms import host

    library = folder / "c_loop.so"
    compile_library(Path(__file__).parent, ["c_loop.c"], library, host())
    return ctypes.CDLL(str(library))


def measure(quick: bool = False) -> Section:
    """Measure all loops in turns, after a check that they compute the same speeds."""
    from bayesftc.fmus._compiler import CompilerError

    fast, slow, rounds = (20_000, 2_000, 2) if quick else (10_000_000, 100_000, 7)
    with ExitStack() as stack:
        car = stack.enter_context(unpacked_fmu())
        loops, reason = {"engine": engine_loop(), "live": live_loop(), "fmpy": fmpy_loop(car)}, None
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            loops["c"] = c_loop(car, compile_c_loop(Path(folder)))
        except CompilerError:
            reason = "No C compiler was found, or it failed. Install one for this figure."
        speeds = {name: loop(slow)[0] for name, loop in loops.items()}
        difference = max(float(np.abs(v - speeds["engine"]).max()) for v in speeds.values())
        steps = {name: slow if name in {"live", "fmpy"} else fast for name in loops}
        candidates = {n: lambda loop=loop, k=steps[n]: k / loop(k)[1] for n, loop in loops.items()}
        rates = in_turns(candidates, rounds)
    rate, bits = "steps/s", "bit for bit" if difference == 0.0 else "not bit for bit"
    over_c = ratios(rates["engine"], rates["c"]) if "c" in rates else ()
    label = f"largest difference of the speeds over {slow} steps"
    return Section(
        "plain_loop",
        "Car FMU under proportional control",
        (
            Figure("engine", "compiled engine", rate, rates["engine"]),
            Figure("c", "loop in C", rate, rates.get("c", ()), reason=reason),
            Figure("live", "live run, one step a call", rate, rates["live"], at_least=2e5),
            Figure("fmpy", "plain fmpy loop", rate, rates["fmpy"]),
            Figure("engine_over_c", "engine / C", "", over_c, at_least=0.5, reason=reason),
            Figure("engine_over_fmpy", "engine / fmpy", "", ratios(rates["engine"], rates["fmpy"]), at_least=50.0),
            Figure("difference", label, "m/s", [difference], at_most=1e-12, note=bits),
        ),
    )
