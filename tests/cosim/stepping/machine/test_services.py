"""The engine's own functions: shipped as text, kept as machine code, and loaded without numba."""

import json
import lzma
import os
import platform
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bayesftc.cosim.random import CHUNK, SPARE, draw_chunk, stream_key
from bayesftc.cosim.stepping.compiler import compile_raw, service_text
from bayesftc.cosim.stepping.machine import shipped
from bayesftc.cosim.stepping.machine.code import closed_code, load
from bayesftc.cosim.types import ENTRY

ROOT = Path(__file__).parents[4]
TOOL = ROOT / "tools" / "engine_text.py"
FUNCTIONS = runpy.run_path(str(TOOL))["functions"]()

STEPS = """
import json, sys
from fractions import Fraction
import numpy as np
from bayesftc import cosim, fmus
from bayesftc.cosim.stepping.kept import STATISTICS
from bayesftc.cosim.stepping.machine import shipped
if EDITED:
    shipped.sources_digest = lambda: "of edited sources"
car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}).instantiate(Fraction(1, 50), "car")
u, y, speed = np.array([100.0, 0.0]), np.zeros(1), []
for k in range(10):
    assert car.update(u, y, k / 50) == car.output(u, y, (k + 1) / 50) == 0
    speed.append(y[0])
print(json.dumps([STATISTICS, "numba" in sys.modules, speed]))
"""

on_x86 = pytest.mark.skipif(platform.machine() not in shipped.MACHINES, reason="the text is for 64-bit x86")


@on_x86
def test_they_are_loaded_without_numba_and_made_anew_if_damaged(python, tmp_path):
    statistics, imported, made = python(STEPS.replace("EDITED", "False"), cache=tmp_path)
    assert (statistics, imported) == ({"compiled": 2, "loaded": 0}, False)
    assert python(STEPS.replace("EDITED", "False"), cache=tmp_path) == [{"compiled": 0, "loaded": 2}, False, made]
    for file in (tmp_path / "compiled").glob("service_*.o"):
        file.write_bytes(file.read_bytes()[:-1])
    assert python(STEPS.replace("EDITED", "False"), cache=tmp_path) == [{"compiled": 2, "loaded": 0}, False, made]
    assert python(STEPS.replace("EDITED", "True"), cache=tmp_path / "another") == [
        {"compiled": 2, "loaded": 0},
        True,
        made,
    ]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_needs_nothing_of_numba(name):
    assert closed_code(service_text(FUNCTIONS[name], name), name)


@on_x86
def test_the_shipped_text_is_that_of_the_present_sources():
    missing = [name for name in FUNCTIONS if shipped.shipped_text(name) is None]
    assert not missing, "python tools/engine_text.py"


@on_x86
def test_shipped_text_draws_the_numbers_of_the_present_function():
    streams = np.array([[stream_key("s.n"), 3, 1, 0], [stream_key("s.n"), 0, 0, 1]], dtype=np.uint64)
    found = []
    entries = [compile_raw(FUNCTIONS["service_draw"]).address]
    entries += [load(closed_code(shipped.shipped_text("service_draw"), "service_draw"), "service_draw")]
    for address in entries:
        rows = np.empty((2 + SPARE, CHUNK))
        words = np.array([streams.ctypes.data, 2, CHUNK, rows.ctypes.data, CHUNK, 11], dtype=np.int64)
        assert ENTRY(address)(0, words.ctypes.data, 0, 0, 0.0, 0) == 0
        found.append(rows[:2])
    np.testing.assert_array_equal(*found)
    drawn = np.empty((CHUNK, 2))
    draw_chunk(11, streams, CHUNK, drawn)
    np.testing.assert_array_equal(drawn.T, found[0])


@pytest.mark.slow
@on_x86
def test_the_shipped_text_is_what_numba_makes(tmp_path):
    script = f"import runpy, sys; sys.stdout.buffer.write(runpy.run_path({str(TOOL)!r})['content']())"
    generic = runpy.run_path(str(TOOL))["GENERIC"]
    made = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, **generic}, capture_output=True, check=True
    )
    kept = json.loads(lzma.decompress(shipped.FILE.read_bytes()))
    assert set(json.loads(made.stdout)["texts"]) == set(kept["texts"])
    # Names of numba's versions and of functions stand in the text, so that the machine code is compared.
    for name, text in json.loads(made.stdout)["texts"].items():
        assert len(closed_code(text, name)) == len(closed_code(kept["texts"][name], name)), name


def test_code_that_calls_a_function_of_a_library_is_not_kept():
    text = "declare void @outside()\ndefine i32 @entry() {{\n  {}\n  ret i32 0\n}}\n"
    assert closed_code(text.format("call void @outside()"), "entry") == b""
    assert closed_code(text.format(""), "entry")
