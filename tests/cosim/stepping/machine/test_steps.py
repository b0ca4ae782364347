"""Machine code by way of C: what ordinary step functions are full of, and code that changes while a session lives."""

import gc
import platform
import types
import weakref
from typing import NamedTuple

import numpy as np
import pytest

from bayesftc.cosim import Port
from bayesftc.cosim.diagram.memory import arrange
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ops import cos, exp, independent, sin
from bayesftc.cosim.stepping.machine import steps
from bayesftc.cosim.stepping.machine.code import optimised_text
from bayesftc.cosim.stepping.machine.lowering import lowered
from bayesftc.cosim.stepping.machine.shipped import MACHINES

MODE = 1
TABLE = {"state": {"m": [[1.0, 2.0], [3.0, 4.0]]}}
NUMBERS = {"state": {"m": [0.0] * 60}}


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


def behind_a_return(y, u):
    if MODE == 1:
        y[0] = u[0]
        return
    y[0] = 2.0 * u[0]


def behind_a_continue(y, u):
    for i in range(2):
        if u.size == 2:
            y[0] = u[i]
            continue
        y[0] = u[i] + 1.0


def a_row_that_is_chosen(y, u, m):
    if u[0] > 0.0:
        row = m[0]
    else:
        row = m[1]
    best = m[0]
    for i in range(2):
        if m[i, 0] > best[0]:
            best = m[i]
    y[0] = 10.0 * row[1] + best[0]


def sincos(x):
    a = x
    for _ in range(40):
        if a > 3.0:
            a = a - 1.0 / (1.0 + a * a)
    return sin(a) + sin(a + 1.0), cos(a) + cos(a + 1.0)


def by_a_name_of_the_library(y, u):
    one, other = sincos(u[0])
    again, _ = sincos(u[1])
    y[0] = one - other * again


def a_record_of_an_earlier_round(y, u):
    for i in range(3):
        a = Pair(i + 1.0, u)
        if i == 0:
            b = a
        y[0] = b.first + b.second[0]


def names_of_c(y, u):
    offsetof, _Atomic, __int128 = u[0], u[1], 2.0
    y[0] = offsetof - _Atomic * __int128


def deep(y, u):
    if u[0] > 30.0:
        y[0] = 0.0
    elif u[0] > 29.0:
        y[0] = 1.0
    elif u[0] > 28.0:
        y[0] = 2.0
    elif u[0] > 27.0:
        y[0] = 3.0
    elif u[0] > 26.0:
        y[0] = 4.0
    elif u[0] > 25.0:
        y[0] = 5.0
    elif u[0] > 24.0:
        y[0] = 6.0
    elif u[0] > 23.0:
        y[0] = 7.0
    elif u[0] > 22.0:
        y[0] = 8.0
    elif u[0] > 21.0:
        y[0] = 9.0
    elif u[0] > 20.0:
        y[0] = 10.0
    elif u[0] > 19.0:
        y[0] = 11.0
    elif u[0] > 18.0:
        y[0] = 12.0
    elif u[0] > 17.0:
        y[0] = 13.0
    elif u[0] > 16.0:
        y[0] = 14.0
    elif u[0] > 15.0:
        y[0] = 15.0
    elif u[0] > 14.0:
        y[0] = 16.0
    elif u[0] > 13.0:
        y[0] = 17.0
    elif u[0] > 12.0:
        y[0] = 18.0
    elif u[0] > 11.0:
        y[0] = 19.0
    elif u[0] > 10.0:
        y[0] = 20.0
    elif u[0] > 9.0:
        y[0] = 21.0
    elif u[0] > 8.0:
        y[0] = 22.0
    elif u[0] > 7.0:
        y[0] = 23.0
    elif u[0] > 6.0:
        y[0] = 24.0
    elif u[0] > 5.0:
        y[0] = 25.0
    elif u[0] > 4.0:
        y[0] = 26.0
    elif u[0] > 3.0:
        y[0] = 27.0
    elif u[0] > 2.0:
        y[0] = 28.0
    elif u[0] > 1.0:
        y[0] = 29.0
    elif u[0] > 0.0:
        y[0] = 30.0
    elif u[0] > -1.0:
        y[0] = 31.0
    elif u[0] > -2.0:
        y[0] = 32.0
    elif u[0] > -3.0:
        y[0] = 33.0
    elif u[0] > -4.0:
        y[0] = 34.0
    elif u[0] > -5.0:
        y[0] = 35.0
    elif u[0] > -6.0:
        y[0] = 36.0
    elif u[0] > -7.0:
        y[0] = 37.0
    elif u[0] > -8.0:
        y[0] = 38.0
    elif u[0] > -9.0:
        y[0] = 39.0
    else:
        y[0] = -1.0


def beside_the_whole_section(y, u, outputs):
    y[0] = u[0]
    outputs[0] = outputs[0] + 40.0
    y[0] = y[0] * 1.5


def half_of_the_exponential(x):
    return 0.5 * exp(x) if x < 1.0 else 0.25 * x


def named_like_a_mark(x):
    """independent"""
    return 2.0 * x


def passes_that_end_early(y, u):
    y[0] = 0.0
    for i in independent(8):
        if named_like_a_mark(u[0]) * i > 3.0:
            break
        y[0] = y[0] + i


