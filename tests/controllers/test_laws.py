"""Feedback laws: alone in a diagram, against NumPy, and what keeps an integral from winding up."""

import pickle

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import ModelError, StepSizeError

GAIN, DERIVATIVE, INTEGRAL = [[3.0, 0.5], [-0.2, 2.0]], [[0.7, 0.1], [0.0, 0.4]], [[1.0, 0.2], [0.1, 2.0]]
EXAMPLES = [
    controllers.Proportional(GAIN),
    controllers.Proportional(GAIN, states=5, u_max=(0.5, 1.0)),
    controllers.ProportionalDerivative(GAIN, derivative_gain=DERIVATIVE),
    controllers.PID(GAIN, derivative_gain=DERIVATIVE, integral_gain=INTEGRAL),
    *(
        controllers.PID(GAIN, integral_gain=INTEGRAL, u_min=-4.0, u_max=5.0, integral_limit=3.0, anti_windup=kind)
        for kind in ("clamping", "back-calculation", "both", "none")
    ),
]


def test_every_law_is_in_the_examples():
    assert {type(e) for e in EXAMPLES} == set(controllers.LAWS)


def by_numpy(law, x, goal, dt):
    """The law's controls over rows of x and goal."""
    g, p, out = law.goals, law.controls, []
    integral = np.zeros(p)
    derivative = np.asarray(getattr(law, "derivative_gain", np.zeros((p, g))))
    for state, wanted in zip(x, goal, strict=True):
        error = np.where(np.isfinite(wanted), wanted - state[:g], 0.0)
        rates = state[g : 2 * g] if derivative.any() else np.zeros(g)
        raw = np.asarray(law.gain) @ error - derivative @ rates + integral
        u = np.clip(raw, law.u_min, law.u_max)
        out.append(u)
        if isinstance(law, controllers.PID):
            drive = np.asarray(law.integral_gain) @ error
            if law.anti_windup in {"clamping", "both"}:
                drive = np.where((raw - u) * drive > 0, 0.0, drive)
            if law.anti_windup in {"back-calculation", "both"}:
                drive = drive + (u - raw) / law.tracking_time
            integral = np.clip(integral + dt * drive, -np.array(law.integral_limit), law.integral_limit)
    return np.array(out)


@pytest.mark.parametrize("law", EXAMPLES, ids=repr)
def test_the_control_is_numpys_in_both_forms(law, same_bits):
    rng = np.random.default_rng(5)
    x = np.cumsum(rng.normal(size=(200, law.port("x_hat").size)), axis=0) * 0.3
    goal = np.where(rng.random((200, law.goals)) < 0.1, np.nan, rng.normal(size=(200, law.goals)))
    runs = []
    for compiled in (True, False):
        step = law.online(dt=0.05, compiled=compiled)
        runs.append(np.array([step(x_hat=a, goal=b).u for a, b in zip(x, goal, strict=True)]))
    same_bits(*runs)
    np.testing.assert_allclose(runs[0], by_numpy(law, x, goal, 0.05), rtol=1e-12, atol=1e-12)
    assert pickle.loads(pickle.dumps(law)) == law


def motor_loop(law):
    """A slow first-order plant under a law that reads the plant's state."""
    diagram = cosim.Diagram(dt=0.01)
    goal = diagram.add(cosim.Constant(1.0), "goal")
    plant = diagram.add(cosim.StateSpace(control.ss([[-1.0]], [[1.0]], [[1.0]], 0.0)), "plant")
    brain = diagram.add(law, "law")
    diagram.connect(plant["y"], brain["x_hat"])
    diagram.connect(goal["y"], brain["goal"])
    diagram.connect(brain["u"], plant["u"])
    return diagram.build()


def test_alone_in_a_diagram(run_both):
    left = run_both(motor_loop(controllers.Proportional(4.0)), 12.0)["plant.y"][-1]
    assert left == pytest.approx(0.8, rel=1e-3)  # gain / (1 + gain)
    reached = run_both(motor_loop(controllers.PID(4.0, integral_gain=4.0)), 12.0)["plant.y"][-1]
    assert reached == pytest.approx(1.0, rel=1e-3)


