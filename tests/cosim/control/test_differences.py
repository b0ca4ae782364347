"""Derivatives by differences, and what a loop's analysis makes of them."""

from dataclasses import dataclass

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import expm

from bayesftc import controllers, cosim
from bayesftc.controllers import design
from bayesftc.cosim.control.differences import slopes

GRAVITY, MASS, CURRENT = 9.81, 0.068, 0.9


def ball(gap):
    """A ball that a magnet holds at a gap in m: ``dv/dt = g - k (i / x)^2``, and its exact derivative by the gap."""
    k = GRAVITY * (gap / CURRENT) ** 2
    plant = control.nlsys(
        lambda t, x, u, p: [x[1], GRAVITY - k * (x[2] / x[0]) ** 2, (u[0] - 11.0 * x[2]) / 0.4],
        lambda t, x, u, p: [x[0], x[2]],
        inputs=["voltage"], outputs=["gap", "current"], states=["x", "v", "i"],
    )  # fmt: skip
    A = np.array([[0, 1, 0], [2 * GRAVITY / gap, 0, -2 * GRAVITY / CURRENT], [0, 0, -11.0 / 0.4]])
    return cosim.StateSpace(plant, initial=[gap, 0.0, CURRENT]), A, np.array([[0], [0], [1 / 0.4]])


@given(st.floats(-9, 9), st.floats(0.1, 3.0), st.sampled_from([0.0, 1e3]))
def test_the_unit_of_an_element_does_not_matter(decade, x, offset):
    unit = 10.0**decade

    def f(z):
        return np.array([1.0 / (z[0] / unit) ** 2 + offset, np.sin(z[0] / unit), 2.0, 3.0 * z[0] / unit])

    found, kink = slopes(f, np.array([x * unit]))
    known = np.array([-2.0 / x**3, np.cos(x), 0.0, 3.0])
    np.testing.assert_allclose(found[:, 0] * unit, known, rtol=1e-6, atol=1e-8 * (1.0 + offset))
    assert not kink


@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-8])
def test_a_feature_that_is_narrow_beside_the_largest_steps_is_found(width):
    found, kink = slopes(lambda z: np.array([np.tanh(z[0] / width), np.clip(z[0] / width, -1, 1)]), np.zeros(1))
    np.testing.assert_allclose(found[:, 0] * width, 1.0, rtol=1e-3)
    assert not kink


@pytest.mark.parametrize("x", [0.0, -2.3e-33, 1e-17, 7.9e-5])
@pytest.mark.parametrize("balance", [1.0, 1e3, 1e6])
def test_the_rounding_of_balanced_terms_is_no_kink(x, balance):
    """The temperature of a converter: losses by the squares of two currents, one of which is about zero, and cooling."""
    here = 0.4 * (21.0**2 + x**2)

    def f(z):
        return np.array([balance * (0.4 * (21.0**2 + z[0] ** 2) - here), balance * (z[0] + 404.0) - balance * 404.0])

    found, kink = slopes(f, np.array([x]))
    assert not kink
    np.testing.assert_allclose(found[:, 0] / balance, [0.8 * x, 1.0], atol=1e-6)


def test_a_jump_is_said_and_a_number_that_is_missing_has_no_effect():
    assert slopes(np.sign, np.zeros(1))[1]
    found, _ = slopes(lambda z: np.array([z[0] ** 2, 1.0]), np.array([3.0, np.nan]))
    np.testing.assert_allclose(found, [[6.0, 0.0], [0.0, 0.0]], rtol=1e-9)


@pytest.mark.parametrize("width", [0.3, 0.05, 5e-3, 1e-3])
@pytest.mark.parametrize("offset", [0.0, 1e3, -1e6])
def test_a_function_is_flat_within_a_dead_band(width, offset):
    """The larger steps leave it, and the derivative was NaN."""

    def f(z):
        beyond = z[0] - np.clip(z[0], -width, width)
        return np.array([beyond, beyond / 25.0 + offset, 3.0 * z[0]])

    for place in (0.0, 0.4 * width, -0.9 * width):
        found, kink = slopes(f, np.array([place]))
        np.testing.assert_allclose(found[:, 0], [0.0, 0.0, 3.0], rtol=1e-9)
        assert not kink


