"""Outages of all sensors at once, as of a logger: what is known of the sensors before them is known after them."""

from itertools import pairwise

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers import DroppedOut, Frozen, LinearModel, Offset, SwitchingPrecision

A, Q, STEP = 0.999, 0.01, 0.1
NAMES = ("x_hat", "P", "mode_probability", "fault_size", "fault_onset", "log_density")


def estimated(model, precision, rows, initial, variance, compiled=False):
    """Return the outputs of an estimator over rows of samples."""
    estimator = controllers.StateEstimator(model, precision, initial_mean=initial, initial_covariance=variance)
    step = estimator.online(compiled=compiled)
    return [step(y=list(row)) for row in rows]


def rows_with_an_outage(outage=200):
    """Return samples of three sensors; the first has an offset from step 20 on, the third falls silent alone in the end."""
    rng, x, rows = np.random.default_rng(4), 20.0, []
    for _ in range(120 + outage):
        rows.append(x + rng.normal(size=3))
        x = A * x + np.sqrt(Q) * rng.normal()
    rows = np.array(rows)
    rows[20:, 0] += 9.0
    rows[60 : 60 + outage] = np.nan
    rows[-30:, 2] = np.nan
    return rows


def test_in_the_joint_form_only_the_state_is_predicted_in_an_outage():
    """Probabilities stay as they are, and the belief is Kalman's prediction."""
    model = LinearModel([[A]], [[0.0]], [[1.0]] * 3, Q, 1.0, STEP)
    precision = SwitchingPrecision((Offset(), DroppedOut()), process_modes=(), outages=True)
    rows = rows_with_an_outage()
    outs = estimated(model, precision, rows, [20.0], 1.0)
    for before, now in pairwise(outs[59:260]):
        np.testing.assert_allclose(now.mode_probability, before.mode_probability, rtol=1e-9, atol=1e-12)
        assert now.log_density == 0.0
        assert now.x_hat[0] == pytest.approx(A * before.x_hat[0], rel=1e-5)
        assert now.P[0, 0] == pytest.approx(A * A * before.P[0, 0] + Q, rel=1e-4)
    after = np.array([out.mode_probability for out in outs[260:290]])
    assert (after[:, 0, 1] > 0.99).all()
    assert (after[:, 1:, 1] < 0.5).all()
    assert outs[262].fault_size[0] == pytest.approx(9.0, abs=1.0)
    assert outs[-1].mode_probability[2, 2] > 0.99  # the one that is silent alone has dropped out
    for one, other in zip(outs, estimated(model, precision, rows, [20.0], 1.0, compiled=True), strict=True):
        for name in NAMES:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize("frozen", [True, False])
def test_the_onset_of_a_fault_remains_over_an_outage(joint, frozen):
    """In the joint form it moved on by the length of the outage, past the begin of the alarm."""
    model = LinearModel([[A]], [[0.0]], [[1.0]] * 3, Q, 1.0, STEP)
    rows = rows_with_an_outage()[:-30]
    if frozen:
        rows[20:60, 0] = rows[260:, 0] = rows[19, 0]
    precision = SwitchingPrecision((Frozen(), Offset(), DroppedOut()), joint=joint, process_modes=(), outages=True)
    outs = estimated(model, precision, rows, [20.0], 1.0)
    onsets = [out.fault_onset[0] for out in outs[40:]]
    np.testing.assert_allclose(onsets, 20 * STEP, atol=5 * STEP)  # of an outage of 200 steps


def test_without_outages_an_offset_has_to_be_found_anew():
    model = LinearModel([[A]], [[0.0]], [[1.0]] * 3, Q, 1.0, STEP)
    precision = SwitchingPrecision((Offset(), DroppedOut()), process_modes=())
    outs = estimated(model, precision, rows_with_an_outage(), [20.0], 1.0)
    assert outs[258].mode_probability[0, 1] < 0.5


@pytest.mark.sampled(1)
@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_a_turn_that_ends_in_an_outage_acquits_no_sensor_and_blames_none(joint, seed):
    """The rate before the outage is wrong after it: all sensors contradict the wide belief, and the faulty one least.

    Judged one by one, the two healthy sensors were then blamed to the end.
    """
    rng, step = np.random.default_rng(100 + seed), 1.0
    model = LinearModel(
        [[1.0, step], [0.0, 1.0]], [[0.0], [0.0]], [[1.0, 0.0]] * 3, 0.03 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]),
        np.square([0.3, 0.3, 0.5]), step,
    )  # fmt: skip
    rate = np.where((np.arange(260) >= 112) & (np.arange(260) < 158), 1.4, 0.0)
    rows = np.cumsum(rate)[:, None] + rng.normal(size=(260, 3)) * [0.3, 0.3, 0.5]
    rows[40:, 0] += 3.0
    rows[110:170] = np.nan
    precision = SwitchingPrecision(
        (Offset(3600.0, 3600.0, jump=30.0), DroppedOut(3600.0, 3600.0)), joint=joint, process_modes=(), outages=True
    )
    outs = estimated(model, precision, rows, [0.0, 0.0], np.diag([1.0, 0.01]))
    probability = np.array([out.fault_probability for out in outs])
    assert (probability[60:105, 0] > 0.9).all()
    assert (probability[171:, 0] > 0.9).all()
    assert (probability[60:105, 1:] < 0.5).all()
    assert (probability[175:, 1:] < 0.5).all()
