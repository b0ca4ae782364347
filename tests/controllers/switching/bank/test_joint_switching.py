"""The joint form of switching: offsets together with the state, against filterpy and Bayes; several sensors and faults."""

import control
import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from scipy import stats

from bayesftc import controllers, cosim
from bayesftc.controllers import Drifting, DroppedOut, Frozen, LinearModel, Noisier, Offset, Ramping, SwitchingPrecision
from bayesftc.controllers.switching.bank.hypothesis import Moving, Onset, Places, blend, correct, expect, move
from bayesftc.cosim.errors import ModelError

STEP, A, Q = 0.02, 0.999, 0.001
NOISE = (1.0, 4.0)
MEAN_NOISE = 2.0  # geometric mean, the unit of offsets
NEVER = 1e15


def model(m=2, noise=NOISE):
    return LinearModel([[A]], [[2e-4]], [[1.0]] * m, Q, np.resize(noise, m), STEP)


def inferred(precision, y, initial=20.0, m=2, noise=NOISE):
    """Return the outputs of an estimator over the rows of y."""
    estimator = controllers.StateEstimator(model(m, noise), precision, initial_mean=initial, initial_covariance=0.5)
    step = estimator.online(compiled=False)
    with np.errstate(all="ignore"):
        return [step(y=list(row), u=0.0) for row in y]


def imm(y, slope, time_to_fault):
    """Return means and mode probabilities of filterpy's interacting multiple models: nothing, a drift of either sensor.

    Each has the state [x, c_0, b_0, c_1, b_1]; an offset that has not begun waits with what is expected of it.
    """
    begins = STEP / time_to_fault
    filters = []
    for drifting in (None, 0, 1):
        one = KalmanFilter(5, 2)
        one.x = np.array([20.0, 0, 0, 0, 0])[:, None]
        one.P = np.diag([0.5, 0, slope**2 * MEAN_NOISE, 0, slope**2 * MEAN_NOISE])
        one.F, one.Q, one.R = np.diag([A, 1.0, 1, 1, 1]), np.diag([Q, 0, 0, 0, 0]), np.diag(NOISE)
        one.H = np.array([[1.0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0]])
        if drifting is not None:
            one.F[1 + 2 * drifting, 2 + 2 * drifting] = 1.0
            one.H[drifting, 1 + 2 * drifting] = 1.0
        filters.append(one)
    alone = 1 - begins  # while the other sensor does not begin to drift, which neither follows
    M = np.array([[1 - 2 * begins, begins, begins], [0, alone, 0], [0, 0, alone]])
    # The first sample comes before any time has passed for the state, so its prediction undoes one step of it.
    bank = IMMEstimator(filters, [1.0 - 2e-12, 1e-12, 1e-12], M)
    for one in filters:
        one.x[0] /= A
        one.P[0, 0] = (0.5 - Q) / A**2
    for row in y:
        bank.predict()
        bank.update(row[:, None])
        yield bank.x[0, 0], bank.P[0, 0], bank.mu.copy()


def test_drifts_of_two_sensors_are_told_apart_as_by_filterpys_interacting_models():
    rng = np.random.default_rng(2)
    x, rows = 20.0, []
    for k in range(80):
        rows.append(x + np.sqrt(NOISE) * rng.normal(size=2) + [0.0, 0.15 * max(0, k - 30)])
        x = A * x + np.sqrt(Q) * rng.normal()
    slope, time_to_fault = 0.1, 2.0
    modes = (Drifting(time_to_fault, NEVER, slope=slope),)
    precision = SwitchingPrecision(modes, loss=1e-9, process_modes=(), noise_factor=1.0)
    for out, (mean, variance, mu) in zip(
        inferred(precision, rows), imm(np.array(rows), slope, time_to_fault), strict=True
    ):
        assert out.x_hat[0] == pytest.approx(mean, rel=1e-9)
        assert out.P[0, 0] == pytest.approx(variance, rel=1e-6)
        np.testing.assert_allclose(out.mode_probability[:, 1], mu[1:], rtol=1e-5, atol=1e-9)
    assert out.mode_probability[1, 1] > 0.99


