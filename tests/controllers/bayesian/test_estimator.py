"""The estimator alone: a Kalman filter (filterpy's) and the controller's belief; sensors' errors as states, against scipy."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy import linalg

from bayesftc import cosim
from bayesftc.controllers import (
    BayesianController,
    FixedPrecision,
    GammaPrecision,
    LinearModel,
    NonlinearBayesianController,
    NonlinearModel,
    Proportional,
    StateEstimator,
    SwitchingPrecision,
)
from bayesftc.cosim.blocks.state_space import LinearSystem
from bayesftc.cosim.errors import ConnectionError, ModelError

DT = 0.02
CAR = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], DT)
WHEELS = CAR.with_disturbance(25.0).with_sensor_errors(0.3, (0.5, 5.0)).with_sensor_errors((0.2, 0.1), 2.0, common=True)


def samples(model, steps, seed=0):
    """Return samples of the model, a tenth of them missing, and its inputs."""
    rng = np.random.default_rng(seed)
    A, B, C = (model.matrix(name) for name in "ABC")
    Q, R = (np.linalg.cholesky(model.matrix(name)) for name in ("process_covariance", "sensor_covariance"))
    x, u = np.zeros(len(A)), 1000.0 * rng.standard_normal((steps, B.shape[1]))
    y = np.empty((steps, len(C)))
    for k in range(steps):
        y[k] = C @ x + R @ rng.standard_normal(len(C))
        x = A @ x + B @ u[k] + Q @ rng.standard_normal(len(A))
    y[rng.random(y.shape) < 0.1] = np.nan
    return y, u


def test_with_fixed_precision_it_is_filterpys_kalman_filter():
    model = WHEELS
    y, u = samples(model, 300)
    estimator = StateEstimator(model, FixedPrecision(), initial_mean=3.0)
    reference = KalmanFilter(model.states, 1, dim_u=1)
    reference.F, reference.B, reference.Q = model.matrix("A"), model.matrix("B"), model.matrix("process_covariance")
    reference.x, reference.P = np.array(estimator.initial_mean)[:, None], np.array(estimator.initial_covariance)
    step = estimator.online(compiled=False)
    for row, known in zip(y, u, strict=True):
        out = step(y=row, u=known)
        for i in np.flatnonzero(np.isfinite(row)):  # independent sensors may be taken one by one
            reference.update(row[i], R=model.matrix("sensor_covariance")[i, i], H=model.matrix("C")[[i]])
        np.testing.assert_allclose(out.x_hat, reference.x[:, 0], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(out.P, reference.P, rtol=1e-8, atol=1e-12)
        assert np.isnan(out.innovation).tolist() == np.isnan(row).tolist()
        reference.predict(known[:, None])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", [FixedPrecision(), GammaPrecision(), SwitchingPrecision(loss=(0.1, 0.2))])
def test_it_is_the_belief_of_the_controller_that_drives(precision):
    y, _ = samples(CAR, 100)
    drive = BayesianController(CAR, precision=precision, initial_mean=1.0).online(compiled=False)
    watch = StateEstimator(CAR, precision, initial_mean=1.0, initial_covariance=1.0).online(compiled=False)
    for k, row in enumerate(y):
        theirs = drive(y=row, goal=[np.sin(k / 10)])
        ours = watch(y=row, u=theirs.u)
        for name in ours:
            np.testing.assert_array_equal(ours[name], theirs[name], err_msg=name)


def watched(engine, precision):
    """Return the run of a loop that a plain law drives on the estimator's belief."""
    car = cosim.StateSpace(LinearSystem(((0.999,),), ((2e-4,),), ((1.0,),), ((0.0,),), DT, ("u",), ("v",)))
    diagram = cosim.Diagram(dt=DT)
    plant, sensors = diagram.add(car, "plant"), diagram.add(cosim.Sensors(count=2, std=(1.0, 2.0)), "sensors")
    freeze = diagram.add(cosim.Freeze(sensor=0, start=1.0, stop=3.0, channels=2), "freeze")
    watch, law = diagram.add(StateEstimator(CAR, precision)), diagram.add(Proportional(gain=[[500.0]]), "law")
    goal = diagram.add(cosim.Constant(5.0), "goal")
    for source, sink in (
        (plant["v"], sensors["u"]), (sensors["y"], freeze["u"]), (freeze["y"], watch["y"]), (watch["x_hat"], law["x_hat"]),
        (goal["y"], law["goal"]), (law["u"], plant["u"]), (law["u"], watch["u"]),
    ):  # fmt: skip
        diagram.connect(source, sink)
    return diagram.simulate(4.0, seed=3, engine=engine)


@pytest.mark.slow
def test_its_belief_may_drive_the_plant_without_an_algebraic_loop_and_both_engines_agree():
    compiled, interpreted = (watched(engine, SwitchingPrecision()) for engine in ("compiled", "interpreted"))
    for name in compiled:
        np.testing.assert_array_equal(compiled[name], interpreted[name], err_msg=name)
    frozen = compiled["estimator.fault_probability"][75:150]
    assert frozen[:, 0].min() > 0.99
    assert frozen[:, 1].max() < 0.5


