"""Process modes: one hypothesis is a Kalman filter of its own (filterpy); a kick is no fault of the sensors."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from bayesftc.controllers import (
    BayesianController,
    FixedPrecision,
    LinearModel,
    NoisierProcess,
    Offset,
    StateEstimator,
    SwitchingPrecision,
)
from bayesftc.controllers.switching.filter_share import filter_share
from bayesftc.cosim.errors import ModelError

STEP = 0.02
MODEL = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, STEP)
NEVER, AT_ONCE = 1e15, 1e-15


def filtered(model, mode, steps, noise, left=1.0):
    """Compare with filterpy's filter, in which ``noise`` is added to the process noise from the first sample on.

    From the second one on only what is ``left`` of it.
    """
    n, m = model.states, model.sensors
    A, B, C, Q = (model.matrix(name) for name in ("A", "B", "C", "process_covariance"))
    precision = SwitchingPrecision(
        [Offset(NEVER, NEVER)], loss=1e-9, process_modes=[mode], alike=0.0, start_doubt=0.0, noise_factor=1.0
    )
    step = StateEstimator(model, precision, initial_covariance=0.3).online(compiled=False)
    one = KalmanFilter(n, m, 1)
    one.x, one.P = np.zeros((n, 1)), 0.3 * np.eye(n) + noise  # it begins with the first sample
    one.F, one.B, one.H, one.Q, one.R = A, B, C, Q + left * noise, model.matrix("sensor_covariance")
    rng = np.random.default_rng(3)
    for _ in range(steps):
        y, u = rng.normal(size=m), rng.normal()
        one.update(y[:, None])
        out = step(y=list(y), u=[u])
        np.testing.assert_allclose(out.x_hat, one.x[:, 0], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(out.P, one.P, rtol=1e-6)
        one.predict(u=np.array([[u]]))
    return out


TWO = LinearModel(
    [[1.0, STEP], [0.0, 0.98]], [[0.0], [STEP]], [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[0.02, 0.01], [0.01, 0.05]],
    np.diag([1.0, 4.0, 0.5]), STEP,
)  # fmt: skip


def test_a_noisier_process_is_filtered_as_filterpy_does():
    out = filtered(TWO, NoisierProcess(AT_ONCE, NEVER, scale=7.0), 40, 48.0 * TWO.matrix("process_covariance"))
    assert out.process_mode_probability[1] == pytest.approx(1.0)


def test_a_quieter_process_is_filtered_as_filterpy_does():
    filtered(TWO, NoisierProcess(AT_ONCE, NEVER, scale=0.3), 40, -0.91 * TWO.matrix("process_covariance"))


def test_a_kick_is_one_sample_of_noise():
    out = filtered(TWO, NoisierProcess(AT_ONCE, 0.0, scale=7.0), 2, 48.0 * TWO.matrix("process_covariance"), left=0.0)
    assert out.process_mode_probability[2] == pytest.approx(1.0)  # it has ended


def test_the_plant_is_kicked_and_not_the_force_that_is_estimated():
    model = MODEL.with_disturbance(4.0)
    filtered(model, NoisierProcess(AT_ONCE, NEVER, scale=7.0), 40, np.diag([48.0 * 0.001, 0.0]))


def test_a_plant_without_noise_has_no_modes():
    still = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.0, 1.0, STEP)
    assert "process_mode_probability" not in {port.name for port in SwitchingPrecision().learner(still).ports}
    with pytest.raises(ModelError, match="scale the process noise of the plant"):
        SwitchingPrecision(process_modes=[NoisierProcess()]).learner(still)


def drive(precision, kick=0.0, bias=0.0, hill=0.0, share=1.0, late=0, wave=0.0, seed=0, compiled=True):
    """Run the car: it is kicked at 4 s, and the first sensor is wrong from 6 to 8 s.

    Always is there a hill (a force in N), and only a share of the force, late by so many samples; a wave is that of the goal.
    """
    rng, x, forces = np.random.default_rng(seed), 20.0, [0.0] * late
    step = BayesianController(MODEL, precision=precision, initial_mean=20.0).online(compiled=compiled)
    for k in range(500):
        x += kick * (k == 200)
        y = x + rng.normal(size=2)
        y[0] += bias * (300 <= k < 400)
        goals = [20.0 + wave * np.sin(0.8 * STEP * t) for t in (k, k + 1)]
        out = step(y=list(y), goal=goals[1:])
        yield out, x - goals[0]
        forces.append(out.u[0])
        x = 0.999 * x + 2e-4 * (share * forces.pop(0) - hill) + 0.001**0.5 * rng.normal()


def error(precision, **events):
    _, missed = zip(*drive(precision, **events), strict=True)
    return np.sqrt(np.mean(np.square(missed[230:])))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("kick", "scale", "alike"),
    [(2.0, 50.0, 0.0), (2.0, 50.0, 0.2), (5.0, 50.0, 0.2), (7.0, 50.0, 0.0), (20.0, 300.0, 0.2)],
)
def test_a_kick_is_no_fault_of_the_sensors(kick, scale, alike):
    """A small one is told by the samples after it, one of four times the standard deviation that is expected at once.

    One as large as that is taken for faults for a while where sensors may also jump alike.
    """
    precision = SwitchingPrecision(process_modes=[NoisierProcess(scale=scale)], alike=alike)
    outs, _ = zip(*drive(precision, kick=kick), strict=True)
    moved = [out.process_mode_probability[1:].sum() for out in outs]
    assert max(moved[200:220]) > 0.5 > 0.1 > max(moved[:200])
    assert np.mean([out.fault_probability.max() > 0.5 for out in outs]) < (0.1 if alike else 0.02)
    assert (
        error(precision, kick=kick)
        < (0.26 if alike else 0.25)
        < 0.5
        < error(SwitchingPrecision(process_modes=()), kick=kick)
    )


def test_no_price_for_the_insurance():
    assert error(SwitchingPrecision()) < 1.005 * error(FixedPrecision())


def test_a_fault_of_a_sensor_is_no_kick():
    outs, _ = zip(*drive(SwitchingPrecision(), kick=5.0, bias=5.0), strict=True)
    during = outs[310:400]
    assert np.mean([out.fault_kind[0] == 2 and out.fault_probability[1] < 0.5 for out in during]) > 0.95
    assert np.max([out.process_mode_probability[1:].sum() for out in during]) < 0.25


@pytest.mark.slow
def test_a_plant_that_is_not_as_the_model_is_no_fault_of_the_sensors():
    """A hill that the model does not know of, or an engine of less than its force."""
    for wrong in ({"hill": 300.0}, {"share": 0.6}):
        fixed, learned, blind = (
            error(precision, **wrong, wave=5.0)
            for precision in (FixedPrecision(), SwitchingPrecision(), SwitchingPrecision(process_modes=()))
        )
        assert learned < fixed < blind


@pytest.mark.slow
def test_a_late_control_does_not_make_the_loop_swing():
    """Its model is wrong, so the belief fades; were the sensors then followed as fast as they may be, the loop would swing."""
    late = {"late": 10, "wave": 2.0}
    fixed, learned, unlimited = (
        error(precision, **late)
        for precision in (FixedPrecision(), SwitchingPrecision(), SwitchingPrecision(gain_limit=np.inf))
    )
    assert learned < 2.0 * fixed < 0.1 * unlimited


SLOW = LinearModel([[1.001]], [[1.0]], [[1.0]], 1e-12, 1.0, 0.001)
"""It falls apart slowly, and its filter takes thousands of samples to settle."""


@pytest.mark.parametrize("model", [MODEL, TWO, MODEL.with_disturbance(4.0), pytest.param(SLOW, marks=pytest.mark.slow)])
def test_how_fast_the_filter_of_a_model_follows_its_sensors(model):
    """Against filterpy's filter, once it has settled."""
    one = KalmanFilter(model.states, model.sensors)
    one.F, one.H, one.Q, one.R = (model.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    one.P = np.eye(model.states)
    for _ in range(30_000 if model is SLOW else 3000):
        one.predict()
        one.update(np.zeros((model.sensors, 1)))
    assert filter_share(model) == pytest.approx(np.trace(one.K @ one.H), rel=1e-5)


def test_sensors_errors_take_no_part_in_how_fast_the_filter_follows():
    """Each sensor that wanders follows itself, which is no sign of how fast the plant is followed."""
    wandering = TWO.with_sensor_errors(1.0, 0.05)
    assert 0.0 < filter_share(wandering) < filter_share(TWO)


@pytest.mark.parametrize("noise", [1e-30, 1e-90])
def test_sensors_of_whose_noise_rounding_leaves_nothing(noise):
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, noise, STEP)
    assert filter_share(model) == np.inf
    out = StateEstimator(model).online(compiled=False)(y=[2.0, 2.0], u=[0.0])
    assert np.isfinite(out.x_hat).all()