@pytest.mark.parametrize("drifting", [0, 1])
def test_a_drift_that_only_the_difference_of_two_sensors_shows_is_as_probable_of_the_noisy_one(drifting):
    """The state wanders by far more than either sensor drifts, so nothing but their difference tells of the drift."""
    rng, steps = np.random.default_rng(drifting), np.arange(200)
    y = np.cumsum(3.0 * rng.normal(size=200))[:, np.newaxis] + rng.normal(size=(200, 2)) * [0.1, 1.0]
    y[:, drifting] += 0.04 * np.clip(steps - 40, 0, None)
    wanders = LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 9.0, [0.01, 1.0], STEP)
    precision = SwitchingPrecision((Drifting(),), process_modes=())
    step = controllers.StateEstimator(wanders, precision, initial_mean=0.0, initial_covariance=0.5).online(
        compiled=False
    )
    out = [step(y=list(row)) for row in y][-1]
    assert out.fault_probability.sum() > 0.95
    np.testing.assert_allclose(out.fault_probability, 0.5, atol=0.2)


@pytest.mark.parametrize("seed", [1, 4])
def test_the_only_sensor_of_a_healthy_plant_is_not_blamed(seed):
    """Drift and disturbance look alike without it; a hypothesis that knows the state no more must not spoil the others."""
    A, noise = np.array([[0.985, 2.0], [0.0, 1.0]]), np.diag([4e-8, 1e-8])
    rng, state, rows = np.random.default_rng(seed), np.zeros(2), []
    for _ in range(3000):
        rows.append(state[0] + 0.01 * rng.normal())
        state = A @ state + np.sqrt(np.diag(noise)) * rng.normal(size=2)
    single = LinearModel(A, [[2.0], [0.0]], [[1.0, 0.0]], noise, 1e-4, 1.0)
    estimator = controllers.StateEstimator(single, SwitchingPrecision(), [0.0, 0.0], np.diag([1e-4, 1e-6]))
    step = estimator.online()
    assert np.mean([step(y=[y], u=[0.0]).fault_probability[0] > 0.5 for y in rows]) < 0.02


def test_a_sudden_load_is_not_blamed_on_the_first_of_equal_sensors():
    """Heat is lost through a door, ten times as fast as the model expects of its disturbance; no sensor has a fault."""
    air, wall, between, ambient = 6e3, 20e3, 40.0, 17.5
    chamber = control.ss(
        [[-between / air, between / air], [between / wall, -(between + ambient) / wall]],
        [[1 / air, -1 / air], [0.0, 0.0]], np.eye(2), 0,
        inputs=["heater", "loss"], outputs=["air", "wall"], states=["air", "wall"],
    )  # fmt: skip
    sensors = cosim.Sensors(count=[4, 1], std=[0.1] * 4 + [0.3])
    controller = controllers.design(
        chamber, measured=["air", "wall"], sensors=[4, 1], sensor_std=[0.1] * 4 + [0.3], actuated="heater", goal="air", dt=10.0,
        acceptable_error=0.5, acceptable_control=300.0, u_min=-700.0, u_max=1300.0, disturbance=4000.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        chamber, controller, control="heater", measured=["air", "wall"], sensors=sensors, reference=5.0,
        input_faults={"loss": [cosim.Bias(magnitude=800.0, start=3000.0, stop=3300.0)]},
    )  # fmt: skip
    for seed in (1, 3):
        blamed = loop.simulate(7200.0, seed=seed)["controller.fault_probability"] > 0.5
        assert blamed.mean(axis=0).max() < 0.05
        assert blamed[361:].mean(axis=0).max() < 0.01


def test_a_fault_of_the_only_sensor_ends_with_it():
    """In 8 runs of the same tank, an offset of 5 sd is found, and no longer blamed soon after its end."""
    A, noise = np.array([[0.985, 2.0], [0.0, 1.0]]), np.diag([1e-6, 1e-8])
    single = LinearModel(A, [[2.0], [0.0]], [[1.0, 0.0]], noise, 1e-4, 1.0)
    estimator = controllers.StateEstimator(single, SwitchingPrecision(), [0.0, 0.0], np.diag([1e-4, 1e-6]))
    blamed = np.empty((8, 1000))
    for seed, run in enumerate(blamed):
        rng, state, step = np.random.default_rng(seed), np.zeros(2), estimator.online()
        for k in range(1000):
            y = state[0] + 0.01 * rng.normal() + 0.05 * (300 <= k < 600)
            run[k] = step(y=[y], u=[0.0]).fault_probability[0] > 0.5
            state = A @ state + np.sqrt(np.diag(noise)) * rng.normal(size=2)
    assert blamed[:, :300].mean() < 0.02
    assert blamed[:, 310:600].mean() > 0.8
    assert blamed[:, 620:].mean() < 0.1