def overshoot(**options):
    law = controllers.PID(4.0, integral_gain=20.0, u_max=1.2, **options)
    return motor_loop(law).simulate(10.0)["plant.y"].max() - 1.0


def test_anti_windup_lowers_the_overshoot():
    wound_up = overshoot(anti_windup="none")
    assert wound_up > 0.1
    assert overshoot(anti_windup="clamping") < 0.5 * wound_up
    assert overshoot(anti_windup="back-calculation", tracking_time=0.1) < 0.5 * wound_up
    assert overshoot(anti_windup="both", tracking_time=0.1) < 0.5 * wound_up


def test_the_integral_is_held_on_both_sides():
    law = controllers.PID(0.0, integral_gain=1.0, integral_limit=0.5)
    step = law.online(dt=1.0)
    up = [step(x_hat=[0.0], goal=[0.3]).u[0] for _ in range(5)]
    np.testing.assert_allclose(up, [0.0, 0.3, 0.5, 0.5, 0.5])
    down = [step(x_hat=[0.0], goal=[-0.6]).u[0] for _ in range(5)]
    np.testing.assert_allclose(down, [0.5, -0.1, -0.5, -0.5, -0.5])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: controllers.Proportional([[np.nan]]), "NaN or infinite"),
        (lambda: controllers.Proportional(1.0, u_min=2.0, u_max=1.0), "u_min is 2, above its u_max of 1"),
        (lambda: controllers.ProportionalDerivative([1.0, 1.0], states=3), "reads 4 states for 2 goals"),
        (lambda: controllers.ProportionalDerivative([1.0, 1.0], derivative_gain=[[1.0]]), "it must be 2 x 2"),
        (lambda: controllers.PID(1.0, u_max=-np.inf), "no control can keep"),
        (lambda: controllers.Proportional(1.0, u_min=np.inf), "no control can keep"),
        (lambda: controllers.Proportional("high"), "gain of Proportional is 'high'"),
        (lambda: controllers.Proportional([[1.0, 2.0], [3.0]]), "rows of numbers"),
        (lambda: controllers.Proportional(1.0, states="2"), "whole number"),
        (lambda: controllers.Proportional(1.0, states=2.5), "whole number"),
        (lambda: controllers.Proportional(1.0, u_max="none"), "u_max of Proportional is 'none'"),
        (lambda: controllers.PID(1.0, integral_limit="none"), "integral_limit of PID is 'none'"),
        (lambda: controllers.PID(1.0, anti_windup=["clamping"]), "'clamping'"),
        (lambda: controllers.PID(1.0, tracking_time="1 s"), "positive number of seconds"),
        (lambda: controllers.PID(1.0, integral_limit=-1.0), "must not be negative"),
        (lambda: controllers.PID(1.0, anti_windup="yes"), "'clamping'"),
        (lambda: controllers.PID(1.0, tracking_time=0.0), "positive number of seconds"),
        (lambda: controllers.PID(1.0, anti_windup="both", tracking_time=0.1).define(1), "at least the sample time"),
    ],
)
def test_bad_settings_are_said_in_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()


def test_a_law_alone_needs_a_sample_time():
    with pytest.raises(StepSizeError, match="sample time"):
        controllers.Proportional(1.0).online()


def test_limits_that_are_crossed_are_named():
    with pytest.raises(
        ModelError, match=r"Proportional: u_min of control 1 is 7, above its u_max of 6\. The lower limit"
    ):
        controllers.Proportional([1.0, 1.0], u_min=[0.0, 7.0], u_max=[3.0, 6.0])
    model = controllers.LinearModel(
        0.9 * np.eye(2), np.eye(2), np.eye(2), 0.01 * np.eye(2), np.eye(2), dt=0.1,
        names=controllers.SignalNames(controls=("inflow", "heater"), sensors=("a", "b"), states=("a", "b")),
    )  # fmt: skip
    sentence = (
        r"u_min of inflow is 100, above its u_max of 30; u_min of heater is 100, above its u_max of 60\. The lower"
    )
    with pytest.raises(ModelError, match=sentence):
        controllers.LQGController(model, goal_covariance=np.eye(2), u_min=[100.0, 100.0], u_max=[30.0, 60.0])
