"""Random numbers depend on seed, stream, channel, draw and step, and on nothing else."""

import math
from types import FunctionType

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from scipy.special import ndtri

from bayesftc.cosim import Diagram, Gaussian, drawing
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import CHUNK, SPARE, check_seed, draw_chunk, numbers, stream_key

WORDS = st.integers(0, 2**64 - 1)

# Known values: if these change, no stored run can be repeated.
SENSORS_NOISE = 0xD165A29C59534AC8
SENSORS_NOISE_SEED_1 = [0.23143269984475956, 2.064262614063333, 0.453713187119155]


def ours(counter, key):
    with np.errstate(over="ignore"):
        return [int(word) for word in drawing._philox(*(np.uint64(c) for c in (*counter, *key)))]


def numpys(counter, key):
    """One block of numpy's Philox, which adds one to its counter before it draws."""
    number = (sum(c << (64 * i) for i, c in enumerate(counter)) - 1) % 2**256
    before = np.array([(number >> (64 * i)) % 2**64 for i in range(4)], dtype=np.uint64)
    generator = np.random.Philox(counter=before, key=np.array(key, dtype=np.uint64))
    return generator.random_raw(4).tolist()


@given(st.tuples(WORDS, WORDS, WORDS, WORDS), st.tuples(WORDS, WORDS))
def test_words_are_those_of_numpys_philox(counter, key):
    assert ours(counter, key) == numpys(counter, key)


@given(WORDS, WORDS)
def test_product_of_two_words(a, b):
    with np.errstate(over="ignore"):
        high, low = drawing._multiply(np.uint64(a), np.uint64(b))
    assert (int(high) << 64) + int(low) == a * b


@settings(max_examples=30, deadline=None)
@given(WORDS, st.text(min_size=1, max_size=20), st.integers(0, 50), st.integers(0, 3), st.integers(0, 2**30))
def test_numbers_are_laid_out_as_documented(seed, name, channel, draw, chunk):
    streams = np.array([[stream_key(name), channel, draw, 1]], dtype=np.uint64)
    buffer = np.empty((8, 1))
    draw_chunk(seed, streams, 8 * chunk, buffer)
    words = [
        w for block in (2 * chunk, 2 * chunk + 1) for w in numpys((block, channel, draw, 0), (seed, stream_key(name)))
    ]
    assert_allclose(buffer[:, 0], [w / 2**64 for w in words], rtol=0, atol=2.0**-52)


def test_stream_keys_are_stable():
    assert stream_key("sensors.noise") == SENSORS_NOISE
    assert stream_key("sensors.noise") != stream_key("sensor.noise")
    assert_allclose(numbers(1, "sensors.noise", 3), SENSORS_NOISE_SEED_1, rtol=1e-13)


def normal(p):
    """The normal numbers of uniform ones."""
    row = np.array(p)
    drawing._to_normal(row, np.empty(len(row)), np.empty(len(row), dtype=int))
    return row


def test_uniform_is_strictly_inside():
    ends = np.array([drawing._of_uniform(np.uint64(w)) for w in (0, 2**64 - 1)]).view(float)
    drawing._to_uniform(ends)
    assert 0 < ends[0] < ends[1] < 1
    assert np.isfinite(normal(ends)).all()


TAILS = np.concatenate([
    10.0 ** np.linspace(-300, -1, 600), np.linspace(0.001, 0.999, 2001), 1 - 10.0 ** np.linspace(-15, -1, 300),
    [2.0**-54, 1 - 2.0**-53, 0.5, 0.075, 0.925, math.exp(-25), 0.5 - 1e-12],
])  # fmt: skip


def test_normal_against_scipy_to_the_tails():
    from scipy.special import ndtr

    z = normal(TAILS)
    assert (normal(TAILS[TAILS > 1e-10]) == z[TAILS > 1e-10]).all()  # far tails among them change nothing
    away = np.abs(TAILS - 0.5) > 1e-3
    assert_allclose(z[away], ndtri(TAILS[away]), rtol=1e-14, atol=0)
    assert_allclose(z[~away], ndtri(TAILS[~away]), rtol=1e-13, atol=1e-17)  # ndtri itself cancels there
    assert_allclose(ndtr(z[TAILS < 0.5]), TAILS[TAILS < 0.5], rtol=1e-11)


