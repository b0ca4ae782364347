"""Jacobians by dual numbers, against CasADi's symbolic derivatives, finite differences and pencil and paper."""

import inspect
import math
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bayesftc.cosim import jacobian, ops
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ops import cos, maximum, select, sin
from bayesftc.cosim.stepping.fingerprint import fingerprint
from bayesftc.cosim.stepping.machine.steps import compile_kernel
from bayesftc.cosim.stepping.source.written import function_from_text

SCALE = 0.1


def product(a, b):
    return a * b / (1.0 + ops.square(a))


def mixture(x, u, z):
    """Every operation, helper functions, closures' constants, loops, integers."""
    for i in range(2):
        z[i] = x[i] + SCALE * product(sin(x[1 - i]), u[0]) - select(x[0] > u[0], x[1] * x[1], 3.0)
    z[2] = (
        ops.sqrt(ops.exp(x[0]) * maximum(x[1], 0.25)) + 2 / ops.absolute(x[0]) + cos(u[0]) + ops.log(ops.square(x[1]))
    )
    z[3] = (
        ops.minimum(x[0] * u[0], x[1]) - ops.floor(x[0] * 3) + (-x[1]) * select(ops.both(x[0] > 0, x[1] < 1), 2.0, u[0])
    )
    z[4] = 1.0 - x[0] - (u[0] - 1) * (1 / (3.0 + x[1])) / 2.0


SHAPES = {"x": 2, "u": 1, "z": 5}


def evaluated(kernel, x, u, *widths):
    matrices = [np.full((5, width), np.nan) for width in widths]
    kernel(np.asarray(x, float), np.asarray(u, float), *matrices)
    return matrices


def by_casadi(x, u):
    import casadi as ca
    from casadi_ops import OPERATIONS

    from bayesftc.cosim.stepping.tracing import rebound

    xs, us = ca.SX.sym("x", 2), ca.SX.sym("u", 1)
    z = np.empty(5, dtype=object)
    traced = rebound(mixture, OPERATIONS)
    traced([xs[0], xs[1]], [us[0]], z)
    out = ca.vertcat(*z)
    function = ca.Function("jacobians", [xs, us], [ca.jacobian(out, xs), ca.jacobian(out, us)])
    return [np.array(m) for m in function(x, u)]


numbers = st.floats(-3.0, 3.0).filter(lambda v: abs(v) > 0.05)


@settings(max_examples=60, deadline=None)
@given(x=st.tuples(numbers, numbers), u=numbers)
def test_the_jacobian_is_casadis(x, u):
    of_u, of_x = evaluated(jacobian(mixture, SHAPES, "z", ["u", "x"]), x, [u], 1, 2)
    for ours, theirs in zip((of_x, of_u), by_casadi(x, [u]), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)


def test_the_jacobian_is_that_of_finite_differences():
    x, u, h = np.array([0.7, 0.3]), np.array([0.5]), 1e-6
    (ours,) = evaluated(jacobian(mixture, SHAPES, "z", ["x"]), x, u, 2)

    def value(x):
        z = np.empty(5)
        mixture(x, u, z)
        return z

    theirs = np.column_stack([(value(x + h * e) - value(x - h * e)) / (2 * h) for e in np.eye(2)])
    np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-7)


def test_every_operation_has_its_derivative():
    """One without a rule of its own would have the derivative zero."""
    at, h = 0.7, 1e-6
    for name in sorted(set(ops.NAMES) - {"both", "either", "floor", "isnan", "negate"}):
        operation = getattr(ops, name)
        arguments = {1: "x[0]", 2: "x[0], 0.1 * x[0]", 3: "x[0] > 0.0, x[0], 1.0"}[operation.__code__.co_argcount]
        function = function_from_text("one", ("x", "y"), (f"y[0] = operation({arguments})",), {"operation": operation})
        result, ends = np.empty((1, 1)), np.empty((2, 1))
        jacobian(function, {"x": 1, "y": 1}, "y", ["x"])(np.array([at]), result)
        for end, x in zip(ends, (at - h, at + h), strict=True):
            function(np.array([x]), end)
        assert result[0, 0] == pytest.approx((ends[1, 0] - ends[0, 0]) / (2 * h), rel=1e-8), name
        assert result[0, 0] != 0.0, name


def test_a_jacobian_is_a_step_function_that_compiles_and_can_be_differentiated_again():
    def cube(x, z):
        z[0] = x[0] * x[0] * x[0]

    first = jacobian(cube, {"x": 1, "z": 1}, "z", ["x"])
    assert compile_kernel(first, {"x": ("inputs", 0, (1,)), "z_x": ("outputs", 0, (1, 1))})

    def slope(x, z):
        z[0] = 3.0 * x[0] * x[0]

    second, expected = jacobian(slope, {"x": 1, "z": 1}, "z", ["x"]), np.empty((1, 1))
    second(np.array([2.0]), expected)
    assert expected[0, 0] == 12.0


def test_the_same_function_gives_the_same_text():
    twin = FunctionType(mixture.__code__, globals())
    a, b = (jacobian(f, SHAPES, "z", ["x"]) for f in (mixture, twin))
    assert a is not b
    assert a.__code__.co_code == b.__code__.co_code
    assert a.__code__.co_consts == b.__code__.co_consts


def kinks(x, z):
    z[0] = maximum(x[0], 2.0 * x[1])
    z[1] = ops.minimum(x[0], 2.0 * x[1])
    z[2] = ops.absolute(x[2])
    z[3] = ops.sqrt(x[2])
    z[4] = ops.sqrt(ops.square(x[2]))


