"""The engine's own functions for FMUs: kept as machine code, and loaded without numba."""

import pytest

from bayesftc.cosim.fmi.running import kernels, typed_kernels
from bayesftc.cosim.isolation import kernels as isolated
from bayesftc.cosim.stepping.compiler import service_text
from bayesftc.cosim.stepping.machine.code import closed_code

ENDS = {role: getattr(isolated, role) for role in ("output", "update", "serve")}
FUNCTIONS = {**kernels.FUNCTIONS, **{("typed", *key): f for key, f in typed_kernels.FUNCTIONS.items()}, **ENDS}

STEPS = """
import json, sys
from fractions import Fraction
import numpy as np
from bayesftc import cosim, fmus
from bayesftc.cosim.stepping.kept import STATISTICS
car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}).instantiate(Fraction(1, 50), "car")
u, y, speed = np.array([100.0, 0.0]), np.zeros(1), []
for k in range(10):
    assert car.update(u, y, k / 50) == car.output(u, y, (k + 1) / 50) == 0
    speed.append(y[0])
print(json.dumps([STATISTICS, "numba" in sys.modules, speed]))
"""


def test_they_are_loaded_without_numba_and_made_anew_if_damaged(python, tmp_path):
    statistics, imported, made = python(STEPS, cache=tmp_path)
    assert (statistics, imported) == ({"compiled": 2, "loaded": 0}, True)
    assert python(STEPS, cache=tmp_path) == [{"compiled": 0, "loaded": 2}, False, made]
    for file in (tmp_path / "compiled").glob("service_*.o"):
        file.write_bytes(file.read_bytes()[:-1])
    assert python(STEPS, cache=tmp_path) == [{"compiled": 2, "loaded": 0}, True, made]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=map(str, FUNCTIONS))
def test_each_needs_nothing_of_numba(function):
    assert closed_code(service_text(function, "entry"), "entry")


def test_code_that_calls_a_function_of_a_library_is_not_kept():
    text = "declare void @outside()\ndefine i32 @entry() {{\n  {}\n  ret i32 0\n}}\n"
    assert closed_code(text.format("call void @outside()"), "entry") == b""
    assert closed_code(text.format(""), "entry")
