"""Actuator modes: one hypothesis is a Kalman filter of its own (filterpy); faults are told from sensors' and made up for."""

from dataclasses import dataclass

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc import controllers
from bayesftc.controllers import (
    ACTUATOR_MODES,
    BayesianController,
    InputOffset,
    LinearModel,
    LostEffect,
    StateEstimator,
    StuckActuator,
    SwitchingPrecision,
)
from bayesftc.controllers.switching.actuator_settings import control_scales
from bayesftc.cosim.errors import ModelError

STEP, A, B, Q = 0.02, 0.999, 2e-4, 0.001
MODEL = LinearModel([[A]], [[B]], [[1.0], [1.0]], Q, 1.0, STEP)
SCALE = np.sqrt(Q) / B
AT_ONCE, NEVER = STEP * (1 + 1e-12), 1e15
MODES = [InputOffset(), LostEffect(), StuckActuator()]


def test_all_modes_are_here():
    assert {type(mode) for mode in MODES} == set(ACTUATOR_MODES)


CORRELATED = LinearModel([[A]], [[B]], [[1.0], [1.0]], Q, [[1.0, 0.5], [0.5, 1.0]], STEP)


@pytest.mark.parametrize("modes", [(), MODES[1:2], MODES])
def test_there_are_outputs_for_the_modes_that_were_given(modes):
    """By default none: what a plant does that is slower than its model is no reason to ask for more control."""
    precision = SwitchingPrecision(actuator_modes=modes) if modes else SwitchingPrecision()
    assert precision.actuator_modes == tuple(modes)
    ports = {port.name: port.shape for port in StateEstimator(MODEL, precision).outputs}
    assert ports.get("actuator_mode_probability") == ((1, 1 + len(modes)) if modes else None)
    assert BayesianController(MODEL, precision=precision).actuator_kinds == tuple(type(mode).__name__ for mode in modes)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("kind", ACTUATOR_MODES)
def test_a_fault_that_has_begun_is_filtered_as_filterpy_does(kind):
    """Whatever the controller counts on in between; the offset of a sensor has no chance beside it."""
    mode = kind(AT_ONCE, NEVER)
    never = (controllers.Offset(NEVER, NEVER),)
    precision = SwitchingPrecision(never, 1e-9, actuator_modes=(mode,), process_modes=(), noise_factor=1.0)
    step = StateEstimator(MODEL, precision, initial_mean=20.0, initial_covariance=0.5).online(compiled=False)
    mean, variance, walk = mode.expected(SCALE)
    one = KalmanFilter(2, 2, 1)
    one.x, one.P = np.array([[20.0], [mean]]), np.diag([0.5, variance])
    one.H, one.R, one.Q = np.array([[1.0, 0.0], [1.0, 0.0]]), np.eye(2), np.diag([Q, walk])
    rng, x = np.random.default_rng(3), 20.0
    for _ in range(60):
        y, u = x + rng.normal(size=2), 800.0 * rng.normal()
        one.update(y[:, None])
        out = step(y=list(y), u=[u])
        assert out.x_hat[0] == pytest.approx(one.x[0, 0], rel=1e-9)
        assert out.P[0, 0] == pytest.approx(one.P[0, 0], rel=1e-6)
        assert out.actuator_fault_size[0] == pytest.approx(one.x[1, 0], rel=1e-6, abs=1e-6)
        assert out.actuator_fault_kind[0] == 1
        one.F = np.array([[A, B * (mode.absolute + mode.relative * u)], [0.0, 1.0]])
        one.B = np.array([[B * (1.0 + mode.takes)], [0.0]])
        one.predict(u=np.array([[u]]))
        x = A * x + B * 0.4 * u + np.sqrt(Q) * rng.normal()


