"""Pulses, binary sequences, chirps: against SciPy and NumPy."""

import numpy as np
import pytest
from scipy.signal import chirp

from bayesftc import cosim
from bayesftc.cosim.blocks.excitation import TAPS
from bayesftc.cosim.errors import ModelError

both = pytest.mark.parametrize("engine", ["compiled", "interpreted"])


def signal(source, duration, dt=0.1, engine="compiled"):
    diagram = cosim.Diagram(dt=dt)
    diagram.add(source, "source")
    result = diagram.simulate(duration, engine=engine)
    return result.time, result["source.y"]


@both
def test_pulses_begin_and_end_at_the_samples_of_their_edges(engine):
    time, y = signal(cosim.Pulse(3.0, period=0.3, width=1 / 3, offset=1.0, start=0.2), 30.0, engine=engine)
    k = np.arange(len(time)) - 2
    np.testing.assert_array_equal(y, np.where((k >= 0) & (k % 3 == 0), 4.0, 1.0))


@pytest.mark.parametrize("order", [n for n in TAPS if n <= 11])
def test_a_sequence_has_the_longest_period_and_is_as_white_as_can_be(order):
    period = 2**order - 1
    _, y = signal(cosim.PRBS(1.0, interval=0.1, order=order), 0.1 * (2 * period - 1))
    np.testing.assert_array_equal(y[:period], y[period:])
    assert abs(y[:period].sum()) == 1.0
    spectrum = np.fft.ifft(np.abs(np.fft.fft(y[:period])) ** 2).real  # the circular autocorrelation
    np.testing.assert_allclose(spectrum[1:], -1.0, atol=1e-6)  # so only with the longest period


@both
def test_a_bit_lasts_for_its_interval(engine):
    _, fast = signal(cosim.PRBS(2.0, interval=0.1, offset=5.0), 5.0, engine=engine)
    _, slow = signal(cosim.PRBS(2.0, interval=0.3, offset=5.0), 15.0, engine=engine)
    np.testing.assert_array_equal(slow[::3], fast)
    np.testing.assert_array_equal(slow[1::3], slow[2::3][: len(slow[1::3])])
    assert set(fast) == {3.0, 7.0}


@both
@pytest.mark.parametrize(("sweep", "method"), [("linear", "linear"), ("exponential", "logarithmic")])
def test_a_chirp_is_scipys(sweep, method, engine):
    time, y = signal(cosim.Chirp(2.0, 0.5, 3.0, 4.0, sweep=sweep), 4.0, dt=0.01, engine=engine)
    np.testing.assert_allclose(y, 2.0 * chirp(time, 0.5, 4.0, 3.0, method=method, phi=-90), atol=1e-9)
    time, y = signal(cosim.Chirp(1.0, 1.0, 2.0, 1.0, sweep=sweep), 3.0, dt=0.01)
    np.testing.assert_allclose(y[150:250], y[200:300], atol=1e-9)  # 2 Hz from then on


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: cosim.Pulse(1.0, 1.0, width=1.0), "the width between 0 and 1"),
        (lambda: cosim.PRBS(1.0, 0.0), "interval=0.0; it must be positive"),
        (lambda: cosim.PRBS(1.0, 1.0, order=8), "order=8; it must be one of 3, 4"),
        (lambda: cosim.Chirp(1.0, 0.0, 1.0, 1.0), "begin=0.0; it must be positive"),
        (lambda: cosim.Chirp(1.0, 1.0, 2.0, 1.0, sweep="log"), "'linear' or 'exponential'"),
    ],
)
def test_wrong_settings_are_refused_with_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()