def test_normal_is_the_inverse_of_the_uniform_of_the_same_stream():
    assert_allclose(numbers(3, "a.b", 4000), ndtri(numbers(3, "a.b", 4000, uniform=True)), rtol=1e-13, atol=1e-16)


def test_distributions():
    count = 200_000
    uniform, normal = numbers(5, "x.u", count, uniform=True), numbers(5, "x.n", count)
    assert 0 < uniform.min() < uniform.max() < 1
    assert stats.kstest(uniform, "uniform").pvalue > 1e-4
    assert stats.kstest(normal, "norm").pvalue > 1e-4
    for z in (normal, (uniform - 0.5) * math.sqrt(12)):
        assert abs(z.mean()) < 4 / math.sqrt(count)
        assert abs(z.var() - 1) < 4 * math.sqrt(2 / count)
        assert abs((z[1:] * z[:-1]).mean()) < 4 / math.sqrt(count)


def test_streams_are_independent():
    count = 40_000
    streams = [
        numbers(seed, name, count, channel=channel, draw=draw)
        for seed in (0, 1)
        for name in ("sensors.noise", "plant.noise")
        for channel in (0, 1)
        for draw in (0, 1)
    ]
    correlation = np.corrcoef(streams)[np.triu_indices(len(streams), 1)]
    assert np.abs(correlation).max() < 4.5 / math.sqrt(count)  # the largest of 120: 4.5 sigma is once in a thousand


@given(st.integers(0, 300), st.integers(1, 300))
@settings(max_examples=20, deadline=None)
def test_more_steps_do_not_change_the_first(few, more):
    assert_array_equal(numbers(9, "s.n", few + more)[:few], numbers(9, "s.n", few))


def test_chunks_join():
    streams = np.array([[stream_key("s.n"), 0, 0, 0], [stream_key("s.n"), 1, 0, 1]], dtype=np.uint64)
    whole = np.empty((3 * CHUNK, 2))
    draw_chunk(2**64 - 1, streams, 0, whole)
    for first in (0, CHUNK, 2 * CHUNK, 4):
        part = np.empty((CHUNK, 2))
        draw_chunk(2**64 - 1, streams, first, part)
        assert_array_equal(part, whole[first : first + CHUNK])


def test_chunks_of_plain_python_are_the_same():
    assert isinstance(drawing.fill, FunctionType)
    streams = np.array([[stream_key("s.n"), 3, 1, 0], [stream_key("s.n"), 0, 0, 1]], dtype=np.uint64)
    compiled, plain = np.empty((CHUNK, 2)), np.empty((2 + SPARE, CHUNK))
    draw_chunk(11, streams, CHUNK, compiled)
    with np.errstate(over="ignore"):
        drawing.fill(np.uint64(11), streams, CHUNK, plain)
    assert_array_equal(plain[:2].T, compiled)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_a_run_sees_the_numbers_of_its_streams(engine):
    diagram = Diagram(dt=1)
    diagram.add(Gaussian((1.0, 1.0)), name="one")
    diagram.add(Gaussian(1.0), name="slow", every=3)
    result = diagram.simulate(3 * CHUNK, seed=4, engine=engine)
    for channel in (0, 1):
        assert_array_equal(result["one.y"][:, channel], numbers(4, "one.noise", 3 * CHUNK + 1, channel=channel))
    assert_array_equal(result["slow.y"][::3], numbers(4, "slow.noise", 3 * CHUNK + 1)[::3])


@pytest.mark.parametrize("seed", [-1, 2**64, 1.0, True, "1", None, np.float64(3)])
def test_bad_seeds(seed):
    with pytest.raises(ModelError, match="whole number from 0 to"):
        check_seed(seed)


@pytest.mark.parametrize("seed", [0, 2**64 - 1, np.int32(7), np.uint64(2**63)])
def test_good_seeds(seed):
    assert check_seed(seed) == int(seed)
    assert type(check_seed(seed)) is int
