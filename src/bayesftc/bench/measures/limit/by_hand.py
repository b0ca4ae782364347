"""The whole loop of `full_loop`, written by hand in C with the engine's random numbers.

It is also made without one of its parts, and with the engine's own controller, exported as C.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.bench._slave import Unpacked
from bayesftc.bench._user_loop import COLUMNS, Setting
from bayesftc.bench.measures.full_loop import NOISE, full_diagram
from bayesftc.cosim.random import stream_key
from bayesftc.cosim.types import Floats

PARTS = {
    "random numbers": "without_random",
    "the FMU": "without_fmu",
    "sensors, fault, estimator, controller": "without_control",
    "recording": "without_recording",
}
"""Parts of a step, and the function of the loop without it."""

_FAST = ("-O3", "-march=native", "-Wno-unused-function")
"""For the processor at hand, as the engine is compiled, but also with AVX-512, which it leaves out."""

_SEED = 1


class _Car(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("component", "get", "set", "step")),
        ("output", ctypes.c_uint),
        ("inputs", ctypes.c_uint * 2),
    )


class _Setting(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in Setting.__dataclass_fields__ if not name.startswith("fault")),
        *((name, ctypes.c_longlong) for name in ("fault_start", "fault_stop")),
        ("seed", ctypes.c_uint64),
        ("keys", ctypes.c_uint64 * len(NOISE)),
        ("channels", ctypes.c_uint64 * len(NOISE)),
    )


class ByHand:
    """The loop in C over the functions of an FMU that fmpy has unpacked; see `compiled`."""

    def __init__(self, library: Any, car: Unpacked, setting: Setting):
        self._library, self._car, self._speed = library, car, setting.start_speed
        keys = (ctypes.c_uint64 * len(NOISE))(*(stream_key(name) for name, _ in NOISE))
        channels = (ctypes.c_uint64 * len(NOISE))(*(channel for _, channel in NOISE))
        numbers = {name: getattr(setting, name) for name in Setting.__dataclass_fields__}
        numbers |= {name: round(numbers[name] / setting.step) for name in ("fault_start", "fault_stop")}
        self._setting = _Setting(**numbers, seed=_SEED, keys=keys, channels=channels)

    def __call__(self, function: str, steps: int) -> tuple[Floats, float]:
        """Make `steps` steps; return the recording, as `engine_recording` does, and the time in seconds."""
        recording = np.empty((steps + 1, COLUMNS))
        references = self._car.references
        with self._car.slave(v0=self._speed) as slave:
            functions = slave.dll.fmi2GetReal, slave.dll.fmi2SetReal, slave.dll.fmi2DoStep
            inputs = (ctypes.c_uint * 2)(references["force"], references["disturbance"])
            car = _Car(slave.component, *(ctypes.cast(f, ctypes.c_void_p) for f in functions), references["v"], inputs)
            setting, rows = ctypes.byref(self._setting), ctypes.c_void_p(recording.ctypes.data)
            started = time.perf_counter()
            status = getattr(self._library, function)(ctypes.byref(car), setting, ctypes.c_longlong(steps), rows)
            seconds = time.perf_counter() - started
        if status:
            raise RuntimeError("The car's FMU returned an error to the C loop.")
        return recording, seconds


@contextmanager
def compiled(car: Unpacked, setting: Setting) -> Iterator[ByHand]:
    """Compile the loop beside the unpacked FMU, and load it.

    Raises
    ------
    bayesftc.fmus._compiler.CompilerError
        If there is no compiler, or it fails.
    """
    from bayesftc import cosim
    from bayesftc.fmus._compiler import compile_library
    from bayesftc.fmus._platforms import host

    library = car.folder / "whole_loop.so"
    cosim.export_c(full_diagram(setting), car.folder, blocks=["controller"])
    compile_library(Path(__file__).parent, [*_FAST, f"-I{car.folder}", "whole_loop.c"], library, host(), ["m"])
    yield ByHand(ctypes.CDLL(str(library)), car, setting)