def drive(kind, modes, offset=0.0, steps=500, start=200, stop=400, seed=0, compiled=True, **options):
    """Run the car with a fault of its actuator, and an offset of a sensor; yield outputs and errors."""
    rng, x = np.random.default_rng(seed), 20.0
    precision = SwitchingPrecision(actuator_modes=modes, **options)
    step = BayesianController(MODEL, precision=precision, initial_mean=20.0).online(compiled=compiled)
    for k in range(steps):
        y = x + rng.normal(size=2)
        failed = start <= k < stop
        y[0] += offset * failed
        out = step(y=list(y), goal=[20.0 + 10.0 * np.sin((k + 1) * STEP * 0.8)])
        u = out.u[0]
        if k == start:
            held = u
        received = {None: u, "InputOffset": u + 1500.0, "LostEffect": 0.4 * u, "StuckActuator": held if failed else u}[
            kind
        ]
        yield out, x - (20.0 + 10.0 * np.sin(k * STEP * 0.8))
        x = A * x + B * (received if failed else u) + np.sqrt(Q) * rng.normal()


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("kind", "offset"), [(type(mode).__name__, 0.0) for mode in MODES] + [("InputOffset", 6.0), (None, 6.0)]
)
def test_faults_of_actuators_are_told_from_those_of_sensors_and_made_up_for(kind, offset):
    outs, errors = zip(*drive(kind, MODES, offset), strict=True)
    healthy, during, after = outs[20:200], outs[270:400], outs[430:]
    number = 0 if kind is None else 1 + [type(mode).__name__ for mode in MODES].index(kind)
    # A lost share is not seen while the control is near zero.
    most = 0.8 if kind == "LostEffect" else 0.95
    assert np.mean([out.actuator_fault_kind[0] == number for out in during]) > most
    assert np.mean([(out.actuator_fault_probability[0] > 0.5) == (kind is not None) for out in during]) > most
    assert np.mean([(out.fault_probability[0] > 0.9) == (offset > 0) for out in during]) > 0.95
    assert np.mean([out.fault_probability[1] < 0.5 for out in (*healthy, *during)]) > 0.97
    for quiet in (healthy, after):
        assert np.mean([out.actuator_fault_probability[0] < 0.5 for out in quiet]) > 0.98
    if kind == "InputOffset":
        assert during[-1].actuator_fault_size[0] == pytest.approx(1500.0, rel=0.15)
    if kind == "LostEffect":
        assert during[-1].actuator_fault_size[0] == pytest.approx(0.6, abs=0.1)
    if kind != "StuckActuator":  # which nothing can make up for
        assert np.sqrt(np.mean(np.square(errors[270:400]))) < 0.4
    for out in outs:
        np.testing.assert_allclose(out.actuator_mode_probability.sum(), 1.0, rtol=1e-9)


@pytest.mark.parametrize(("share", "times"), [(0.5, 2.0), (0.95, 10.0), (-1.0, 0.5)])
def test_a_lost_share_is_made_up_for_by_ten_times_the_control_at_most_and_within_its_limits(share, times):
    lost = LostEffect(AT_ONCE, NEVER, share=share, spread=1e-6, walk=0.0)
    switching = SwitchingPrecision((controllers.Offset(NEVER, NEVER),), 1e-9, actuator_modes=(lost,), process_modes=())
    asked = {}
    for name, precision, most in (
        ("healthy", controllers.FixedPrecision(), np.inf),
        ("lost", switching, np.inf),
        ("limited", switching, 6e3),
    ):
        controller = BayesianController(MODEL, precision=precision, initial_mean=20.0, u_max=most)
        asked[name] = controller.online(compiled=False)(y=[20.0, 20.0], goal=[21.0]).u[0]
    assert asked["lost"] == pytest.approx(times * asked["healthy"], rel=1e-3)
    assert asked["limited"] == pytest.approx(min(asked["lost"], 6e3), rel=1e-9)


def test_without_its_modes_a_failed_actuator_is_taken_for_failed_sensors():
    """That is why they are there. A process mode, of which a belief fades, helps without them."""
    outs, errors = zip(*drive("InputOffset", (), process_modes=()), strict=True)
    assert "actuator_fault_probability" not in outs[0]
    assert np.mean([out.fault_probability.min() > 0.5 for out in outs[270:400]]) > 0.5
    assert np.abs(errors[390]) > 1.0


def test_both_engines_give_the_same_bits():
    for (one, _), (other, _) in zip(
        drive("LostEffect", MODES, steps=60, start=20),
        drive("LostEffect", MODES, steps=60, start=20, compiled=True),
        strict=True,
    ):
        for name in ("u", "x_hat", "P", "actuator_mode_probability", "actuator_fault_size", "fault_probability"):
            np.testing.assert_array_equal(one[name], other[name])


