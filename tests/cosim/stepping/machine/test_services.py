"""The engine's own functions: shipped as text, kept as machine code, and loaded without numba."""

import ast
import json
import lzma
import os
import platform
import runpy
import subprocess
import sys
from functools import cache
from pathlib import Path
from types import FunctionType

import numpy as np
import pytest

from bayesftc.cosim.random import CHUNK, SPARE, draw_chunk, stream_key
from bayesftc.cosim.stepping.compiler import service_text
from bayesftc.cosim.stepping.machine import services, shipped
from bayesftc.cosim.stepping.machine.code import closed_code, load
from bayesftc.cosim.types import ENTRY

ROOT = Path(__file__).parents[4]
TOOL = ROOT / "tools" / "engine_text.py"
FUNCTIONS = runpy.run_path(str(TOOL))["functions"]()

# The FMU's two step functions, and the two of its surroundings.
STEPS = """
import json, sys
from fractions import Fraction
import numpy as np
from bayesftc import cosim, fmus
from bayesftc.cosim.stepping.kept import STATISTICS
from bayesftc.cosim.stepping.machine import services, shipped
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


@pytest.mark.slow
@on_x86
def test_they_are_loaded_without_numba_and_made_anew_if_damaged(python, tmp_path):
    statistics, imported, made = python(STEPS.replace("EDITED", "False"), cache=tmp_path)
    assert (statistics, imported) == ({"compiled": 4, "loaded": 0}, False)
    assert python(STEPS.replace("EDITED", "False"), cache=tmp_path) == [{"compiled": 0, "loaded": 4}, False, made]
    for file in (tmp_path / "compiled").glob("service_*.o"):
        file.write_bytes(file.read_bytes()[:-1])
    assert python(STEPS.replace("EDITED", "False"), cache=tmp_path) == [{"compiled": 4, "loaded": 0}, False, made]


@pytest.mark.slow
@on_x86
def test_numba_makes_them_anew_after_an_edit_of_their_sources(python, tmp_path):
    _, _, made = python(STEPS.replace("EDITED", "False"), cache=tmp_path / "one")
    anew = python(STEPS.replace("EDITED", "True"), cache=tmp_path / "another")
    assert anew == [{"compiled": 4, "loaded": 0}, True, made]


@cache
def present_code(name):
    """Return the machine code of a present function, which numba translates."""
    return closed_code(service_text(FUNCTIONS[name], f"present_{name}"), f"present_{name}")


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_each_needs_nothing_of_numba(name):
    assert present_code(name)


@on_x86
def test_the_shipped_text_is_that_of_the_present_sources():
    missing = [name for name in FUNCTIONS if shipped.shipped_text(name) is None]
    assert not missing, "python tools/engine_text.py"


@pytest.mark.slow
@on_x86
def test_shipped_text_draws_the_numbers_of_the_present_function():
    streams = np.array([[stream_key("s.n"), 3, 1, 0], [stream_key("s.n"), 0, 0, 1]], dtype=np.uint64)
    found = []
    entries = [load(present_code("service_draw"), "present_service_draw")]
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


def functions_behind():
    """Return all functions of the package behind the engine's own, intrinsics among them."""
    found, left = set(), list(FUNCTIONS.values())
    while left:
        function = getattr(value := left.pop(), "_defn", value)
        if isinstance(function, FunctionType) and function.__module__.startswith("bayesftc.") and function not in found:
            found.add(function)
            left += [function.__globals__.get(name) for name in function.__code__.co_names]
    return found


def test_the_sources_of_the_text_are_complete():
    """Those of all functions behind it, and those from which these import anything, such as a number."""
    modules = {function.__module__ for function in functions_behind()}
    imported = set()
    for name in modules:
        for node in ast.walk(ast.parse(Path(sys.modules[name].__file__).read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesftc."):
                imported |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)} & set(sys.modules)
    files = {Path(sys.modules[name].__file__).resolve() for name in modules | imported}
    # Types and errors have no part in compiled code, and an empty package neither.
    spared = {(shipped.ROOT / name).resolve() for name in ("types.py", "errors.py", "isolation/__init__.py")}
    assert files - spared <= {(shipped.ROOT / name).resolve() for name in shipped.SOURCES}


@pytest.mark.slow
@on_x86
def test_the_shipped_text_is_what_numba_makes():
    script = f"import runpy, sys; sys.stdout.buffer.write(runpy.run_path({str(TOOL)!r})['content']())"
    generic = runpy.run_path(str(TOOL))["GENERIC"]
    made = subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, **generic}, capture_output=True, check=True
    )
    assert json.loads(made.stdout) == json.loads(lzma.decompress(shipped.FILE.read_bytes()))


def test_code_that_calls_a_function_of_a_library_is_not_kept():
    text = "declare void @outside()\ndefine i32 @entry() {{\n  {}\n  ret i32 0\n}}\n"
    assert closed_code(text.format("call void @outside()"), "entry") == b""
    assert closed_code(text.format(""), "entry")


def test_text_of_a_newer_llvm_is_not_included_in_loops(monkeypatch):
    services.known_text.cache_clear()
    monkeypatch.setattr(services, "shipped_text", {"service_new": "define i32 @service_new() newer {"}.get)
    assert services.known_text("service_new") == services.known_text("service_unknown") == ""
    services.known_text.cache_clear()
