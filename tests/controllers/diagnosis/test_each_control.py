"""What is wrong with one of several controls is named with this control."""

from dataclasses import replace
from itertools import product

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import LinearModel, diagnose_recording
from bayesftc.controllers.models.linear import SignalNames

A, B, C = np.array([[0.9, 0.05], [0.0, 0.8]]), np.array([[0.2, 0.05], [0.02, 0.3]]), np.repeat(np.eye(2), 2, axis=0)
NAMES = SignalNames(states=("a", "b"), controls=("stock", "steam"), sensors=("a", "a", "b", "b"))
MODEL = replace(LinearModel(A, B, C, 1e-5, 1e-3, dt=1.0), names=NAMES)


def recording(seed=0, *, late=(0, 0), acting=lambda u: u, steps=300):
    """Return samples and controls of a plant on which the controls act late, and changed."""
    rng = np.random.default_rng(seed)
    sent = np.repeat(rng.normal(size=(steps // 10, 2)), 10, axis=0)
    arrived = acting(np.stack([np.pad(sent[:, j], (k, 0))[:steps] for j, k in enumerate(late)], axis=1))
    x, y = np.zeros(2), np.zeros((steps, 4))
    for t in range(steps):
        y[t] = C @ x + 1e-3**0.5 * rng.normal(size=4)
        x = A @ x + B @ arrived[t] + 1e-5**0.5 * rng.normal(size=2)
    return y, sent


@pytest.mark.parametrize(
    ("modelled", "true", "kind", "values", "words"),
    [
        ((0, 0), (0, 3), "late", (3.0, 0.0, 1.0), "the control steam acts late, by 3 s (3 samples)"),
        ((0, 0), (2, 0), "late", (2.0, 0.0, 0.0), "the control stock acts late, by 2 s"),
        ((0, 0), (2, 2), "late", (2.0, 0.0), "the controls act late, by 2 s"),
        (
            (2, 5),
            (2, 1),
            "early",
            (4.0, 1.0),
            "the control steam acts earlier than in the model, by 4 s (4 samples). Sho",
        ),
        ((3, 5), (1, 3), "early", (2.0,), "the controls act earlier than in the model, by 2 s"),
        ((2, 5), (2, 5), None, (), ""),
    ],
)
def test_a_wrong_dead_time_of_one_control_is_named_with_it(modelled, true, kind, values, words):
    finding = diagnose_recording(MODEL.with_delays(modelled), *recording(late=true))
    if kind is None:
        assert finding is None
        return
    assert (finding.kind, finding.values) == (kind, values)
    assert words in finding.sentence


def held_back(u):
    """Return controls of which the second one changes by no more than 0.1 in a sample."""
    slow = u.copy()
    for t in range(1, len(u)):
        slow[t, 1] = slow[t - 1, 1] + np.clip(u[t, 1] - slow[t - 1, 1], -0.1, 0.1)
    return slow


@pytest.mark.parametrize(
    ("acting", "kind", "values", "words"),
    [
        (held_back, "rate", (0.1, 1.0), "steam as if it could change by no more than about 0.1 in a second"),
        (
            lambda u: u[:, ::-1],
            "exchanged",
            (0.0, 1.0),
            "the control stock acts as the control steam does in the model",
        ),
        (lambda u: u * [0.0, 1.0], "gain", (0.0, 0.0), "the control stock has little or no effect on the plant"),
        (lambda u: u * [1.0, -1.0], "sign", (-1.0, 1.0), "the control steam moves the plant in the opposite direction"),
        (lambda u: np.clip(u, [-9, -0.7], [9, 0.7]), "limit", (-0.7, 0.7, 1.0), "steam where it is below -0.7"),
    ],
)
def test_what_is_wrong_with_one_control_is_named(acting, kind, values, words):
    finding = diagnose_recording(MODEL, *recording(acting=acting))
    assert finding.kind == kind
    assert finding.values == pytest.approx(values, abs=0.03)
    assert words in finding.sentence
    assert not {"limit", "rate"} & {*finding.others}  # they would say what hardly any effect says


def test_controls_with_different_delays_are_exchanged_with_them():
    y, u = recording(late=(1, 4), acting=lambda u: u)
    finding = diagnose_recording(MODEL.with_delays((1, 4)), y, u[:, ::-1])
    assert (finding.kind, finding.values) == ("exchanged", (0.0, 1.0))


@pytest.mark.slow
def test_a_control_without_effect_is_not_called_reversed_because_the_other_answers_for_it():
    """The sets of sensors do not see what the control knows from the others; all sensors together decide on its sign."""
    plants = [control.ss(-np.diag([0.05, 0.1]), [[0.05 * g, 0.01, 0.05, 0.0], [0.0, 0.1, 0.0, 0.1]], np.eye(2), 0,
        inputs=["p", "q", "dp", "dq"], outputs=["a", "b"]) for g in (1.0, 0.0, -1.0)]  # fmt: skip
    controller = controllers.design(
        plants[0], measured=["a", "b"], actuated=["p", "q"], sensors=[2, 2], sensor_std=0.05, dt=1.0,
        noise={"dp": 0.3, "dq": 0.3}, acceptable_error=0.1, acceptable_control=2.0,
    )  # fmt: skip
    kinds = []
    for plant, seed in product(plants, range(4)):
        loop = cosim.closed_loop(
            plant, controller, control=["p", "q"], measured=["a", "b"], sensors=cosim.Sensors([2, 2], 0.05),
            reference=[0.0, 0.0], noise={"dp": cosim.Gaussian(std=0.3), "dq": cosim.Gaussian(std=0.3)},
        )  # fmt: skip
        finding = controllers.diagnose(loop.simulate(600.0, seed=seed), loop)
        kinds.append(set() if finding is None else {finding.kind, *finding.others})
    assert not any(kinds[:4])
    assert all(found & {"gain", "gains"} and "sign" not in found for found in kinds[4:8])
    assert all("sign" in found for found in kinds[8:])


@pytest.mark.slow
def test_another_growth_rate_of_an_unstable_plant_is_no_noise():
    """Its effect on the innovations is small, but the model lacks noise by this run, and other dynamics explain more."""
    plants = [
        control.ss([[g, 0.02, 0.0], [0.0, -500.0, 500.0], [0.0, 0.0, -10.0]], [[0.0, 1.0], [0.0, 0.0], [500.0, 0.0]],
                   [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], 0, inputs=["volt", "kick"], outputs=["z", "i"])
        for g in (100.0, 130.0)
    ]  # fmt: skip
    std = [2e-3] * 4 + [5.0] * 2
    controller = controllers.design(
        plants[0], measured=["z", "i"], actuated="volt", goal="z", sensors=[4, 2], sensor_std=std, dt="1/5000",
        noise={"kick": 0.2, "volt": 2.0}, acceptable_error=5e-3, acceptable_control=150.0,
    )  # fmt: skip
    kinds = []
    for plant in plants:
        loop = cosim.closed_loop(
            plant, controller, control="volt", measured=["z", "i"], sensors=cosim.Sensors([4, 2], std),
            noise={"kick": cosim.Gaussian(std=0.2)}, reference=cosim.Sine(amplitude=0.005, period=0.05),
        )  # fmt: skip
        finding = controllers.diagnose(loop.simulate(1.0, seed=0), loop)
        kinds.append(None if finding is None else finding.kind)
    assert kinds == [None, "dynamics"]


@pytest.mark.parametrize(("late", "modelled"), [(4, 0), (12, 0), (9, 4), (0, 0), (4, 4)])
def test_sensors_of_one_quantity_that_are_all_late_are_named(late, modelled):
    y, u = recording()
    y[:, 2:] = np.pad(y[:, 2:], ((late, 0), (0, 0)))[: len(y)]
    finding = diagnose_recording(MODEL.with_delays(sensors=[0, 0, modelled, modelled]), y, u)
    if late == modelled:
        assert finding is None
        return
    more = late - modelled
    assert (finding.kind, finding.values) == ("late_sensors", (0, 0, more, more))
    assert f"all sensors of b (2 and 3) are late, by {more} s ({more} samples)" in finding.sentence


def test_sensors_that_a_control_does_not_reach_are_neither_for_nor_against_its_sign():
    """A third thermometer, alone in its set, hid that a control of another quantity was reversed: nothing was named."""
    A, B, C = np.diag([0.95, 0.9]), np.array([[0.0], [0.2]]), np.array([[1, 0], [1, 0], [1, 0], [0, 1], [0, 1]])
    model = LinearModel(A, B, C, 1e-3, 0.01, dt=1.0)
    rng = np.random.default_rng(0)
    u, x, y = np.repeat(rng.normal(size=(20, 1)), 15, axis=0), np.zeros(2), np.empty((300, 5))
    for k in range(300):
        y[k] = C @ x + 0.1 * rng.normal(size=5)
        x = A @ x - B @ u[k] + 0.0316 * rng.normal(size=2)
    finding = diagnose_recording(model, y, u)
    assert (finding.kind, finding.values[0]) == ("sign", pytest.approx(-1.0, abs=0.1))
