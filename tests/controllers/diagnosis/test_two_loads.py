"""Two loads, one after the other, are named apart; also while sensors are faulty."""

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers.diagnosis.changes import _solved
from bayesftc.controllers.diagnosis.words.sentences import sentence

STD = np.array([0.1, 0.1, 0.03, 0.2])
PLAIN = controllers.LinearModel([[1.0, 0.1], [0.0, 0.97]], [[0.005], [0.1]], np.eye(2)[[0] * 4], 1e-6, STD**2, dt=0.1)
MODEL = PLAIN.with_disturbance(1e-4)


def flown(loads, seed, *, faulty):
    """Return samples and controls of a vehicle, on which loads (begin, end, size) act in place of further control."""
    rng, x, steps = np.random.default_rng(seed), np.zeros((900, 2)), 900
    u = np.where(np.arange(steps) % 120 < 60, 0.5, -0.5)[:, np.newaxis]
    load = np.zeros(steps)
    for begin, end, size in loads:
        load[begin:end] += size
    for k in range(steps - 1):
        x[k + 1] = (
            PLAIN.matrix("A") @ x[k] + PLAIN.matrix("B")[:, 0] * (u[k, 0] + load[k]) + 1e-3 * rng.standard_normal(2)
        )
    y = x[:, [0] * 4] + STD * rng.standard_normal((steps, 4))
    if faulty:
        y[250:, 0] += 0.01 * np.arange(steps - 250)  # a drift for most of the run
        y[100:160, 2] = np.nan
        y[720:770, 3] += 2.0
    return y, u


@pytest.mark.sampled(1)
@pytest.mark.parametrize("faulty", [False, True])
def test_two_loads_are_named_apart(faulty):
    y, u = flown([(300, 340, 0.8), (500, 900, -1.2)], 1, faulty=faulty)
    finding = controllers.diagnose_recording(MODEL, y, u)
    assert finding.kind == "onset"
    assert finding.values == pytest.approx((30.0, 34.0, 0.8, 50.0, np.inf, -1.2), abs=0.4)
    assert "s after the first sample, and another one from 5" in finding.sentence


@pytest.mark.sampled(1)
@pytest.mark.parametrize("faulty", [False, True])
def test_one_load_is_one(faulty):
    finding = controllers.diagnose_recording(MODEL, *flown([(500, 900, -1.2)], 2, faulty=faulty))
    assert finding.kind == "onset"
    assert finding.values == pytest.approx((50.0, np.inf, -1.2), abs=0.4)


@pytest.mark.parametrize("seed", [1, 2])
def test_faulty_sensors_are_no_loads(seed):
    assert controllers.diagnose_recording(MODEL, *flown([], seed, faulty=True)) is None


@pytest.mark.sampled(1)
@pytest.mark.parametrize("loads", [[(300, 900, 0.8)], [(200, 400, 0.8), (600, 800, -0.8)]], ids=["one", "two"])
@pytest.mark.parametrize("leaking", [0, 1], ids=["pumped tank", "other tank"])
def test_loads_are_said_to_act_where_no_control_does(leaking, loads):
    """Of two coupled tanks a pump fills the first one; water is also let in, or out, of the same or the other one."""
    A, B = np.array([[0.95, 0.05], [0.05, 0.93]]), np.array([[0.1], [0.0]])
    model = controllers.LinearModel(A, B, np.eye(2)[[0, 0, 1, 1]], 1e-6, 1e-4, dt=0.1)
    rng, x, u = np.random.default_rng(3), np.zeros((900, 2)), np.where(np.arange(900) % 120 < 60, 0.5, -0.5)
    load = sum(size * ((begin <= np.arange(900)) & (np.arange(900) < end)) for begin, end, size in loads)
    for k in range(899):
        x[k + 1] = A @ x[k] + B[:, 0] * u[k] + 0.1 * load[k] * np.eye(2)[leaking] + 1e-3 * rng.standard_normal(2)
    y = x[:, [0, 0, 1, 1]] + 0.01 * rng.standard_normal((900, 4))
    finding = controllers.diagnose_recording(model, y, u[:, np.newaxis])
    assert (finding.kind, len(finding.values)) == ("onset", 3 * len(loads))
    assert ("where no control does" in finding.sentence) == bool(leaking)
    assert ("disturbance in design" in finding.sentence) == (not leaking)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("loads", [[(300, 900, 0.8)], [(200, 400, 0.8), (600, 800, -0.8)]], ids=["one", "two"])