def test_the_first_sample_is_bayes_rule_with_all_sensors_at_once():
    modes = (Offset(1.0, jump=3.0), Drifting(2.0, slope=0.5))
    (out,) = inferred(SwitchingPrecision(modes=modes, process_modes=(), noise_factor=1.0), [[24.0, 20.5]])
    shared, begins = 0.5 * np.ones((2, 2)), [STEP / 1.0, STEP / 2.0]
    weights = [1 - 2 * sum(begins)]
    told = [stats.multivariate_normal.pdf([4.0, 0.5], cov=shared + np.diag(NOISE))]
    for i in range(2):
        for variance, begin in zip((9.0, 0.25), begins, strict=True):  # more than the squared innovations, 16 and 0.25
            more = np.diag([variance * MEAN_NOISE * (j == i) for j in range(2)])
            weights.append(begin)
            told.append(stats.multivariate_normal.pdf([4.0, 0.5], cov=shared + np.diag(NOISE) + more))
    p = np.array(weights) * told
    p /= p.sum()
    # Only to the chance that two sensors fail at once, which is shared out otherwise.
    np.testing.assert_allclose(out.mode_probability[:, 1:].ravel(), p[1:], rtol=0.05)


def test_a_hypothesis_is_filtered_as_filterpy_does():
    """Moving, conditioning on a sensor with and without the offset, and merging, with two states."""
    rng = np.random.default_rng(4)
    n, N = 2, 4
    root = rng.normal(size=(N, N))
    mean, P = rng.normal(size=N), root @ root.T
    F, q, C = np.array([[1.0, 0.1], [0.0, 0.9]]), np.diag([0.1, 0.2]), rng.normal(size=(2, n))
    memory, scratch = np.zeros(2 + N + N * N + 3 * N * N), 2 + N + N * N
    memory[2 : 2 + N], memory[2 + N : scratch] = mean, P.ravel()
    couples = scratch + N * N
    shift = couples + n
    memory[couples:shift], memory[shift : shift + n] = [0.2, -0.4], [0.5, 0.6]
    onset, moving = Onset(0.0, 1.0, 1.0, 1.0, 0.3), Moving(F, q, False, np.eye(2), 1e20)
    move(memory, 0, n, 1, 1, onset, moving, Places(couples, shift, scratch))
    one = KalmanFilter(N, 1)
    one.x, one.P = mean[:, None], P
    one.F = np.block([[F, np.array([[0.2, 0.0], [-0.4, 0.0]])], [np.zeros((2, 2)), np.array([[1.0, 1.0], [0.0, 1.0]])]])
    one.B = np.array([[0.5], [0.6], [0.0], [0.0]])
    one.Q = np.diag([0.1, 0.2, 0.3, 0.0])
    one.predict(u=1.0)
    for sensor, reads in ((0, 1), (1, 0)):
        spread, expected = expect(memory, 0, n, 1, reads, sensor, C, scratch)
        correct(memory, 0, n, 1, reads, sensor, C, scratch, 1.3 - expected, spread + 0.7, 0.7, 1.0)
        one.H = np.array([[*C[sensor], float(reads), 0.0]])
        one.update(1.3, R=0.7)
    np.testing.assert_allclose(memory[2 : 2 + N], one.x[:, 0], rtol=1e-12)
    np.testing.assert_allclose(memory[2 + N : scratch].reshape(N, N), one.P, rtol=1e-10, atol=1e-12)
    other = np.concatenate([memory, np.zeros(scratch)])
    at = len(memory)
    other[at + 2 : at + 2 + n] = [5.0, -1.0]
    other[at + 2 + N : at + 2 + N + N * N] = np.pad(np.diag([2.0, 3.0]), (0, 2)).ravel()
    blend(other, 0, 0.3, at, n, 1, 7.0, 0.5, 4.0, 0.1, 0.2)
    samples = [(0.7, one.x[:, 0], one.P), (0.3, np.array([5.0, -1.0, 7.0, 0.5]), np.diag([2.0, 3.0, 4.0, 0.2]))]
    samples[1][2][2, 3] = samples[1][2][3, 2] = 0.1
    middle = sum(w * x for w, x, _ in samples)
    whole = sum(w * (S + np.outer(x - middle, x - middle)) for w, x, S in samples)
    np.testing.assert_allclose(other[2 : 2 + N], middle, rtol=1e-12)
    np.testing.assert_allclose(other[2 + N : scratch].reshape(N, N), whole, rtol=1e-10, atol=1e-12)