@pytest.mark.parametrize("x", [0.0, 0.123456, -1.7])
@pytest.mark.parametrize("round_off", [lambda f: np.round(f, 4), lambda f: np.float32(f + 1e3)])
def test_the_slope_of_a_function_in_steps_is_that_over_many_of_them(round_off, x):
    """An encoder, and an FMU that computes with single precision, are no dead bands."""
    found, _ = slopes(lambda z: np.array([float(round_off(2.0 * z[0]))]), np.array([x]))
    assert found[0, 0] == pytest.approx(2.0, rel=0.05)


@given(st.floats(0, 12), st.floats(-100, 100))
def test_a_derivative_is_finite_where_rounding_hides_the_effect_of_most_steps(decade, x):
    large = 10.0**decade
    found, _ = slopes(lambda z: np.array([(z[0] + large) - z[0]]), np.array([x]))
    assert abs(found[0, 0]) <= 1e-13 * (large + abs(x)) / 0.1


@pytest.mark.parametrize("gap", [6e-3, 1e-4, 2e-6])
def test_a_small_state_has_the_model_and_the_loop_of_its_equations(gap, recwarn):
    plant, A, B = ball(gap)
    std = [gap / 300, gap / 300, 5e-3]
    controller = design(
        plant, measured=["gap", "current"], sensors=[2, 1], sensor_std=std, actuated="voltage", goal="gap", dt=0.001,
        noise={"voltage": 0.1}, acceptable_error=gap / 10, acceptable_control=2.0,
    )  # fmt: skip
    assert not [each for each in recwarn if issubclass(each.category, controllers.PoorFitWarning)]
    whole = expm(0.001 * np.block([[A, B], [np.zeros((1, 4))]]))
    np.testing.assert_allclose(controller.model.A[:3, :3], whole[:3, :3], rtol=1e-7, atol=1e-9)
    sensors = cosim.Sensors(count=(2, 1), std=std)
    loop = cosim.closed_loop(
        plant, controller, control="voltage", measured=["gap", "current"], sensors=sensors, reference=gap
    )
    exact = control.ss(whole[:3, :3], whole[:3, 3:], [[1, 0, 0], [0, 0, 1]], 0, 0.001)
    np.testing.assert_allclose(loop.margins(), loop.linear(plant=exact).margins(), rtol=1e-6)
    assert loop.step_info()["SteadyStateValue"] == pytest.approx(1.0, abs=1e-6)


def _read(s, y):
    y[0] = s[0]


def _move(u, s, p):
    s[0] = p[0] * (s[0] - 3.0) + 3.0 + p[1] * u[0]


@dataclass(frozen=True)
class Unstable(cosim.Block):
    """A state that runs away from 3, with parameters, as an FMU has them."""

    inputs = (cosim.Port("u", feedthrough=False),)
    outputs = (cosim.Port("y"),)
    checks_finite = True

    def define(self, step):
        """See `Block.define`."""
        return cosim.Definition(_read, update=_move, state={"s": 3.1}, parameters={"p": [1.05, 0.1]})


def test_the_fmu_of_a_plant_has_the_margins_of_the_plant(tmp_path):
    fmu = cosim.FMU(cosim.export_fmu(Unstable(), tmp_path / "unstable.fmu", dt=0.01))
    model = controllers.LinearModel([[1.05]], [[0.1]], [[1], [1]], 1e-4, 1e-4, dt=0.01)
    controller = design(model, acceptable_error=1.0, acceptable_control=1.0)
    loops = [
        cosim.closed_loop(plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.01), reference=0.0)
        for plant in (Unstable(), fmu)
    ]
    block, exported = (loop.margins() for loop in loops)
    assert 0.1 < block.lowest_gain < 0.9  # an unstable plant needs a gain
    np.testing.assert_allclose(exported._replace(delay=0.0), block._replace(delay=0.0), rtol=1e-6)
    assert exported.delay == pytest.approx(
        block.delay, rel=1e-3
    )  # its copies of outputs hide what it does within a sample
    poles = loops[1].poles()
    np.testing.assert_allclose(poles[np.abs(poles) > 1e-6], loops[0].poles(), rtol=1e-6)
