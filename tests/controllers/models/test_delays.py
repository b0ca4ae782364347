"""Dead times in the model: the belief and the law are those of the delayed plant by other ways, and the loop tracks."""

import control
import numpy as np
import pandas as pd
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import BayesianController, FixedPrecision, LinearModel, LQGController, StateEstimator
from bayesftc.controllers.models.delays import aligned
from bayesftc.cosim.errors import ModelError

A, B = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.005], [0.1]])
C = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
Q, R = np.array([[2e-6, 1e-5], [1e-5, 1e-4]]), np.diag([1e-3, 2e-3, 1e-2])
LATE, OLD = 3, (0, 2, 1)


def cart(**settings):
    return LinearModel(A, B, C, Q, R, dt=0.1, **settings)


def test_states_are_the_plants_and_then_past_signals():
    model = cart().with_delays(LATE, OLD)
    assert model.state_names == ("x[0]", "x[1]", "u[-1]", "u[-2]", "u[-3]", "y1[-1]", "y1[-2]", "y2[-1]")
    assert (model.states, model.plant_states, model.controls, model.sensors) == (8, 2, 1, 3)
    np.testing.assert_array_equal(model.quantities[:, :2], C)
    assert not model.quantities[:, 2:].any()
    assert model.alike == ((0, 1), (2,))  # of one quantity, although one of them is late
    np.testing.assert_array_equal(model.effects[:2], B)
    system = model.to_control()
    assert len(system.state_labels) == 8
    named = cart(names=controllers.SignalNames(("force",), ("x", "x", "v"), ("place", "speed"))).with_delays(
        1, (0, 1, 0)
    )
    assert named.state_names == ("place", "speed", "force[-1]", "x[-1]")
    assert cart().with_delays().delays is None


def simulated(steps, seed=0):
    """The late plant: its controls and readings."""
    rng = np.random.default_rng(seed)
    x, u = np.zeros((steps + 1, 2)), rng.normal(size=(steps, 1))
    x[0] = [0.3, -0.2]
    for t in range(steps):
        acting = u[t - LATE] if t >= LATE else np.zeros(1)
        x[t + 1] = A @ x[t] + B @ acting + rng.multivariate_normal(np.zeros(2), Q)
    y = np.array([[C[i] @ x[max(t - d, 0)] for i, d in enumerate(OLD)] for t in range(steps)])
    return u, y + rng.normal(size=y.shape) * np.sqrt(np.diag(R))


def test_aligned_samples_and_controls_are_those_of_the_undelayed_model():
    rng, model = np.random.default_rng(0), cart().with_delays(LATE, OLD)
    x, u = np.zeros(model.states), rng.normal(size=(30, 1))
    x[:2] = [0.3, -0.2]
    x[2:5], y, states = [1.0, -2.0, 0.5], [], []
    for control_ in u:
        states.append(x)
        y.append(model.matrix("C") @ x)
        x = model.matrix("A") @ x + model.matrix("B") @ control_
    samples, controls = aligned(model, np.array(y), u)
    plant = model.undelayed
    for k, state in enumerate(states[:-1]):
        if k >= LATE:
            there = ~np.isnan(samples[k])
            assert there.tolist() == [k < 30 - old for old in OLD]
            np.testing.assert_allclose(samples[k][there], (plant.matrix("C") @ state[:2])[there], atol=1e-12)
            moved = plant.matrix("A") @ state[:2] + plant.matrix("B") @ controls[k]
            np.testing.assert_allclose(moved, states[k + 1][:2], atol=1e-12)
        else:
            assert np.isnan(samples[k]).all()


def by_hand():
    """The augmented system, written down: x, u_t-1 .. u_t-3, position and speed of t-1, those of t-2."""
    F, G, H = np.zeros((9, 9)), np.zeros((9, 1)), np.zeros((3, 9))
    F[:2, :2], F[:2, 4:5] = A, B
    F[3, 2] = F[4, 3] = 1.0
    F[5:7, :2], F[7:9, 5:7] = np.eye(2), np.eye(2)
    G[2, 0] = 1.0
    H[0, 0], H[1, 7], H[2, 6] = 1.0, 1.0, 1.0
    noise = np.zeros((9, 9))
    noise[:2, :2] = Q
    return F, G, H, noise