def test_absurd_samples_of_very_different_sensors_leave_numbers():
    """Beliefs stay numbers with variances, whatever the sensors send, also where an actuator is believed to have failed."""
    model = LinearModel(
        [[1, 0.02], [0, 1]], [[2e-4], [0.02]], [[1, 0], [1, 0], [0, 1]], [1e-6, 1e-3], [1e-9, 1e6, 1.0], STEP
    )
    precision = SwitchingPrecision(actuator_modes=MODES)
    controller = BayesianController(model, precision=precision, control_covariance=1e3, goal_covariance=0.1)
    step = controller.online()
    rng, x = np.random.default_rng(4), np.zeros(2)
    for k in range(260):
        y = x[[0, 0, 1]] + np.sqrt([1e-9, 1e6, 1.0]) * rng.normal(size=3)
        y += (1e300 if k % 2 else -1e200) * (60 <= k < 120)
        with np.errstate(all="ignore"):
            out = step(y=list(y), goal=[0.5, 0.5])
        assert np.isfinite(out.x_hat).all()
        assert (np.diag(out.P) >= 0).all()
        assert ((out.fault_probability >= 0) & (out.fault_probability <= 1)).all()
        x = np.array([[1, 0.02], [0, 1]]) @ x + np.array([2e-4, 0.02]) * out.u[0] + [1e-3, 0.03] * rng.normal(size=2)


def test_the_unit_of_an_offset_is_what_the_state_that_tells_most_tells():
    """A force on a double integrator shows in the speed, of which the position's noise says nothing."""
    model = LinearModel([[1, 0.02], [0, 1]], [[2e-4], [0.02]], np.eye(2), [1e-3, 1e-3], 1.0, STEP)
    rng, x = np.random.default_rng(0), np.zeros(2)
    step = StateEstimator(model, SwitchingPrecision(actuator_modes=(InputOffset(),))).online()
    for k in range(300):
        out = step(y=list(x + rng.normal(size=2)), u=[0.0])
        x = (
            np.array([[1, 0.02], [0, 1]]) @ x
            + np.array([2e-4, 0.02]) * 8.0 * (k > 100)
            + 1e-3**0.5 * rng.normal(size=2)
        )
    assert out.actuator_fault_probability[0] > 0.9
    assert out.actuator_fault_size[0] == pytest.approx(8.0, abs=1.5)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e6, 1e12])
def test_the_unit_of_an_offset_does_not_depend_on_those_of_the_states(unit):
    """Noise of a torque in N m and of an angle in rad have variances that differ by more than rounding."""
    A = np.array([[0.98, -0.18, 0.1 / unit], [0.0, 0.72, 0.0], [0.0, 0.0, 0.97]])
    B = np.array([[-0.03], [0.28], [0.0]])
    G = np.hstack([0.002 * B, [[0.003], [0.0], [0.02 * unit]]])
    model = LinearModel(A, B, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], G @ G.T, 1e-5, 0.1)
    assert control_scales(model) == pytest.approx([0.002], rel=1e-6)


def test_a_belief_with_the_goal_in_it_is_that_of_the_per_sensor_form():
    never = (controllers.Offset(NEVER, NEVER),)
    outs = []
    for precision in (controllers.FixedPrecision(), SwitchingPrecision(modes=never, noise_factor=1.0)):
        controller = BayesianController(
            MODEL, precision=precision, initial_mean=20.0, belief="joint", control_covariance=1e6
        )
        step = controller.online(compiled=False)
        outs.append([step(y=[20.0 + np.sin(k), 20.0], goal=[21.0]) for k in range(20)])
    for fixed, switching in zip(*outs, strict=True):
        np.testing.assert_allclose(switching.x_hat, fixed.x_hat, rtol=1e-9)
        np.testing.assert_allclose(switching.P, fixed.P, rtol=1e-9)


def inference(precision, prior):
    """Return an active-inference controller of the car."""
    speed = controllers.Modality("speed", matrix=[[1.0], [1.0]], std=1.0)
    model = MODEL if prior == "kalman" else None
    return controllers.UnbiasedActiveInference(
        speed, controllers.Proportional(gain=[[500.0]]), STEP, 10.0, control="law", state_prior=prior, model=model,
        precision=precision,
    )  # fmt: skip


APART = {
    "A BayesianController with belief='joint'": lambda told: BayesianController(MODEL, precision=told, belief="joint"),
    "NonlinearBayesianController": lambda told: controllers.NonlinearBayesianController(MODEL, precision=told),
    "UnbiasedActiveInference": lambda told: inference(told, "random walk"),
    "ExplicitDetection": lambda told: BayesianController(MODEL, precision=controllers.ExplicitDetection(told)),
}