def test_an_offset_that_jumps_is_estimated_as_by_filterpy_from_its_first_sample_on():
    """It begins at once and for good: not merged with offsets that had been there before, and together with the state."""
    a, q, noise = 0.999, 0.05, np.diag([1.0, 2.0])
    modes = [Offset(10 * STEP, NEVER, jump=50.0, walk=0.1)]
    precision = SwitchingPrecision(modes, loss=1e-9, process_modes=(), noise_factor=1.0)
    step = controllers.StateEstimator(
        LinearModel([[a]], [[0.1]], [[1.0], [1.0]], q, noise, STEP),
        precision,
        initial_mean=20.0,
        initial_covariance=0.5,
    ).online(compiled=False)
    one = KalmanFilter(2, 2, 1)
    one.x, one.P = np.array([[20.0], [0.0]]), np.diag([0.5, 50.0**2 * 2.0**0.5])  # the mean noise of both
    one.F, one.B, one.H = np.diag([a, 1.0]), np.array([[0.1], [0.0]]), np.array([[1.0, 1.0], [1.0, 0.0]])
    one.Q, one.R = np.diag([q, 0.1**2 * 2.0**0.5]), noise
    rng = np.random.default_rng(3)
    for _ in range(20):
        y, u = 20.0 + rng.normal(size=2) + [40.0, 0.0], rng.normal()
        one.update(y[:, None])
        out = step(y=list(y), u=[u])
        one.predict(u=np.array([[u]]))
        assert out.x_hat[0] == pytest.approx(float(one.x_post[0, 0]), abs=0.01)


@pytest.mark.parametrize("modes", [(Offset(),), (Offset(300.0, 2 * STEP),), SwitchingPrecision().modes])
def test_a_single_wrong_sample_of_one_sensor_is_not_blamed_on_the_other(modes):
    rng, rows = np.random.default_rng(1), []
    for k in range(60):
        rows.append(20.0 + rng.normal(size=2) + [15.0 * (k == 30), 0.0])
    outs = inferred(SwitchingPrecision(modes, process_modes=()), rows, m=2, noise=(1.0,))
    assert max(out.fault_probability[1] for out in outs) < 0.05
    assert outs[40].fault_probability[0] < 0.5


def faulty(m, faults, steps=500, seed=0):
    """Return samples of m sensors of a wandering speed, with faults {sensor: (kind, first step)}, and the speed."""
    rng, x, rows, speeds = np.random.default_rng(seed), 20.0, [], []
    last = np.full(m, 20.0)
    for k in range(steps):
        row = x + rng.normal(size=m)
        for sensor, (kind, start) in faults.items():
            if k >= start:
                row[sensor] = {
                    "Frozen": last[sensor], "Offset": row[sensor] + 6.0, "Drifting": row[sensor] + 0.05 * (k - start),
                    "DroppedOut": np.nan, "Noisier": x + 6.0 * rng.normal(),
                }[kind]  # fmt: skip
        last = row.copy()
        rows.append(row)
        speeds.append(x)
        x = A * x + np.sqrt(Q) * rng.normal()
    return rows, np.array(speeds)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("m", "faults"),
    [
        (1, {0: ("Offset", 200)}),
        (1, {0: ("Frozen", 200)}),
        (2, {0: ("Offset", 150), 1: ("Frozen", 300)}),
        (2, {0: ("Frozen", 150), 1: ("Offset", 300)}),
        (2, {0: ("Offset", 150), 1: ("Offset", 300)}),
        (2, {0: ("Drifting", 100), 1: ("DroppedOut", 400)}),
        (2, {0: ("Noisier", 150), 1: ("Offset", 300)}),
        (3, {0: ("Drifting", 100), 1: ("Offset", 250)}),
        (3, {0: ("Offset", 100), 1: ("Drifting", 200)}),
        (4, {0: ("Offset", 100), 2: ("Drifting", 200), 3: ("Frozen", 300)}),
    ],
)
def test_faults_of_several_sensors_are_told_apart_and_survived(m, faults):
    rows, speeds = faulty(m, faults)
    outs = inferred(SwitchingPrecision(), rows, m=m, noise=(1.0,))
    kinds = [type(mode).__name__ for mode in SwitchingPrecision().modes]
    end = outs[-1]
    for sensor in range(m):
        kind = kinds[int(end.fault_kind[sensor]) - 1] if end.fault_kind[sensor] > 0 else None
        expected = faults.get(sensor, (None, 0))[0]
        assert kind == expected or {kind, expected} <= {"Offset", "Drifting", "Ramping"}, (sensor, end.mode_probability)
    errors = [abs(out.x_hat[0] - speed) for out, speed in zip(outs, speeds, strict=True)]
    assert max(errors[50:]) < 2.0
    # What it says of its own error is true, though the speed is a guess where nothing is left to measure it.
    assert all(error < 5 * np.sqrt(out.P[0, 0]) for error, out in zip(errors, outs, strict=True))