def test_a_missing_input_goes_on_and_a_forgotten_one_is_refused():
    def beliefs(*inputs):
        step = StateEstimator(CAR, FixedPrecision(), 1.0).online(compiled=False)
        return [float(step(y=[np.nan, np.nan], **given).x_hat[0]) for given in inputs]

    held = {"u": [500.0]}
    assert beliefs(held, held, held) == beliefs(held, {"u": [np.nan]}, {"u": [np.inf]})
    assert beliefs(held, held, held)[2] == pytest.approx(0.999**2 + 0.1 * 1.999)
    assert beliefs({"u": [np.nan]}, {"u": [0.0]}) == [1.0, 0.999]
    with pytest.raises(ModelError, match="needs its input 'u'"):
        beliefs({})
    unmoved = replace(CAR, B=[[0.0]])
    assert StateEstimator(unmoved, FixedPrecision(), 1.0).online(compiled=False)(y=[np.nan, np.nan]).x_hat == [1.0]
    diagram = cosim.Diagram(DT)
    estimator = diagram.add(StateEstimator(CAR))
    sensors = diagram.add(cosim.Sensors(2, 0.1))
    diagram.connect(diagram.add(cosim.Constant(0.0))["y"], sensors["u"])
    diagram.connect(sensors["y"], estimator["y"])
    with pytest.raises(ConnectionError, match=r"estimator"):
        diagram.simulate(1.0)


def test_a_model_without_inputs_and_pickling():
    level = LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 0.01, 1.0, 1.0)
    block = pickle.loads(pickle.dumps(StateEstimator(level, SwitchingPrecision())))
    out = block.online(compiled=False)(y=[1.0, 1.1, 9.0])
    assert out.fault_probability.argmax() == 2
    assert block.sample_time == 1


def test_sensor_errors_keep_their_variance_and_forget_in_their_time():
    model = CAR.with_sensor_errors((0.3, 0.1), (0.5, 5.0))
    assert (model.states, model.disturbances, model.sensors) == (3, 2, 2)
    A, Q = model.matrix("A")[1:, 1:], model.matrix("process_covariance")[1:, 1:]
    np.testing.assert_allclose(linalg.solve_discrete_lyapunov(A, Q), np.diag([0.09, 0.01]), atol=1e-15)
    np.testing.assert_allclose(np.linalg.matrix_power(A, 25)[0, 0], np.exp(-1))
    np.testing.assert_array_equal(model.matrix("C")[:, 1:], np.eye(2))
    np.testing.assert_allclose(np.diag(StateEstimator(model).initial_covariance), [1.0, 0.09, 0.01])
    common = CAR.with_sensor_errors((0.2, 0.1), 2.0, sensors=(1, 0), common=True)
    A, Q, C = (common.matrix(name) for name in ("A", "process_covariance", "C"))
    covariance = C[:, 1:] @ linalg.solve_discrete_lyapunov(A[1:, 1:], Q[1:, 1:]) @ C[:, 1:].T
    np.testing.assert_allclose(covariance, np.outer([0.1, 0.2], [0.1, 0.2]))
    assert BayesianController(common, control_covariance=1e6).goals == 1  # no goal is for a sensor's error


def test_a_bias_and_a_coloured_noise_are_estimated():
    """Three sensors of a still quantity, one with a bias: what the model says of biases shares it out by Bayes' rule."""
    plain = LinearModel([[1.0]], [[0.0]], [[1.0]] * 3, 1e-12, 0.01, 0.01)
    estimator = StateEstimator(
        plain.with_sensor_errors(0.5, 1e6), FixedPrecision(), initial_covariance=[100.0, 0.25, 0.25, 0.25]
    )
    step = estimator.online(compiled=False)
    for _ in range(200):
        out = step(y=[10.0, 10.0, 10.6])
    np.testing.assert_allclose(out.x_hat, [10.2, -0.2, -0.2, 0.4], atol=1e-2)


def test_a_sensors_own_error_is_no_quantity_of_the_plant():
    """Two sensors of one speed have one goal, and what they measure is the speed."""
    model = CAR.with_sensor_errors((0.3, 0.1), (0.5, 5.0))
    expected = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    controller = BayesianController(model, goal_on="outputs")
    np.testing.assert_array_equal(controller.goal_matrix, expected[:1])
    nonlinear = NonlinearBayesianController(NonlinearModel.from_linear(model), goal_on=expected[:1])
    for block in (controller, StateEstimator(model), nonlinear):
        np.testing.assert_array_equal(block.measurement_matrix, expected)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: StateEstimator(3), "needs a LinearModel, not 3"),
        (lambda: StateEstimator(CAR, "gamma"), "must be a precision learner"),
        (lambda: StateEstimator(CAR, initial_mean=(1.0, 2.0)), "initial_mean has the shape"),
        (lambda: StateEstimator(CAR, initial_mean="here"), "initial_mean is 'here'"),
        (lambda: StateEstimator(CAR, initial_covariance=-1.0), "initial_covariance is not positive semi-definite"),
        (lambda: StateEstimator(CAR, SwitchingPrecision(loss=(0.1, 0.1, 0.1))), "vector of 2"),
        (lambda: CAR.with_sensor_errors(0.0, 1.0), "std=0.0"),
        (lambda: CAR.with_sensor_errors(1.0, (1.0, np.inf)), "must be finite numbers"),
        (lambda: CAR.with_sensor_errors((1.0, 2.0, 3.0), 1.0), "must be a vector of 2"),
        (lambda: CAR.with_sensor_errors(1.0, 1.0, sensors=(0, 0)), "each sensor once"),
        (lambda: CAR.with_sensor_errors(1.0, 1.0, sensors=()), "at least one"),
        (lambda: CAR.with_sensor_errors(1.0, 1.0, sensors=(2,)), "sensor=2"),
        (lambda: CAR.with_sensor_errors(1.0, (1.0, 2.0), common=True), "one time_constant"),
        (
            lambda: CAR.with_disturbance().with_sensor_errors(1.0, 1.0).with_disturbance(),
            "already estimates a disturbance",
        ),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()
