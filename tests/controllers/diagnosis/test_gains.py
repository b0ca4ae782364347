"""Wrong effects of several controls at once, and plants that are linear."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers.diagnosis.words.inputs import of_inputs
from bayesftc.controllers.diagnosis.words.sentences import sentence
from bayesftc.cosim.diagram.wiring import is_linear

NAMES = controllers.SignalNames(controls=["heat", "feed"], sensors=["T", "T", "c", "c"], states=["T", "c"])
MODEL = controllers.LinearModel(
    [[0.95, 0.02], [0.0, 0.9]],
    [[0.1, -0.05], [0.0, 0.1]],
    np.eye(2)[[0, 0, 1, 1]],
    1e-4,
    [0.01] * 4,
    dt=1.0,
    names=NAMES,
)


def recorded(factors, seed, u=None):
    """Return samples and controls of the model's plant, in which each control has a factor."""
    rng, x = np.random.default_rng(seed), np.zeros((400, 2))
    u = np.repeat(rng.normal(size=(80, 2)), 5, axis=0) if u is None else u
    for k in range(399):
        x[k + 1] = MODEL.A @ x[k] + MODEL.B @ (np.array(factors) * u[k]) + 0.01 * rng.standard_normal(2)
    return x[:, [0, 0, 1, 1]] + 0.1 * rng.standard_normal((400, 4)), u


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("factors", [(1.2, 0.8), (0.7, 1.3)])
def test_the_effect_of_each_control_is_measured(factors, seed):
    finding = controllers.diagnose_recording(MODEL, *recorded(factors, seed))
    assert finding.kind == "gains"
    found, std = np.split(np.array(finding.values), 2)
    assert np.all(np.abs(found - factors) < 4 * std)
    assert np.all(std < 0.05)
    assert f"the control heat moves the plant {found[0]:.3g} (standard deviation" in finding.sentence
    assert f"the control feed {found[1]:.3g} (standard deviation" in finding.sentence


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("factors", [(1.0, 0.7), (1.3, 1.0)])
def test_the_effect_of_one_control_is_named_alone(factors, seed):
    finding = controllers.diagnose_recording(MODEL, *recorded(factors, seed))
    wrong = int(np.argmax(np.abs(np.array(factors) - 1.0)))
    assert finding.kind == "gain"
    assert not {"gain", "gains"} & set(finding.others)
    assert finding.values == (pytest.approx(factors[wrong], abs=0.05), wrong)


def test_where_only_the_sum_of_two_effects_shows_either_control_may_be_wrong():
    model = controllers.LinearModel([[0.95]], [[0.1, 0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=1.0)
    rng, x = np.random.default_rng(0), np.zeros((400, 1))
    u = np.repeat(np.repeat(rng.normal(size=(80, 1)), 5, axis=0), 2, axis=1)  # the two always move together
    for k in range(399):
        x[k + 1] = 0.95 * x[k] + 0.1 * (1.2 + 0.9) * u[k, :1] + 0.01 * rng.standard_normal()
    finding = controllers.diagnose_recording(model, x + 0.1 * rng.standard_normal((400, 2)), u)
    assert (finding.kind, finding.others[0]) == ("gain", "gain")
    for j in range(2):  # as if the other one were right
        assert f"control {j} moves the plant {finding.values[0]:.3g} times" in finding.sentence
    assert finding.values[0] == pytest.approx(1.1, abs=0.05)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(5))
def test_a_control_without_effect_is_no_reversed_one(seed):
    """Noise decided between the effects of both, a reversed control, and other dynamics."""
    A, B = np.array([[0.95, 0.05], [0.0, 0.9]]), np.array([[0.1, 0.02], [0.0, 0.1]])
    model = controllers.LinearModel(A, B, np.eye(2)[[0, 0, 1, 1]], 1e-4, 0.01, dt=1.0)
    rng, x = np.random.default_rng(seed), np.zeros((400, 2))
    u = np.repeat(rng.normal(size=(80, 2)), 5, axis=0)
    for k in range(399):
        x[k + 1] = A @ x[k] + B @ ([0.0, 2.0] * u[k]) + 0.01 * rng.standard_normal(2)
    finding = controllers.diagnose_recording(model, x[:, [0, 0, 1, 1]] + 0.1 * rng.standard_normal((400, 4)), u)
    assert finding.kind in {"gain", "gains"}
    assert "opposite" not in finding.sentence


def test_each_of_several_controls_is_listed_with_its_factor():
    model = controllers.LinearModel(np.eye(3), np.eye(3), np.eye(3), 1e-3, 0.01, dt=1.0)
    said = sentence("gains", (0.5, 0.8, 0.71234, 0.01, 0.02, 0.034), model)
    assert (
        "control 0 moves the plant 0.5 (standard deviation 0.01) times as strongly as in the model, control 1 0.8 (standard "
        "deviation 0.02) and control 2 0.712 (standard deviation 0.03)"
    ) in said.replace("Control 0", "control 0")
    assert "A dead band" in said
    assert "A dead band" not in sentence("gains", (0.5, 0.8, 1.2, 0.01, 0.02, 0.03), model)
    said = of_inputs(None)["gains"]((0.5, 0.8, 0.01, 0.02), MODEL)
    assert said.startswith("heat moves the plant 0.5 (standard deviation 0.01) times")
    assert "noise in them" in said


def loop_of(bend=0.0, **faults):
    """Return the loop of a plant that is linear, or slower where it is far from zero."""
    signals = {"inputs": ["u"], "outputs": ["x"]}
    linear = control.ss([[-1.0]], [[1.0]], [[1.0]], 0, **signals)
    bent = control.nlsys(lambda t, x, u, p: -x - bend * x**2 + u, lambda t, x, u, p: x, states=1, **signals)
    plant = cosim.StateSpace(bent, feedthrough=False) if bend else cosim.StateSpace(linear)
    controller = controllers.design(
        linear,
        measured="x",
        actuated="u",
        sensors=2,
        sensor_std=0.02,
        dt=0.1,
        acceptable_error=0.1,
        acceptable_control=1.0,
    )
    reference = cosim.Sine(amplitude=1.0, period=8.0, offset=1.0)
    return cosim.closed_loop(
        plant,
        controller,
        control="u",
        measured="x",
        sensors=cosim.Sensors(2, 0.02),
        reference=reference,
        input_faults=faults,
    )


def test_a_loop_of_linear_systems_is_linear():
    assert is_linear(loop_of())
    assert is_linear(loop_of(u=cosim.Bias(magnitude=0.1)))
    assert not is_linear(loop_of(bend=0.2))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(2))
def test_a_plant_that_is_known_to_be_linear_is_not_called_nonlinear(seed):
    """The same run, as if it were that of a linear plant."""
    loop = loop_of(bend=0.2)
    run = loop.simulate(40.0, seed=seed)
    finding, known = controllers.diagnose(run, loop), controllers.diagnose(run, loop_of())
    assert finding.kind == "nonlinear"
    assert known.kind != "nonlinear"
    assert "nonlinear" not in known.others


@pytest.mark.parametrize(
    ("kind", "values", "more"), [("loss", (1.0, 9.0, 0.5, 0.0), {}), ("onset", (1.0, 9.0, 2.0), {"elsewhere": True})]
)
def test_a_linear_plant_has_no_other_operating_point(kind, values, more):
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 1e-4, 0.01, dt=0.1)
    assert "nonlinearity" in sentence(kind, values, model, **more)
    assert "nonlinearity" not in sentence(kind, values, model, linear=True, **more)