@pytest.mark.parametrize("who", APART)
def test_who_learns_precisions_apart_from_the_state_refuses_faults_of_actuators(who):
    APART[who](SwitchingPrecision())  # those of sensors it takes
    with pytest.raises(ModelError, match=f"^{who} learns precisions apart .* leave the actuator modes out"):
        APART[who](SwitchingPrecision(actuator_modes=MODES))


def test_that_is_said_before_what_a_prediction_lacks():
    """With prior "kalman" the control moves the state, with the others not; none has the process noise of the model."""
    with pytest.raises(ModelError, match=r"^UnbiasedActiveInference learns precisions apart"):
        inference(SwitchingPrecision(actuator_modes=[LostEffect(), InputOffset()]), "kalman")


@dataclass(frozen=True)
class Vague(controllers.ActuatorMode):
    """A user's mode that forgets the walk."""

    absolute = 1.0

    def expected(self, scale):
        """Return too little."""
        return 0.0, 1.0


@dataclass(frozen=True)
class Blind(controllers.ActuatorMode):
    """A user's mode that takes no scale."""

    absolute = 1.0

    def expected(self):
        """Return what it would be with one."""
        return 0.0, 1.0, 0.0


@dataclass(frozen=True)
class Lone(controllers.ActuatorMode):
    """A user's mode that gives one number."""

    relative = 1.0

    def expected(self, scale):
        """Return too little."""
        return 0.0


@dataclass(frozen=True)
class Idle(Lone):
    """A user's mode that does not say how it acts."""

    relative = 0.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SwitchingPrecision(actuator_modes=3), "give a list of actuator modes"),
        (lambda: SwitchingPrecision(actuator_modes=(controllers.Offset(),)), "give a list of actuator modes"),
        (lambda: SwitchingPrecision(actuator_modes=[LostEffect]), r"the class LostEffect; .*: LostEffect\(\)"),
        (lambda: SwitchingPrecision(actuator_modes=[controllers.ActuatorMode()]), "has no method expected"),
        (lambda: SwitchingPrecision(actuator_modes=[Blind()]), r"Blind.expected is called .* it is expected\(\)"),
        (lambda: SwitchingPrecision(actuator_modes=[Idle()]), "Idle has no effect"),
        (lambda: SwitchingPrecision(actuator_modes=[Lone()]).learner(MODEL), "Lone.expected returned 0.0"),
        (lambda: SwitchingPrecision(actuator_modes=MODES, joint=False).learner(MODEL), "need the joint form"),
        (
            lambda: SwitchingPrecision(actuator_modes=(LostEffect(0.01),)).learner(MODEL),
            "not longer than the sample time",
        ),
        (
            lambda: SwitchingPrecision(actuator_modes=MODES).learner(
                LinearModel(np.eye(2), [[0.0], [1.0]], np.eye(2), [1.0, 0.0], 1.0, STEP)
            ),
            "has none on any state that control 0 of the model moves",
        ),
        (
            lambda: SwitchingPrecision(actuator_modes=(LostEffect(),)).learner(
                LinearModel([[1.0]], [[0.0]], [[1.0]], 1.0, 1.0, STEP)
            ),
            "control 0 of the model moves no state",
        ),
        (lambda: SwitchingPrecision(actuator_modes=(Vague(),)).learner(MODEL), "Vague.expected returned"),
        (lambda: SwitchingPrecision(modes=(controllers.Offset(0.03),)).learner(MODEL), "too short for the joint form"),
        (lambda: InputOffset(jump=-1.0), "jump=-1.0"),
        (lambda: LostEffect(share=3.0), "share=3.0"),
        (lambda: StuckActuator(time_to_fault="late"), "time_to_fault='late'"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()


@pytest.mark.parametrize("noise", [1.0, 0.005])
def test_modes_that_expect_tiny_faults_are_named(noise, recwarn):
    """Of a heater of 50 kW with a noise of 5 W: its faults would be some 25 W."""
    model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0], [1.0]], noise**2, 0.04, dt=0.1)
    learner = controllers.SwitchingPrecision(actuator_modes=[controllers.StuckActuator()])
    controllers.LQGController(model, learner, goal_covariance=1.0, control_covariance=1.0, u_min=0.0, u_max=50.0)
    assert any("StuckActuator expects faults of control 0 of about 0.025" in str(w.message) for w in recwarn) == (
        noise < 1
    )