def test_the_belief_is_that_of_filterpy_on_the_system_written_by_hand():
    F, G, H, noise = by_hand()
    u, y = simulated(60)
    y[17, 1] = np.nan
    estimator = StateEstimator(cart().with_delays(LATE, OLD), FixedPrecision(), [0.1, 0.0], np.diag([0.5, 0.2]))
    step = estimator.online(compiled=False)
    kf = KalmanFilter(9, 1, 1)  # each update gives H and R of the sensors in use
    # Past readings are independent of the present ones, and as uncertain.
    kf.x = np.array([[0.1, 0.0, 0, 0, 0, 0.1, 0.0, 0.1, 0.0]]).T
    kf.P = np.diag([0.5, 0.2, 0, 0, 0, 0.5, 0.2, 0.5, 0.2])
    kf.F, kf.B, kf.Q = F, G, noise
    for t in range(60):
        here = np.isfinite(y[t])
        kf.update(y[t][here].reshape(-1, 1), R=R[np.ix_(here, here)], H=H[here])
        out = step(y=y[t], u=u[t])
        np.testing.assert_allclose(out.x_hat[:2], kf.x[:2, 0], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(out.P[:2, :2], kf.P[:2, :2], rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(out.x_hat[2:5], [u[t - i, 0] if t >= i else 0.0 for i in (1, 2, 3)], atol=1e-12)
        kf.predict(u=u[t][:, None])


def test_the_belief_is_the_posterior_of_all_states_at_once():
    """A dense Gaussian over x_0 .. x_T, and over the readings before the start."""
    steps = 9
    u, y = simulated(steps, seed=1)
    estimator = StateEstimator(cart().with_delays(LATE, OLD), FixedPrecision(), [0.1, 0.0], np.diag([0.5, 0.2]))
    step = estimator.online(compiled=False)
    size = 2 * steps + 3  # the readings of the position at -2 and -1, and of the speed at -1
    rows, rhs = [], []

    def add(row, value, std):
        rows.append(row / std)
        rhs.append(value / std)

    for i, (mean, variance) in enumerate([(0.1, 0.5), (0.0, 0.2)]):
        add(np.eye(size)[i], mean, np.sqrt(variance))
    for i, (mean, variance) in enumerate([(0.1, 0.5), (0.1, 0.5), (0.0, 0.2)]):
        add(np.eye(size)[2 * steps + i], mean, np.sqrt(variance))
    root = np.linalg.inv(np.linalg.cholesky(Q))
    for t in range(steps):
        for i, d in enumerate(OLD):
            row = np.zeros(size)
            if t >= d:
                row[2 * (t - d) : 2 * (t - d) + 2] = C[i]
            else:
                row[2 * steps + {(1, -2): 0, (1, -1): 1, (2, -1): 2}[i, t - d]] = 1.0
            add(row, y[t, i], np.sqrt(R[i, i]))
        information = np.array(rows)
        used = np.abs(information).any(axis=0)
        covariance = np.linalg.inv(information[:, used].T @ information[:, used])
        mean = covariance @ information[:, used].T @ np.array(rhs)
        here = [list(np.flatnonzero(used)).index(2 * t + i) for i in (0, 1)]
        out = step(y=y[t], u=u[t])
        np.testing.assert_allclose(out.x_hat[:2], mean[here], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(out.P[:2, :2], covariance[np.ix_(here, here)], rtol=1e-8, atol=1e-13)
        if t + 1 < steps:
            acting = u[t - LATE] if t >= LATE else np.zeros(1)
            for i in range(2):
                row = np.zeros(size)
                row[2 * t + 2 : 2 * t + 4], row[2 * t : 2 * t + 2] = root[i], -root[i] @ A
                add(row, root[i] @ B @ acting, 1.0)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("preview", [0, 4])
def test_the_law_is_the_optimum_of_the_late_plant(preview):
    """By least squares over 300 samples, in which a control that is not sent yet moves nothing for three samples."""
    model = cart().with_delays(LATE, OLD)
    controller = LQGController(
        model, FixedPrecision(), goal_on=[[1.0, 0.0]], goal_covariance=0.04, control_covariance=0.5, preview=preview
    )
    step, rng, sent = controller.online(compiled=False), np.random.default_rng(5), []
    goals = [np.array([0.4])] * (preview + 1)
    for _ in range(8):
        new = rng.normal(size=1) if preview and sent else goals[-1]
        goals = [*goals[1:], new]
        out = step(y=rng.normal(size=3), goal=new)
        horizon, x = 300, np.ravel(out.x_hat)[:2]
        effect, rows, rhs = np.zeros((2, horizon)), [], []
        for t in range(horizon):
            goal = goals[min(t, preview)][0]
            rows += [effect[0] / 0.2, np.eye(horizon)[t] / np.sqrt(0.5)]
            rhs += [(goal - x[0]) / 0.2, 0.0]  # a control of zero holds any position
            known = sent[len(sent) - LATE + t] if 0 <= len(sent) - LATE + t < len(sent) else 0.0
            x, effect = A @ x + B[:, 0] * known, A @ effect
            if t >= LATE:
                effect[:, t - LATE] += B[:, 0]
        optimum = np.linalg.lstsq(np.array(rows), np.array(rhs))[0][0]
        assert float(out.u[0]) == pytest.approx(optimum, rel=1e-8, abs=1e-8)
        sent.append(float(out.u[0]))


def late_loop(model, faults=(), **settings):
    """The cart behind a dead time of 5 samples, with the second sensor 2 samples late."""
    plant = control.ss(A, B, [[1.0, 0.0]], 0, 0.1, inputs=["u"], outputs=["x"])
    wait = control.ss(np.eye(5, k=-1), np.eye(5, 1), np.eye(1, 5, 4), 0, 0.1, inputs=["u"], outputs=["y"])
    series = control.ss(control.series(wait, plant), inputs=["u"], outputs=["y"])
    controller = LQGController(model, goal_covariance=2e-6, **settings)
    return cosim.closed_loop(
        cosim.StateSpace(series),
        controller,
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=0.02),
        faults=[cosim.Delay(sensor=1, delay=0.2), *faults],
        reference=cosim.Step(2.0, after=1.0),
    )


def position():
    return LinearModel(A, B, [[1.0, 0.0], [1.0, 0.0]], 1e-2 * B @ B.T, 4e-4, dt=0.1)


def test_the_loop_tracks_only_if_the_model_has_the_delays():
    worst = {}
    for name, model in (("without", position()), ("with", position().with_delays(5, (0, 2)))):
        result = late_loop(model, precision=FixedPrecision()).simulate(30.0, seed=1)
        worst[name] = np.abs(result["plant.y"] - result["reference.y"])[150:].max()
    assert worst["without"] > 1.0
    assert worst["with"] < 0.05


@pytest.mark.sampled(1)
@pytest.mark.parametrize("sensor", [0, 1])
def test_a_sensor_fails_and_the_right_model_is_not_blamed(sensor):
    loop = late_loop(position().with_delays(5, (0, 2)), [cosim.Drift(sensor=sensor, start=15.0, slope=0.3)])
    one, other = (loop.simulate(end, seed=2, engine=kind) for end, kind in ((30.0, "compiled"), (2.0, "interpreted")))
    for name in other:
        np.testing.assert_array_equal(one[name][:21], other[name])
    runs = [one, *(loop.simulate(30.0, seed=seed) for seed in range(10, 30))]
    probability = np.array([run["controller.fault_probability"] for run in runs])
    assert (probability[:, 20:150] < 0.5).mean() > 0.99  # its first samples repeat, as those of a frozen sensor
    assert (probability[0, 20:150] < 0.5).all()
    assert probability[:, -20:, sensor].min() > 0.99
    assert (probability[:, 150:, 1 - sensor] > 0.5).mean() < 0.05
    assert max(np.nanmax(run["controller.model_suspect"]) for run in runs) < 0.5
    assert max(np.abs(run["plant.y"] - run["reference.y"])[150:].max() for run in runs) < 0.15


def test_disturbance_constant_and_delays_together():
    model = position().with_disturbance(1e-4).about([0.5, 0.0], 0.0, [0.5, 0.5]).with_delays(2, (0, 1))
    assert model.state_names == ("x[0]", "x[1]", "u[-1]", "u[-2]", "y1[-1]", "disturbance[0]", "constant")
    controller = LQGController(model, FixedPrecision(), goal_covariance=0.01, initial_mean=[0.5, 0.1])
    np.testing.assert_array_equal(controller.initial_mean, [0.5, 0.1, 0.0, 0.0, 0.5, 0.0, 1.0])
    assert np.abs(controller.closed_loop_poles()).max() < 1.0 - 1e-6
    assert "Delays in samples: controls by 2; sensors by 0, 1; 3 states of past signals." in controller.describe()
    # A load of 0.4 leaves no error.
    plant = control.ss(A, np.hstack([B, B]), [[1.0, 0.0]], 0, 0.1)
    loop = cosim.closed_loop(
        cosim.StateSpace(plant),
        LQGController(position().with_disturbance(1e-4).with_delays(2, (0, 1)), FixedPrecision(), goal_covariance=0.01),
        control="u0",
        measured="y",
        noise={"u1": cosim.Constant(0.4)},
        sensors=cosim.Sensors(count=2, std=0.0),
        input_faults={"u0": cosim.Delay(delay=0.2)},
        faults=[cosim.Delay(sensor=1, delay=0.1)],
        reference=1.0,
    )
    result = loop.simulate(60.0, seed=1)
    assert result["plant.y"][-1] == pytest.approx(1.0, abs=1e-3)


def test_integrators_that_goals_do_not_see_stay_so_with_late_sensors():
    model = LinearModel(A, B, np.eye(2), Q, 1e-3, dt=0.1).with_delays(2, (3, 1))
    controller = LQGController(model, FixedPrecision(), goal_on=[[0.0, 1.0]], goal_covariance=0.01)
    assert controller.regulator.drifting == 1
    assert controller.regulator.poles(model.matrix("A"), model.matrix("B")).size == model.states - 1


@pytest.mark.parametrize(
    ("mode", "fault"),
    [
        (controllers.LostEffect(), cosim.GainFault(start=8.0, factor=0.4)),
        (controllers.InputOffset(), cosim.Bias(start=8.0, magnitude=1.0)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_actuator_faults_are_inferred_through_a_delay(mode, fault):
    model = LinearModel(A, B, [[1.0, 0.0], [1.0, 0.0]], 1e-2 * B @ B.T + 1e-8 * np.eye(2), 1e-4, dt=0.1).with_delays(3)
    switching = controllers.SwitchingPrecision(actuator_modes=[mode])
    loop = cosim.closed_loop(
        cosim.StateSpace(control.ss(A, B, [[1.0, 0.0]], 0, 0.1)),
        LQGController(model, switching, goal_covariance=0.01),
        control="u",
        measured="y",
        sensors=cosim.Sensors(count=2, std=0.01),
        input_faults={"u": [fault, cosim.Delay(delay=0.3)]},
        reference=cosim.Sine(amplitude=1.0, period=6.0),
    )
    result = loop.simulate(16.0, seed=1)
    probability = result["controller.actuator_fault_probability"].ravel()
    assert probability[30:80].max() < 0.5
    assert probability[-20:].min() > 0.9
    assert result["controller.fault_probability"][-20:].max() < 0.1


@pytest.mark.parametrize("seed", range(6))
def test_poles_are_those_of_the_plant_without_delays_and_zeros(seed):
    """Of short delays the eigenvalues of the whole matrix are exact enough; those that are not near 0 must be the same."""
    rng = np.random.default_rng(seed)
    inputs, sensors = rng.integers(0, 3, 2).tolist(), rng.integers(0, 3, 3).tolist()
    transition = rng.normal(size=(3, 3))
    transition *= 0.9 / np.abs(np.linalg.eigvals(transition)).max()
    model = LinearModel(
        transition, rng.normal(size=(3, 2)), rng.normal(size=(3, 3)), np.diag(rng.uniform(0.1, 1.0, 3)),
        np.diag(rng.uniform(0.1, 1.0, 3)), dt=0.1,
    ).with_delays(inputs, sensors)  # fmt: skip
    controller = LQGController(model, FixedPrecision(), goal_on=np.eye(2, 3), control_covariance=[1.0, 2.0])
    whole, poles = np.linalg.eigvals(controller.closed_loop_matrix()), controller.closed_loop_poles()
    assert len(whole) == len(poles)
    for one, other in ((whole, poles), (poles, whole)):
        large = one[np.abs(one) > 0.02]
        assert np.abs(large[:, None] - other).min(axis=1).max(initial=0.0) < 1e-6


def test_poles_with_noise_that_sensors_of_different_delays_share_are_computed_as_they_are():
    shared = R + 1e-4
    late = LinearModel(A, B, C, Q, shared, dt=0.1).with_delays(0, OLD)
    controller = LQGController(late, FixedPrecision(), goal_on=[[1.0, 0.0]])
    assert controller.undelayed is None
    whole = np.linalg.eigvals(controller.closed_loop_matrix())
    np.testing.assert_array_equal(np.sort_complex(controller.closed_loop_poles()), np.sort_complex(whole))


@pytest.mark.parametrize(("common", "apart"), [(True, False), (False, True)])
def test_poles_with_errors_of_sensors_are_those_of_the_whole_matrix(common, apart):
    """An error that sensors of different delays share changes the poles; errors of each sensor do not."""
    model = position().with_sensor_errors(0.05, 0.4, common=common).with_delays(1, (0, 2))
    controller = LQGController(model, FixedPrecision(), goal_covariance=0.01)
    assert (controller.undelayed is not None) == apart
    whole, poles = np.linalg.eigvals(controller.closed_loop_matrix()), controller.closed_loop_poles()
    for one, other in ((whole, poles), (poles, whole)):
        large = one[np.abs(one) > 0.02]
        assert np.abs(large[:, None] - other).min(axis=1).max() < 1e-6


def test_poles_of_a_long_delay_are_not_rounding():
    for steps in (5, 60):
        controller = LQGController(position().with_delays(steps, (0, steps)), FixedPrecision(), goal_covariance=0.01)
        plain = LQGController(position(), FixedPrecision(), goal_covariance=0.01)
        poles = np.sort_complex(controller.closed_loop_poles())
        np.testing.assert_allclose(poles[poles != 0.0], np.sort_complex(plain.closed_loop_poles()), atol=1e-12)


def test_a_plant_at_rest_stays_at_rest_although_its_control_is_late():
    """About an operating point whose control is not 0, the past controls are those of that point."""
    model = position().about([0.5, 0.0], 0.7, [0.5, 0.5], following=[0.5, 0.0]).with_delays(4, (0, 1))
    controller = LQGController(model, FixedPrecision(), goal_covariance=0.01, initial_mean=[0.5, 0.0]).online(
        compiled=False
    )
    for _ in range(8):
        out = controller(y=[0.5, 0.5], goal=[0.5])
        np.testing.assert_allclose(out.u, 0.7, atol=1e-9)
    np.testing.assert_allclose(out.x_hat[:2], [0.5, 0.0], atol=1e-9)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("old", [(0, 0), (2, 2), (0, 2)])
def test_a_late_sensor_vouches_against_an_absurd_one(old):
    model = LinearModel(A, B, [[1.0, 0.0], [1.0, 0.0]], 1e-2 * B @ B.T, 4e-4, dt=0.1).with_delays(0, old)
    estimator = StateEstimator(model, controllers.SwitchingPrecision()).online(compiled=False)
    rng = np.random.default_rng(0)
    for k in range(60):
        y = 0.02 * rng.normal(size=2)
        if 25 <= k < 45:
            y[1] = 3e8 * (1.0 + 0.01 * rng.normal())
        out = estimator(y=y, u=np.zeros(1))
        assert abs(out.x_hat[0]) < 0.1
    assert out.fault_probability[0] < 0.1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"inputs": -1}, "inputs=-1; a delay is a whole number"),
        ({"inputs": 1.5}, "inputs=1.5; a delay is a whole number"),
        ({"sensors": [1, 2]}, r"sensors=\[1, 2\]; give one number for all, or one for each sensor \(3\)"),
        ({"inputs": "2"}, "inputs is '2'; it must be a number of samples"),
        ({"inputs": 150, "sensors": 150}, "need 450 states"),
        ({"inputs": True}, "inputs=True; it must be a number of samples"),
        ({"sensors": float("nan")}, "sensors=nan; a delay is a whole number"),
        ({"inputs": 0.3}, r"a whole number of samples from 0 to \d+\. 0\.3 s are 3 samples\."),
        ({"inputs": 0.35}, r"a whole number of samples from 0 to \d+\.$"),
    ],
)
def test_wrong_delays_are_refused(settings, message):
    with pytest.raises(ModelError, match=message):
        cart().with_delays(**settings)


def test_a_wrong_delay_of_a_design_has_the_name_of_the_argument():
    plant = control.ss(A, B, [[1.0, 0.0]], 0, 0.1, inputs=["u"], outputs=["x"])
    with pytest.raises(ModelError, match=r"design\(\) has sensor_delays=0.1; .* 0\.1 s are 1 sample\.$"):
        controllers.design(plant, measured="x", actuated="u", acceptable_error=0.1, sensor_delays=0.1)


def test_changes_that_delays_exclude_are_refused():
    late = cart().with_delays(1)
    with pytest.raises(ModelError, match="already has delays"):
        late.with_delays(1)
    for more in (late.with_disturbance(), late.about([0, 0], 0, [0, 0, 0])):  # see test_disturbances.py
        assert more.delays.inputs == (1,)
    with pytest.raises(ModelError, match=r"which a late control does not reach .* Use LQGController"):
        BayesianController(late, control_covariance=1.0)
    with pytest.raises(ModelError, match="The model has delays"):
        controllers.NonlinearModel.from_linear(late)


def test_late_sensors_alone_suit_the_one_step_controller():
    controller = BayesianController(cart().with_delays(sensors=OLD), FixedPrecision(), control_covariance=1.0)
    assert controller.goals == 2
    assert np.asarray(controller.initial_mean).shape == (5,)


def test_poles_of_delays_are_counted_and_not_listed():
    text = LQGController(cart().with_delays(LATE, OLD), goal_on=[[1.0, 0.0]]).describe()
    assert "Without control: 1, 0.9, and 6 at 0 for the delays;" in text


def test_a_late_control_is_diagnosed_only_if_the_model_lacks_it():
    for model, kind in ((position(), "late"), (position().with_delays(5), None)):
        controller = LQGController(model, goal_covariance=0.01)
        loop = cosim.closed_loop(
            cosim.StateSpace(control.ss(A, B, [[1.0, 0.0]], 0, 0.1)),
            controller,
            control="u",
            measured="y",
            sensors=cosim.Sensors(count=2, std=0.02),
            input_faults={"u": cosim.Delay(delay=0.5)},
            reference=cosim.Sine(1.0, 10.0),
        )
        result = loop.simulate(20.0, seed=1)
        found = controllers.diagnose(result, controller, y="sensors.y")
        assert (found and found.kind) == kind
        assert kind is None or ("5 samples" in found.sentence and "with_delays" in found.sentence)


def recording(late=6, rows=1500):
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], size=rows // 3).repeat(3)
    F, x, y = np.array([[0.9, 0.2], [-0.2, 0.85]]), np.zeros(2), []
    for k in range(len(u)):
        y.append(x[0] + 0.02 * rng.normal() + 5.0)
        x = F @ x + np.array([0.1, 0.3]) * (u[k - late] if k >= late else 0.0) + 0.01 * rng.normal(size=2)
    return pd.DataFrame({"time": 0.1 * np.arange(len(u)), "u": u, "y": y}), np.linalg.eigvals(F)