@pytest.mark.slow
def test_twenty_sensors_of_which_a_few_fail():
    rows, speeds = faulty(20, {3: ("Offset", 5), 11: ("Frozen", 10)}, steps=40)
    outs = inferred(SwitchingPrecision(), rows, m=20, noise=(1.0,))
    failed = np.flatnonzero(outs[-1].fault_probability > 0.5)
    assert failed.tolist() == [3, 11]
    assert abs(outs[-1].x_hat[0] - speeds[-1]) < 0.5


def test_a_slow_drift_needs_a_witness_and_a_sensor_without_one_is_believed():
    """The drift of the only sensor is the state's own motion, as far as anybody can know."""
    rows, _ = faulty(1, {0: ("Drifting", 100)}, steps=300)
    outs = inferred(SwitchingPrecision(modes=(Drifting(),)), rows, m=1, noise=(1.0,))
    assert outs[-1].fault_probability[0] < 0.01


def test_correlated_sensors_and_wrapped_learners_are_judged_one_by_one():
    correlated = LinearModel([[A]], [[2e-4]], [[1.0], [1.0]], Q, [[1.0, 0.5], [0.5, 1.0]], STEP)
    assert SwitchingPrecision().learner(correlated).infer is None
    assert SwitchingPrecision(joint=False).learner(model()).infer is None
    assert SwitchingPrecision(modes=(Frozen(), Noisier(), DroppedOut())).learner(model()).infer is None
    assert SwitchingPrecision().learner(model()).infer is not None
    with pytest.raises(ModelError, match="joint=3"):
        SwitchingPrecision(joint=3)


@pytest.mark.slow
def test_both_engines_give_the_same_bits_whatever_the_samples_are():
    """Also after samples that no sensor sends; beliefs stay numbers, and come back.

    Of an estimator, which test_estimator compiles too; that of a controller is compiled with modes of actuators as well.
    """
    rng = np.random.default_rng(7)
    absurd = [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e150, 1e-300, 0.0, 1e9, -1e20]
    rows = np.concatenate([rng.normal(size=(60, 2)), rng.choice(absurd, size=(200, 2)), rng.normal(size=(60, 2))])
    estimator = controllers.StateEstimator(model(), SwitchingPrecision())
    plain, fast = estimator.online(compiled=False), estimator.online(compiled=True)
    for row in rows:
        one, other = (step(y=list(row), u=[50.0]) for step in (plain, fast))
        for name in ("x_hat", "P", "fault_probability", "mode_probability", "fault_size"):
            np.testing.assert_array_equal(one[name], other[name])
        assert np.isfinite(one.x_hat).all()
        assert 0 < one.P[0, 0] < np.inf
        assert ((one.fault_probability >= 0) & (one.fault_probability <= 1)).all()


def test_ramps_take_part_in_the_joint_form_only():
    joint, single = (
        SwitchingPrecision(modes=(Ramping(), Noisier())),
        SwitchingPrecision(modes=(Ramping(), Noisier()), joint=False),
    )
    rows = [[20.0 + 0.5 * max(0, k - 20), 20.0] for k in range(60)]
    assert inferred(joint, rows)[-1].fault_kind[0] == 1
    assert inferred(single, rows)[-1].fault_kind[0] == 2