def test_a_constant_of_the_model_takes_no_part_in_that():
    affine = LinearModel(
        [[0.999, 0.1], [0.0, 1.0]], [[2e-4], [0.0]], [[1.0, 0.0], [1.0, 0.0]], np.diag([0.001, 0.0]), 1.0, STEP,
        disturbances=1, constant=True,
    )  # fmt: skip
    assert filter_share(affine) == pytest.approx(filter_share(MODEL))


@pytest.mark.parametrize(
    ("precision", "ports"),
    [
        (SwitchingPrecision(), [5]),
        (SwitchingPrecision(process_modes=[NoisierProcess()]), [3]),
        (SwitchingPrecision(process_modes=()), []),
        (SwitchingPrecision(joint=False), []),
    ],
)
def test_they_are_a_part_of_the_joint_form(precision, ports):
    block = BayesianController(MODEL, precision=precision)
    assert [port.size for port in block.outputs if port.name == "process_mode_probability"] == ports


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: NoisierProcess(scale=1.0), "NoisierProcess has scale"),
        (lambda: NoisierProcess(scale=0.0), "NoisierProcess has scale"),
        (lambda: NoisierProcess(scale=1e200), "NoisierProcess has scale"),
        (lambda: NoisierProcess(time_to_recovery=-1.0), "NoisierProcess has time_to_recovery"),
        (
            lambda: SwitchingPrecision(joint=False, process_modes=[NoisierProcess()]).learner(MODEL),
            "process_modes, which need the joint form",
        ),
        (
            lambda: SwitchingPrecision(process_modes=[NoisierProcess(1e-3), NoisierProcess(1e-3)]).learner(MODEL),
            "actuator faults and the process modes begin",
        ),
        (
            lambda: SwitchingPrecision(process_modes=[NoisierProcess()]).apart("X"),
            "^X learns .* leave the process modes out",
        ),
        (lambda: SwitchingPrecision(process_modes=3), "give a list of process modes"),
        (lambda: SwitchingPrecision(process_modes=[NoisierProcess]), r"give an instance: NoisierProcess\(\)"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()
