"""Every operation of step functions gives the same bits in all forms in which a step function runs."""

import ctypes
import math
import shutil
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_array_equal

from bayesftc.cosim import Block, Definition, Diagram, Port, ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ops import (
    absolute,
    both,
    cos,
    either,
    exp,
    floor,
    isnan,
    log,
    maximum,
    minimum,
    negate,
    select,
    sin,
    sqrt,
    square,
)

TINY, LEAST, HUGE = np.finfo(float).tiny, np.nextafter(0.0, 1.0), np.finfo(float).max
MAGNITUDES = (
    0.0, LEAST, TINY / 3, TINY, 1e-200, 1e-8, 0.1, 0.5, np.nextafter(0.5, 0), 1.0, np.nextafter(1.0, 2), 1.5, math.pi, 22.0,
    709.782712893384, 709.7827128933841, 745.1332191019412, 1e5 + 0.1, 2.0**52 - 0.5, 2.0**53, 1e22, 1e300, HUGE,
    math.inf, math.nan,
)  # fmt: skip
SPECIAL = np.array([s * m for m in MAGNITUDES for s in (1.0, -1.0)])
RANDOM = np.random.default_rng(7)
NUMBERS = np.concatenate([
    SPECIAL,
    RANDOM.integers(0, 2**64, 600, dtype=np.uint64).view(np.float64),  # any bit patterns
    RANDOM.normal(size=600) * 10.0 ** RANDOM.integers(-6, 7, 600),
])  # fmt: skip
A = np.concatenate([NUMBERS, np.repeat(SPECIAL, len(SPECIAL))])
B = np.concatenate([RANDOM.permutation(NUMBERS), np.tile(SPECIAL, len(SPECIAL))])
OF_CASADI = ("cos", "exp", "log", "sin")
RESULTS = (*ops.NAMES, "select_if_not_zero")


def all_operations(a, b, y):
    for i in range(a.shape[0]):
        p, q = a[i], b[i]
        y[0, i] = absolute(p)
        y[1, i] = select(both(p < q, q > 0.0), 1.0, 0.0)
        y[2, i] = cos(p)
        y[3, i] = select(either(p < q, q > 0.0), 1.0, 0.0)
        y[4, i] = exp(p)
        y[5, i] = floor(p)
        y[6, i] = select(isnan(p), 1.0, 0.0)
        y[7, i] = log(p)
        y[8, i] = maximum(p, q)
        y[9, i] = minimum(p, q)
        y[10, i] = select(negate(p < q), 1.0, 0.0)
        y[11, i] = select(p < q, p, q)
        y[12, i] = sin(p)
        y[13, i] = sqrt(p)
        y[14, i] = square(p)
        y[15, i] = select(q, p, 1.0)  # a number as a condition: NaN holds, both zeros do not


class Operations(Block):
    """Computes everything from its parameters, so that the compiler cannot know the numbers."""

    outputs = (Port("y", (len(RESULTS), len(A))),)

    def define(self, step):
        return Definition(all_operations, parameters={"a": A, "b": B})


@pytest.fixture(scope="module")
def plain():
    y = np.empty((len(RESULTS), len(A)))
    with np.errstate(all="ignore"):
        all_operations(A, B, y)
    return y


def assert_same_bits(actual, expected):
    """Compare bit for bit; one NaN is as good as another (no operation can tell them apart)."""
    for name, x, y in zip(RESULTS, actual, expected, strict=True):
        differs = (x.view(np.uint64) != y.view(np.uint64)) & ~(np.isnan(x) & np.isnan(y))
        where = np.flatnonzero(differs)[:5]
        assert not len(where), f"{name} of {A[where]}, {B[where]}: {x[where]} instead of {y[where]}"


def test_every_operation_is_here(plain):
    assert ops.NAMES == tuple(sorted(ops.__all__)) == RESULTS[:-1]
    assert np.isfinite(plain).any(axis=1).all()


def test_plain_python_against_numpy(plain):
    with np.errstate(all="ignore"):
        expected = {
            "absolute": np.abs(A), "both": (A < B) & (B > 0), "either": (A < B) | (B > 0), "floor": np.floor(A),
            "isnan": np.isnan(A), "maximum": np.where(A > B, A, B), "minimum": np.where(A < B, A, B), "negate": ~(A < B),
            "select": np.where(A < B, A, B), "sqrt": np.sqrt(A), "square": A * A,
            "select_if_not_zero": np.where(B != 0, A, 1.0),
        }  # fmt: skip
        for name, values in expected.items():
            assert_array_equal(plain[RESULTS.index(name)], values.astype(float), err_msg=name)
        for name, function in {"exp": np.exp, "log": np.log, "sin": np.sin, "cos": np.cos}.items():
            np.testing.assert_allclose(plain[RESULTS.index(name)], function(A), rtol=5e-16, atol=0, err_msg=name)


def test_select_has_no_negative_zero():
    for condition in (True, False):
        assert not np.signbit(select(condition, -0.0, -0.0))


