"""Blocks that remember, against sums, SciPy's filters and states written out."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError

DT = 0.1
U = np.random.default_rng(1).normal(size=40)


def through(block, compiled, **inputs):
    step = block.online(dt=DT, compiled=compiled)
    rows = zip(*inputs.values(), strict=True)
    return np.array([float(step(**dict(zip(inputs, row, strict=True))).y) for row in rows])


both = pytest.mark.parametrize("compiled", [False, True])


@both
def test_an_integrator_is_a_sum_of_what_came_before_with_limits_and_a_reset(compiled):
    np.testing.assert_allclose(
        through(cosim.Integrator(initial=2.0), compiled, u=U), 2.0 + DT * np.append(0.0, np.cumsum(U)[:-1]), rtol=1e-12
    )
    held = through(cosim.Integrator(low=-0.1, high=0.2), compiled, u=np.repeat([1.0, -1.0], 20))
    assert (held.min(), held.max()) == (pytest.approx(-0.1), 0.2)
    assert held[21] == pytest.approx(0.1)  # no windup
    again = through(cosim.Integrator(1.0, reset=True), compiled, u=np.ones(5), reset=[0.0, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(again, [1.0, 1.1, 1.2, 1.0, 1.1])
    assert through(cosim.Integrator(), compiled, u=[1.0, np.nan, 1.0, 0.0]).tolist() == [0.0, 0.1, 0.1, 0.2]


@both
def test_an_exponential_filter_is_scipys_from_the_first_sample(compiled):
    gain = 1.0 - np.exp(-DT / 0.3)
    expected = lfilter([gain], [1.0, gain - 1.0], U, zi=[(1.0 - gain) * U[0]])[0]
    np.testing.assert_allclose(through(cosim.ExponentialFilter(0.3), compiled, u=U), expected, rtol=1e-12)
    kept = through(cosim.ExponentialFilter(0.3), compiled, u=[np.nan, 4.0, np.nan, 4.0])
    assert kept.tolist() == [0.0, 4.0, 4.0, 4.0]


@both
def test_a_moving_average_is_of_the_samples_that_are_there(compiled):
    u = np.where(np.arange(40) % 7 == 3, np.nan, U)
    expected = [np.nanmean(u[max(0, k - 2) : k + 1]) for k in range(40)]
    np.testing.assert_allclose(through(cosim.MovingAverage(3), compiled, u=u), expected, rtol=1e-12)
    assert np.isnan(through(cosim.MovingAverage(1), compiled, u=u)[3])


@both
def test_a_rate_limiter_follows_as_fast_as_it_may(compiled):
    before, expected = 0.0, []
    for value in U:
        before = min(max(value, before - 0.05), before + 0.2)
        expected.append(before)
    limited = through(cosim.RateLimiter(2.0, 0.5), compiled, u=U)
    np.testing.assert_allclose(limited, expected, rtol=1e-12)
    assert np.isnan(through(cosim.RateLimiter(2.0), compiled, u=[np.nan, 9.0])).tolist() == [True, False]


@both
def test_a_relay_switches_at_two_places(compiled):
    u = [0.0, 0.9, 1.0, 0.5, np.nan, 0.2, 0.5, 2.0]
    out = through(cosim.Hysteresis(1.0, 0.2, high=5.0, low=-5.0), compiled, u=u)
    assert out.tolist() == [-5.0, -5.0, 5.0, 5.0, 5.0, -5.0, -5.0, 5.0]


@both
def test_sample_and_hold_and_counter(compiled):
    held = through(cosim.SampleAndHold(9.0), compiled, u=[1.0, 2.0, 3.0, 4.0], trigger=[0.0, 1.0, np.nan, 1.0])
    assert held.tolist() == [9.0, 2.0, 2.0, 4.0]
    ticks = [0.0, 1.0, 1.0, 0.0, 1.0, np.nan, 1.0, 0.0, 1.0]
    assert through(cosim.Counter(), compiled, u=ticks).tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 3]
    assert through(cosim.Counter(limit=2), compiled, u=ticks).tolist() == [0, 1, 1, 1, 0, 0, 0, 0, 1]


@both
def test_a_delay_that_varies_is_linear_between_samples(compiled):
    time = DT * np.arange(40)
    delay = np.abs(np.sin(time)) + 0.05
    ramp = through(cosim.VariableDelay(1.2, initial=0.0), compiled, u=time, delay=delay)
    np.testing.assert_allclose(ramp, np.maximum(time - delay, 0.0), atol=1e-12)
    for steps in range(4):  # a whole number of steps is exact, even if a sample beside it is missing
        u = np.where(np.arange(40) == 20, np.nan, U)
        late = through(cosim.VariableDelay(0.3), compiled, u=u, delay=np.full(40, steps * DT))
        np.testing.assert_array_equal(late, np.append(np.zeros(steps), u[: 40 - steps]))
    capped = through(cosim.VariableDelay(0.3), compiled, u=U, delay=np.full(40, 99.0))
    np.testing.assert_array_equal(capped[3:], U[:-3])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: cosim.Integrator(initial=2.0, high=1.0), "must rise in this order"),
        (lambda: cosim.ExponentialFilter(0.0), "time_constant=0.0; it must be a finite number above 0"),
        (lambda: cosim.MovingAverage(0), "samples=0"),
        (lambda: cosim.RateLimiter(1.0, -1.0), "falling=-1.0"),
        (lambda: cosim.Hysteresis(0.0, 1.0), "on must lie above off"),
        (lambda: cosim.Counter(0.5), "limit=0.5"),
        (lambda: cosim.VariableDelay(1e4).define(1), r"10000 steps of 1 s; the most are 9,999"),
    ],
)
def test_wrong_settings_are_refused_with_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()