def independent_passes(y, u, m):
    for i in independent(2, 20):
        for j in range(3):
            m[20 * j + i] = half_of_the_exponential(u[0] * i) + j * u[1]
    for i in independent(4):
        m[i] = m[20 + i] * m[40 + i]
    y[0] = 0.0
    for i in range(60):
        y[0] = y[0] + m[i]


ALL = [
    behind_a_return, behind_a_continue, a_row_that_is_chosen, by_a_name_of_the_library, a_record_of_an_earlier_round,
    names_of_c, deep, beside_the_whole_section, independent_passes,
    passes_that_end_early,
]  # fmt: skip


@pytest.mark.parametrize("kernel", ALL, ids=lambda f: f.__name__)
def test_the_bits_are_those_of_plain_python(kernel, make_block, same_bits):
    parts = {a_row_that_is_chosen: TABLE, independent_passes: NUMBERS}.get(kernel, {})
    block = make_block(inputs=[Port("u", (2,))], outputs=[Port("y")], output=kernel, **parts)
    for u in ([0.3, 1.7], [-4.5, 0.25]):
        found = [np.array([block.online(1, compiled=compiled)(u=u).y]) for compiled in (True, False)]
        same_bits(*found)
        assert np.isfinite(found[0]).all()


@pytest.mark.skipif(platform.machine() not in MACHINES, reason="x86-64-v3 is a kind of these processors")
def test_independent_passes_are_made_in_vectors(make_block):
    """Also where they call functions, and where their places are in a table: LLVM cannot see that they are independent."""
    places = tuple(59 - i for i in range(20))

    def in_turn(y, u, m):
        for i in range(2, 20):
            m[places[i]] = half_of_the_exponential(u[0] * i) + m[places[i]]
        y[0] = m[7]

    def at_once(y, u, m):
        for i in independent(2, 20):
            m[places[i]] = half_of_the_exponential(u[0] * i) + m[places[i]]
        y[0] = m[7]

    vectors = {}
    for kernel in (in_turn, at_once):
        block = make_block(inputs=[Port("u", (2,))], outputs=[Port("y")], output=kernel, **NUMBERS)
        definition = block.define(1)
        slots, _ = arrange(block, definition, 0)
        text = lowered(*steps.text_of(definition.output, slots.sections, "step"))
        vectors[kernel] = optimised_text(text, "x86-64-v3").count("fmul <4 x double>")
    assert vectors[at_once] > 10
    assert vectors[in_turn] == 0


@pytest.fixture
def one_value(make_block):
    """Return what a step function writes, compiled."""
    return lambda kernel: make_block(outputs=[Port("y")], output=kernel).online(1)().y


def scaled(x, by=2.0):
    return x * by


def writes_scaled(y):
    y[0] = scaled(3.0)


def test_code_that_is_exchanged_in_a_function_is_compiled_anew(tmp_path, one_value):
    found = []
    for factor in (2.0, 5.0):
        path = tmp_path / f"version{factor:.0f}.py"
        path.write_text(f"def kernel(y):\n    y[0] = {factor} * 1.5\n")
        space = {}
        exec(compile(path.read_text(), str(path), "exec"), space)
        found.append(space["kernel"])
    kernel, newer = found
    assert one_value(kernel) == 3.0
    kernel.__code__ = newer.__code__  # as a notebook does that loads edited files anew
    assert one_value(kernel) == one_value(newer) == 7.5


def test_defaults_that_change_are_noticed(one_value, monkeypatch):
    assert one_value(writes_scaled) == 6.0
    monkeypatch.setattr(scaled, "__defaults__", (5.0,))
    assert one_value(writes_scaled) == 15.0


def test_a_line_that_moves_into_a_branch_makes_other_code(tmp_path, one_value):
    plain = "def kernel(y):\n    y[0] = 1.0\n    if y[0] > 2.0:\n        y[0] = 3.0\n{}    y[0] = y[0] + 4.0\n"
    path = tmp_path / "edited.py"
    path.write_text(plain.format(""))
    space = {}
    exec(compile(path.read_text(), str(path), "exec"), space)
    path.write_text(plain.format("    "))  # edited since, and not loaded
    assert one_value(space["kernel"]) == 5.0


def test_functions_that_nobody_uses_any_more_are_collected(one_value):
    def make(scale):
        def kernel(y):
            y[0] = scaled(scale)

        return kernel

    kernel = make(4.0)
    watched = weakref.ref(kernel)
    assert one_value(kernel) == 8.0
    del kernel
    gc.collect()
    assert watched() is None


def test_what_goes_wrong_inside_is_left_to_numba(one_value, monkeypatch):
    def broken(*_):
        raise RuntimeError("LLVM IR parsing error")

    monkeypatch.setattr(steps, "lowered", broken)
    kernel = types.FunctionType(writes_scaled.__code__, {"scaled": scaled}, "another")
    with pytest.raises(RuntimeError, match="LLVM IR parsing error"):  # the tests want to know
        one_value(kernel)
    monkeypatch.setattr(steps, "lenient", True)
    monkeypatch.setattr(steps, "_kernels", weakref.WeakKeyDictionary())
    monkeypatch.setattr(steps, "_addresses", {})
    monkeypatch.setattr(steps, "read_own", lambda path: None)
    assert one_value(kernel) == 6.0
    with pytest.raises(KernelError, match=r"cannot be compiled by way of C \(LLVM IR .*\); please report this error"):
        steps._compiled(kernel, {"y": ("outputs", 0, (1,))}, "entry")