def test_it_is_derived_once_until_a_number_that_the_function_uses_changes(monkeypatch):
    def scaled(x, z):
        for i in range(z.shape[0]):
            z[i] = SCALE * x[0]

    def slope(size):
        made = jacobian(scaled, {"x": 1, "z": size}, "z", ["x"])
        made(np.ones(1), result := np.empty((size, 1)))
        return made, result.ravel().tolist()

    first, value = slope(1)
    assert value == [SCALE]
    assert slope(1)[0] is first
    assert slope(2)[1] == [SCALE, SCALE]
    monkeypatch.setitem(globals(), "SCALE", 7.0)
    assert slope(1)[1] == [7.0]


def test_each_shows_its_own_source_where_another_has_its_name():
    a, b = (function_from_text("f", ["y"], [f"y[0] = {value}"], {}) for value in (1.0, 2.0))
    assert [inspect.getsource(f) for f in (a, b)] == [f"def f(y):\n    y[0] = {value}\n" for value in (1.0, 2.0)]
    # Where a source is found is no part of the code, or a cache that was filled earlier would lose its use.
    moved = FunctionType(a.__code__.replace(co_filename="<f>"), a.__globals__)
    assert fingerprint(moved, "") == fingerprint(a, "") != fingerprint(b, "")


def test_derivatives_at_kinks_are_as_documented():
    """Ties are the second argument's; the root's slope at zero is infinite, and no number times zero."""
    derivative, result = jacobian(kinks, {"x": 3, "z": 5}, "z", ["x"]), np.empty((5, 3))
    with np.errstate(all="ignore"):
        derivative(np.array([2.0, 1.0, 0.0]), result)
    np.testing.assert_array_equal(result[:2, :2], [[0.0, 2.0], [0.0, 2.0]])
    np.testing.assert_array_equal(result[2:, 2], [1.0, np.inf, np.nan])


def branches(x, z):
    z[0] = x[0] if x[0] > 0 else -x[0]


def loops_on_data(x, z):
    for _ in range(x[0]):
        z[0] = 1.0


def by_math(x, z):
    z[0] = math.sin(x[0])


def by_numpy(x, z):
    z[0] = np.sin(x[0])


def by_power(x, z):
    z[0] = x[0] ** 2


def by_builtin(x, z):
    z[0] = abs(x[0])


def by_smaller(x, z):
    z[0] = min(x[0], 1.0)


def remainder(x, z):
    z[0] = x[0] % 2


def inner(x, z):
    remainder(x, z)


def slices(x, z):
    z[:] = x


def too_far(x, z):
    z[0] = x[5]


def reads_output(x, z):
    z[0] += x[0]


def two_sines(x, z):
    z[0] = sin(x[0], x[0])


def text(x, z):
    z[0] = "one"


def greedy(x, z):
    z[0] = x[0]
    x[0] = 2.0


def half_written(x, z):
    z[0] = x[0]


@pytest.mark.parametrize(
    ("function", "shapes", "wrt", "message"),
    [
        (
            branches,
            {"x": 1, "z": 1},
            ["x"],
            r"'branches' \(test_differentiation.py, line \d+\) .*branches on data; write ops.select",
        ),
        (loops_on_data, {"x": 1, "z": 1}, ["x"], "a number of data cannot be interpreted as an integer"),
        (by_math, {"x": 1, "z": 1}, ["x"], r"'by_math' .*uses 'math'.*bayesftc.cosim.ops \(.* sin, "),
        (by_numpy, {"x": 1, "z": 1}, ["x"], "uses 'np'"),
        (by_power, {"x": 1, "z": 1}, ["x"], r"uses '\*\*'.* ops.square"),
        (by_builtin, {"x": 1, "z": 1}, ["x"], "uses 'abs'.*absolute"),
        (by_smaller, {"x": 1, "z": 1}, ["x"], "uses 'min'.*minimum"),
        (
            inner,
            {"x": 1, "z": 1},
            ["x"],
            r"'remainder' .*unsupported operand type\(s\) for %: a number and 'int'\. Write plain loops",
        ),
        (slices, {"x": 2, "z": 1}, ["x"], "'slices' .*could not broadcast"),
        (too_far, {"x": 2, "z": 1}, ["x"], "'too_far' .*uses an index beyond its arguments: index 5"),
        (reads_output, {"x": 1, "z": 1}, ["x"], "read before it is written"),
        (two_sines, {"x": 1, "z": 1}, ["x"], "sin has 1 argument, not 2"),
        (text, {"x": 1, "z": 1}, ["x"], r"writes a str into z\[0\]"),
        (greedy, {"x": 1, "z": 1}, ["x"], "writes into x; it must write z only"),
        (np.sin, {"x": 1, "z": 1}, ["x"], "must be a plain Python function"),
        (half_written, {"x": 1, "z": 2}, ["x"], r"does not write z\[1\]"),
        (half_written, {"x": 1, "z": 1}, ["w"], "'w'"),
        (half_written, {"z": 1}, ["z"], "'x'"),
        (half_written, {"x": (1, 1), "z": 1}, ["x"], "only vectors"),
    ],
)
def test_what_cannot_be_differentiated_is_said(function, shapes, wrt, message):
    with pytest.raises(KernelError, match=message):
        jacobian(function, shapes, "z", wrt)
