"""All sensors of a quantity jump alike: the plant was kicked, or they all failed; only how it goes on can tell."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc.controllers import LinearModel, SwitchingPrecision
from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.estimation.filter import Belief
from bayesftc.controllers.switching.bank.hypothesis import STATE
from bayesftc.controllers.switching.bank.samples import make_conclude
from bayesftc.cosim.errors import ModelError
from bayesftc.reproduce.experiments.family.loop import family_loop
from bayesftc.reproduce.experiments.family.run import chosen_cases


def jumped(sensors, jump, precision, samples=100, seed=0, others=0):
    """Return the last output of an estimator of a random walk, of which some sensors jump alike 10 samples before the end."""
    n = 2 if others else 1
    C = np.zeros((sensors + others, n))
    C[:sensors, 0], C[sensors:, -1] = 1.0, 1.0
    model = LinearModel(np.eye(n), np.zeros((n, 1)), C, 0.001 * np.eye(n), np.eye(sensors + others), 0.02)
    step = StateEstimator(model, precision, initial_covariance=1.0).online()
    rng = np.random.default_rng(seed)
    for k in range(samples):
        y = rng.normal(size=sensors + others)
        y[:sensors] += jump * (k >= samples - 10)
        out = step(y=list(y), u=[0.0])
    return out


@pytest.mark.sampled(1)
@pytest.mark.parametrize("sensors", [2, *(pytest.param(m, marks=pytest.mark.slow) for m in (3, 5))])
@pytest.mark.parametrize("jump", [4.0, 6.0, -5.0])
def test_nobody_can_tell_a_kick_of_a_random_walk_from_sensors_that_jump_alike(sensors, jump):
    """Whatever the jump and the number of sensors, what is told beforehand is what remains."""
    for alike in (0.2, 0.45):
        outs = [jumped(sensors, jump, SwitchingPrecision(alike=alike), seed=seed) for seed in range(5)]
        told = np.mean([out.fault_probability for out in outs], axis=0)
        np.testing.assert_allclose(told, alike, atol=0.06)
        assert np.abs(np.median([out.x_hat[0] for out in outs]) - jump) < 0.6, "the estimate follows the sensors"


@pytest.mark.slow
def test_it_can_be_left_out():
    out = jumped(2, 5.0, SwitchingPrecision(alike=0.0))
    assert out.fault_probability.max() < 0.05
    single = jumped(1, 5.0, SwitchingPrecision(), others=1)  # no two read the same
    np.testing.assert_array_equal(single.x_hat, jumped(1, 5.0, SwitchingPrecision(alike=0.0), others=1).x_hat)


@pytest.mark.slow
def test_of_two_quantities_it_is_the_plant_that_jumped():
    """A kick would have moved the other one, too: how probable that is nobody says, so there is no such hypothesis."""
    out = jumped(2, 5.0, SwitchingPrecision(alike=0.45), others=2)
    assert out.fault_probability.max() < 0.05
    assert abs(out.x_hat[0] - 5.0) < 0.8


def test_a_plant_that_does_not_follow_tells_in_time():
    """The force that holds a car at its speed does not fit the speed that both sensors show; in the mean of ten runs."""
    (case,) = chosen_cases("both sensors: injections of +5 sd")
    loop = family_loop(case, SwitchingPrecision(alike=0.45))
    results = [loop.simulate(14.5, seed=seed) for seed in range(10)]
    at = np.searchsorted(results[0].time, [5.9, 6.3, 13.9, 14.4])
    before, first, last, after = np.mean([result["controller.fault_probability"][at] for result in results], axis=0)
    assert before.max() < 0.1
    assert np.all((first > 0.3) & (first < 0.6)), "nobody can tell yet"
    assert last.min() > 0.75, "both have failed"
    assert after.max() < 0.1, "both are well again"


@pytest.mark.parametrize("alike", [-0.1, 1.0, float("nan"), "half"])
def test_what_cannot_be_a_probability(alike):
    with pytest.raises(ModelError, match="alike"):
        SwitchingPrecision(alike=alike)


@pytest.mark.parametrize("likely", [(0.45, 0.0), (0.5, 0.0), (0.495, 0.495), (0.6, 0.2), (1.0, 0.0)])
def test_an_estimate_is_made_of_whatever_is_left(likely):
    """Also where all sensors of either of two quantities may have jumped alike, and hardly anything else is probable."""
    model = LinearModel(
        np.eye(2), np.zeros((2, 1)), np.repeat(np.eye(2), 2, axis=0), 0.001 * np.eye(2), np.eye(4), 0.02
    )
    layout = SwitchingPrecision()._layout(model, 20, 20, SwitchingPrecision().process_modes)
    layout = replace(layout, groups=((0, 1), (2, 3)), common=1)
    memory, rest = np.zeros(layout.scratch + 100), max(1.0 - sum(likely), 1e-100)
    for h in range(layout.hypotheses):
        at = layout.first + h * layout.length
        memory[at] = 0.0
        memory[at + STATE + 4 : at + STATE + 20] = np.eye(4).ravel()
    for h, p, x in ((0, rest, 1.0), (layout.first_common, likely[0], -3.0), (layout.first_common + 1, likely[1], 5.0)):
        memory[layout.first + h * layout.length] = p
        memory[layout.first + h * layout.length + STATE] = x
    x_hat, P, settings = np.zeros(2), np.zeros((2, 2)), np.ones(layout.gain_share + 1)
    make_conclude(layout)(Belief(np.zeros(2), np.eye(2), x_hat, P), memory, settings)
    if max(likely) <= 0.5 < 2 * rest:
        assert x_hat[0] == pytest.approx(1.0), "the plant was kicked"
    if max(likely) > 0.9:
        assert x_hat[0] == pytest.approx(-3.0), "the sensors have failed"
    assert -3.0 <= x_hat[0] <= 5.0
    assert x_hat[1] == 0.0
    each = np.array([1.0, -3.0, 5.0])
    assert P[0, 0] == pytest.approx(1.0 + [rest, *likely] @ (each - x_hat[0]) ** 2), "the mean squared distance"