def by_numba(kernel, sections):
    from bayesftc.cosim.stepping.compiler import compile_by_numba

    return compile_by_numba(kernel, sections, KernelError())


def by_c(kernel, sections):
    from bayesftc.cosim.stepping.machine.steps import compile_kernel, text_of

    assert "op_select(" in text_of(kernel, sections, "entry")[0]  # which raises where C is not written for something
    return compile_kernel(kernel, sections)


@pytest.mark.parametrize("compiled", [by_c, by_numba])
def test_one_compiled_call(plain, compiled):
    y = np.empty_like(plain)
    parameters = np.concatenate([A, B])
    sections = {"a": ("parameters", 0, A.shape), "b": ("parameters", len(A), B.shape), "y": ("outputs", 0, y.shape)}
    address = compiled(all_operations, sections)
    call = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64)(address)
    assert call(0, parameters.ctypes.data, 0, y.ctypes.data, 0.0, 0) == 0
    assert_same_bits(y, plain)


def test_compiled_loop(plain):
    diagram = Diagram(dt=1)
    diagram.add(Operations(), name="operations")
    for engine in ("compiled", "interpreted"):
        assert_same_bits(diagram.simulate(0, engine=engine)["operations.y"][0], plain)


@pytest.fixture(scope="module")
def traced():
    ca = pytest.importorskip("casadi", reason="CasADi is not installed (extra 'test')")
    from casadi_ops import OPERATIONS as f

    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        a, b = ca.SX.sym("a"), ca.SX.sym("b")
        less, positive = a < b, b > 0
        conditions = {
            "both": f["both"](less, positive), "either": f["either"](less, positive), "isnan": f["isnan"](a),
            "negate": f["negate"](less),
        }  # fmt: skip
        results = []
        for name in ops.NAMES:
            if name in conditions:
                results.append(f["select"](conditions[name], 1.0, 0.0))
            elif name == "select":
                results.append(f["select"](less, a, b))
            else:
                results.append(f[name](a, b) if name in {"maximum", "minimum"} else f[name](a))
        results.append(f["select"](b, a, 1.0))
        return ca.Function("operations", [a, b], [ca.vertcat(*results)])
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)


def test_casadi_covers_every_operation():
    pytest.importorskip("casadi", reason="CasADi is not installed (extra 'test')")
    from casadi_ops import OPERATIONS

    assert tuple(OPERATIONS) == ops.NAMES


def assert_same_by_casadi(actual, plain):
    """Compare bit for bit, but the functions that CasADi takes from its library of C: these round differently."""
    expected, actual = plain.copy(), actual.copy()
    for name in OF_CASADI:
        row = RESULTS.index(name)
        np.testing.assert_array_max_ulp(actual[row], expected[row], maxulp=1)
        expected[row] = actual[row] = 0.0
    assert_same_bits(actual, expected)


def test_casadi_function(traced, plain):
    assert_same_by_casadi(np.asarray(traced(A[np.newaxis], B[np.newaxis])), plain)


def test_casadi_c_code(traced, plain, tmp_path):
    compiler = shutil.which("gcc")
    if compiler is None or sys.platform == "win32":
        pytest.skip("there is no gcc to compile the C code with")
    source, library = tmp_path / "operations.c", tmp_path / "operations.so"
    source.write_text(_c_code(traced))
    options = ["-O2", "-std=c99", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([compiler, *options, str(source), "-o", str(library), "-lm"], check=True, capture_output=True)
    doubles = ctypes.POINTER(ctypes.c_double)
    function = ctypes.CDLL(str(library)).operations
    function.argtypes = [
        ctypes.POINTER(doubles),
        ctypes.POINTER(doubles),
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_int,
    ]
    y = np.empty((len(A), len(RESULTS)))
    scratch = np.empty(max(traced.sz_w(), 1))
    for i in range(len(A)):
        arguments = (doubles * 2)(*(ctypes.cast(x.ctypes.data + 8 * i, doubles) for x in (A, B)))
        result = (doubles * 1)(ctypes.cast(y.ctypes.data + y.strides[0] * i, doubles))
        assert function(arguments, result, None, scratch.ctypes.data, 0) == 0
    assert_same_by_casadi(np.ascontiguousarray(y.T), plain)


def _c_code(function):
    import casadi as ca

    generator = ca.CodeGenerator("operations.c")
    generator.add(function)
    return generator.dump()


@given(st.floats(), st.floats())
def test_no_operation_raises_and_select_picks(a, b):
    a, b = np.float64(a), np.float64(b)
    with np.errstate(all="ignore"):
        for unary in (absolute, cos, exp, floor, isnan, log, sin, sqrt, square, negate):
            unary(a)
        for binary in (both, either, maximum, minimum):
            binary(a, b)
        assert select(True, a, b) == a or np.isnan(a)
        assert select(False, a, b) == b or np.isnan(b)