def test_a_known_delay_leaves_the_plants_order():
    table, poles = recording()
    found = LinearModel.identify(table, inputs="u", outputs="y", input_delays=6)
    assert found.model.plant_states == 2
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(found.model.matrix("A")[:2, :2])), np.sort_complex(poles), atol=0.02
    )
    assert found.model.delays.inputs == (6,)
    assert found.fit[0] > 90.0
    assert controllers.design(found).model is found.model
    with pytest.raises(
        ModelError, match=r"identify\(\) has input_delays=\[1, 2\]; give one number for all, or one for each input"
    ):
        LinearModel.identify(table, inputs="u", outputs="y", input_delays=[1, 2])
    with pytest.raises(ModelError, match="has only 5 samples; record more"):
        LinearModel.identify(table.head(5), inputs="u", outputs="y", input_delays=6)


@pytest.mark.slow
def test_a_known_delay_of_a_sensor_leaves_the_plants_order_too():
    table, poles = recording()
    late = table.assign(y=table["y"].shift(4)).dropna()
    found = LinearModel.identify(late, inputs="u", outputs="y", input_delays=6, sensor_delays=4)
    assert (found.model.plant_states, found.model.delays.sensors) == (2, (4,))
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(found.model.matrix("A")[:2, :2])), np.sort_complex(poles), atol=0.02
    )


def test_a_design_with_delays_and_preview_follows_a_sine():
    servo = cosim.FMU(fmus.path("PositionServo"))
    controller = controllers.design(
        servo,
        measured="angle",
        actuated="voltage",
        sensors=2,
        acceptable_control=5.0,
        input_delays=10,
        sensor_delays=[0, 5],
        preview=30,
    )
    assert controller.model.state_names[3:5] == ("voltage[-1]", "voltage[-2]")
    loop = cosim.closed_loop(
        servo,
        controller,
        control="voltage",
        measured="angle",
        sensors=cosim.Sensors(count=2, std=0.01),
        input_faults={"voltage": cosim.Delay(delay=0.1)},
        faults=[cosim.Delay(sensor=1, delay=0.05)],
        reference=cosim.Sine(0.5, 4.0),
    )
    result = loop.simulate(6.0, seed=1)
    assert np.abs(result["plant.angle"] - result["reference.y"])[300:].max() < 0.03
    assert (result["controller.fault_probability"][50:] < 0.5).all()