@pytest.mark.parametrize(("leaking", "std"), [(0, 1e-3), (1, 1e-3), (1, 1.0)], ids=["pumped tank", "other", "stated"])
def test_a_load_that_the_model_has_is_said_to_need_more_noise(leaking, std, loads):
    """The model of two coupled tanks has an inflow of the second one, as slow noise; the true one comes in a step."""
    A, B = np.array([[0.95, 0.05, 0.0], [0.05, 0.93, 0.1], [0.0, 0.0, 0.999]]), np.array([[0.1], [0.0], [0.0]])
    Q = np.diag([1e-6, 1e-6, std**2])
    names = controllers.SignalNames(["pump"], ["h1", "h1", "h2", "h2"], ["h1", "h2", "inflow"])
    model = controllers.LinearModel(A, B, np.eye(3)[[0, 0, 1, 1]], Q, 1e-4, dt=0.1, names=names)
    rng, x, u = np.random.default_rng(3), np.zeros((900, 2)), np.where(np.arange(900) % 120 < 60, 0.5, -0.5)
    load = sum(size * ((begin <= np.arange(900)) & (np.arange(900) < end)) for begin, end, size in loads)
    for k in range(899):
        x[k + 1] = A[:2, :2] @ x[k] + B[:2, 0] * u[k] + 0.1 * load[k] * np.eye(2)[leaking]
        x[k + 1] += 1e-3 * rng.standard_normal(2)
    y = x[:, [0, 0, 1, 1]] + 0.01 * rng.standard_normal((900, 4))
    finding = controllers.diagnose_recording(model, y, u[:, np.newaxis])
    if std == 1.0:
        assert finding is None
        return
    assert (finding.kind, len(finding.values)) == ("onset", 3 * len(loads))
    assert finding.values[0] == pytest.approx(0.1 * loads[0][0], abs=0.2)
    assert ("as the state inflow of the model" in finding.sentence) == bool(leaking)
    assert ("Give inflow more noise" in finding.sentence) == bool(leaking)
    assert ("disturbance in design" in finding.sentence) == (not leaking)


@pytest.mark.slow
@pytest.mark.parametrize("jumping", [0, 1, None])
@pytest.mark.parametrize("begin", [600, 900], ids=["load", "no load"])
def test_a_jump_of_one_of_two_sensors_is_no_load(begin, jumping):
    """For most of the run the sensors of a tank differ by the jump; the other tank has a single sensor, and later a load."""
    A, B = np.array([[0.95, 0.05], [0.05, 0.93]]), np.array([[0.1], [0.0]])
    model = controllers.LinearModel(A, B, np.eye(2)[[0, 0, 1]], 1e-6, 1e-4, dt=0.1)
    rng, x, u = np.random.default_rng(3), np.zeros((900, 2)), np.where(np.arange(900) % 120 < 60, 0.5, -0.5)
    for k in range(899):
        x[k + 1] = A @ x[k] + B[:, 0] * u[k] + 1e-3 * rng.standard_normal(2)
        x[k + 1, 1] += 0.08 * (k >= begin)
    y = x[:, [0, 0, 1]] + 0.01 * rng.standard_normal((900, 3))
    if jumping is not None:
        y[300:, jumping] += 0.3
    finding = controllers.diagnose_recording(model, y, u[:, np.newaxis])
    if begin == 900:
        assert finding is None
    else:
        assert finding.kind == "onset"
        assert finding.values[:2] == pytest.approx((60.0, np.inf), abs=0.3)
        assert "where no control does" in finding.sentence


def test_the_sentence_has_the_times_and_sizes_of_both():
    words = sentence("onset", (30.0, 33.0, 2.0, 50.0, float("inf"), -3.0), PLAIN, control_units=("N",))
    assert (
        "acts from 30 s to 33 s after the first sample, and another one from 50 s after the first sample on." in words
    )
    assert (
        "They have about the effect of a change of the control by 2 N, and then of a change of the control by -3 N."
        in words
    )


def test_what_no_explanation_covers_may_still_be_loads():
    words = sentence("unknown", (), PLAIN)
    assert "not one or two loads of constant size" in words
    assert "Against loads that change, estimate them (disturbance in design" in words
    assert "more process noise" not in words


def test_a_push_of_which_rounding_leaves_no_response_has_no_size():
    """Its squared length is 0, but its products are not: `bayesftc run` of an engine with three faults ended in a LinAlgError."""
    G = np.array([[[0.0, 4e-16, 1e-7], [4e-16, -1e-16, 3e-8], [1e-7, 3e-8, 2.0]]])
    np.testing.assert_allclose(_solved(G, np.array([[1e-8, 0.0, 3.0]])), [[0.0, 0.0, 1.5]])
