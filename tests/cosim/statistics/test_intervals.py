"""Confidence intervals of means and ratios: they cover as often as they say, and agree with scipy."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.statistics import bootstrap_interval, interval, ratio, rms_ratio, roc_curve


def test_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(2)
    hits = [low < 1.0 < high for low, high in (interval(rng.normal(1.0, 2.0, 8)) for _ in range(4_000))]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.012)


def test_the_interval_of_a_ratio_covers_it():
    """Of paired errors with much in common, by Monte Carlo; and it is exact where one is a multiple of the other."""
    random = np.random.default_rng(0)
    common = random.normal(10.0, 2.0, size=(2000, 40))
    ours, theirs = 1.5 * common + random.normal(0, 0.3, common.shape), common + random.normal(0, 0.3, common.shape)
    bounds = np.array([ratio(a, b)[1] for a, b in zip(ours, theirs, strict=True)])
    covered = ((bounds[:, 0] < 1.5) & (bounds[:, 1] > 1.5)).mean()
    assert covered == pytest.approx(0.95, abs=0.02)
    value, (low, high) = ratio(3.0 * common[0], common[0])
    assert value == pytest.approx(low) == pytest.approx(high) == pytest.approx(3.0)


def test_lists_and_tables_columns_are_numbers_as_arrays_are():
    ours, theirs = [1, 2, 4, 3], [2.0, 3.0, 5.0, 5.0]
    for given in (list, pd.Series, tuple):
        assert interval(given(ours)) == interval(np.array(ours, float))
        assert ratio(given(ours), given(theirs)) == ratio(np.array(ours), np.array(theirs))
        assert rms_ratio(given(ours), given(theirs), resamples=9) == rms_ratio(
            np.array(ours), np.array(theirs), resamples=9
        )
        assert bootstrap_interval(given(ours)) == bootstrap_interval(np.array(ours))
        assert (
            roc_curve(given([0, 1, 0, 1]), given(ours)) == roc_curve(np.array([0, 1, 0, 1]) > 0, np.array(ours))
        ).all()


def test_interval_is_scipys():
    values = np.random.default_rng(3).exponential(size=23)
    for level in (0.8, 0.95, 0.999):
        wanted = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(level)
        assert interval(values, level) == pytest.approx(list(wanted), rel=1e-12)


def test_ratio_of_root_mean_squares():
    rng = np.random.default_rng(4)
    theirs = rng.uniform(1.0, 2.0, 200)
    ours = 0.5 * theirs * rng.uniform(0.9, 1.1, 200)
    found = rms_ratio(ours, np.append(theirs, 1e9))
    assert found["n"] == 200
    assert found["ratio"] == pytest.approx(np.sqrt((ours**2).sum() / (theirs**2).sum()))
    assert found["ratio_ci"][0] < found["ratio"] < found["ratio_ci"][1]


def test_bootstrap_of_a_ratio_is_scipys():
    """Of errors of which a few are large the interval is not symmetric: scipy's percentiles of paired draws, up to chance."""
    rng = np.random.default_rng(6)
    theirs = rng.uniform(1.0, 2.0, 60)
    ours = theirs * np.where(np.arange(60) < 3, 30.0, rng.uniform(0.9, 1.1, 60))
    found = rms_ratio(ours, theirs, resamples=20_000, seed=1)
    plain = rms_ratio(ours, theirs)
    wanted = scipy.stats.bootstrap(
        (ours**2, theirs**2),
        lambda a, b, axis: np.sqrt(a.mean(axis) / b.mean(axis)),
        paired=True,
        method="percentile",
        n_resamples=20_000,
        random_state=np.random.default_rng(2),
    )
    assert found["ratio_ci"] == pytest.approx(list(wanted.confidence_interval), rel=0.03)
    assert {k: v for k, v in found.items() if k != "ratio_ci"} == {k: v for k, v in plain.items() if k != "ratio_ci"}
    assert found["ratio_ci"] == rms_ratio(ours, theirs, resamples=20_000, seed=1)["ratio_ci"]
    assert plain["ratio_ci"][0] < found["ratio_ci"][0]


@pytest.mark.parametrize("method", ["BCa", "percentile", "basic"])
def test_bootstrap_is_scipys_and_the_same_for_a_seed(method):
    values = np.random.default_rng(5).exponential(size=40)
    options = {"n_resamples": 2000, "method": method, "confidence_level": 0.9}
    wanted = scipy.stats.bootstrap((values,), np.mean, random_state=np.random.default_rng(7), **options)
    mine = bootstrap_interval(values, 0.9, method=method, resamples=2000, seed=7)
    assert mine == pytest.approx(list(wanted.confidence_interval), rel=1e-12)
    assert mine == bootstrap_interval(values, 0.9, method=method, resamples=2000, seed=7)
    assert mine != bootstrap_interval(values, 0.9, method=method, resamples=2000, seed=8)


def test_bootstrap_in_pieces_is_the_bootstrap(monkeypatch):
    from bayesftc.cosim.statistics import _intervals

    values = np.random.default_rng(5).exponential(size=40)
    whole = bootstrap_interval(values, method="percentile", resamples=500)
    monkeypatch.setattr(_intervals, "LARGEST", 1000)
    assert bootstrap_interval(values, method="percentile", resamples=500) == pytest.approx(whole, rel=0.1)


@pytest.mark.filterwarnings("error")
def test_bootstrap_of_equal_values_is_that_value():
    assert bootstrap_interval(np.full(9, 2.5)) == [2.5, 2.5]


def test_bootstrap_without_such_a_method():
    with pytest.raises(ModelError, match="no method 'bca'; use one of 'BCa'"):
        bootstrap_interval(np.arange(3.0), method="bca")
