"""Reliability over runs: the figures of all samples, with intervals that know that samples of a run are alike."""

import numpy as np
import pytest
from scipy.stats import binomtest
from sklearn.metrics import brier_score_loss

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.probabilities import reliability
from bayesftc.cosim.statistics import calibration, interval, mean_reliability


def streams(rng, runs, steps=50):
    """Return probabilities and truths that last: each run has few faults, its probability says how probable they were."""
    p = np.repeat(rng.beta(0.5, 1.0, size=(runs, steps // 25)), 25, axis=1)
    faulty = np.repeat(rng.random((runs, steps // 25)), 25, axis=1) < p**1.5
    return np.clip(p + 0.02 * rng.random(p.shape), 0.0, 1.0), faulty


@pytest.mark.parametrize("equal", ["counts", "widths"])
def test_figures_are_those_of_all_samples(equal):
    p, faulty = streams(np.random.default_rng(0), 30)
    p[3, 20:], p[4] = np.nan, np.nan
    found, wanted = calibration(p, faulty, equal=equal), reliability(p, faulty, equal=equal)
    assert found.pooled.to_dict() == wanted.to_dict()
    known = ~np.isnan(p)
    assert found.pooled.brier == pytest.approx(brier_score_loss(faulty[known], p[known]))
    assert (found.runs, found.left_out) == (29, 1)
    low, high = found.observed_low, found.observed_high
    some = ~np.isnan(low)
    assert ((low < high) & (low <= wanted.observed) & (wanted.observed <= high))[some].all()
    assert some.sum() >= 9
    assert found.brier_interval[0] < wanted.brier < found.brier_interval[1]
    assert found.calibration_error_interval[0] < wanted.calibration_error < found.calibration_error_interval[1]
    assert set(wanted.to_dict()) < set(found.to_dict())


def test_intervals_are_those_of_the_bootstrap_over_runs():
    rng = np.random.default_rng(1)
    p, faulty = streams(rng, 200)
    found = calibration(p, faulty, equal="widths", bins=5)
    drawn = [reliability(p[some], faulty[some], equal="widths", bins=5) for some in rng.integers(0, 200, (500, 200))]
    briers = np.quantile([r.brier for r in drawn], [0.025, 0.975])
    assert found.brier_interval == pytest.approx(tuple(briers), abs=0.15 * np.ptp(briers))
    observed = np.nanquantile([r.observed for r in drawn], [0.025, 0.975], axis=0)
    tolerance = 0.2 * (observed[1] - observed[0]).max()
    assert found.observed_low == pytest.approx(observed[0], abs=tolerance)
    assert found.observed_high == pytest.approx(observed[1], abs=tolerance)
    spread = np.std([r.calibration_error for r in drawn])
    half = np.ptp(found.calibration_error_interval) / 2
    assert half == pytest.approx(1.97 * spread, rel=0.3)


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say():
    rng = np.random.default_rng(2)
    truth = calibration(*streams(rng, 20_000), equal="widths", bins=4)
    hits = np.zeros(3)
    for _ in range(300):
        found = calibration(*streams(rng, 80), equal="widths", bins=4)
        hits += [
            found.brier_interval[0] < truth.pooled.brier < found.brier_interval[1],
            found.observed_low[2] < truth.pooled.observed[2] < found.observed_high[2],
            found.calibration_error_interval[0] < truth.pooled.calibration_error < found.calibration_error_interval[1],
        ]
    assert hits[:2] / 300 == pytest.approx([0.95, 0.95], abs=0.04)
    assert hits[2] / 300 > 0.88  # the error itself, of few runs, is too large


def test_a_bin_without_a_fault_is_not_certain():
    """As if each of the 20 runs with a sample in it were one draw: scipy's exact interval of a share."""
    p = np.tile([0.1, 0.1, 0.9, 0.9, 0.9], (20, 1))
    found = calibration(p, p > 0.5, bins=2, equal="widths")
    none, every = (binomtest(k, 20).proportion_ci() for k in (0, 20))
    assert (found.observed_low[0], found.observed_high[0]) == pytest.approx((none.low, none.high))
    assert (found.observed_low[1], found.observed_high[1]) == pytest.approx((every.low, every.high))


@pytest.mark.filterwarnings("error")
def test_empty_bins_and_single_runs_have_no_interval():
    p = np.array([[0.1, 0.1, 0.9], [0.12, 0.15, 0.1]])
    found = calibration(p, p > 0.5, bins=2, equal="widths")
    assert np.isnan(found.observed_low).tolist() == [False, True]
    one = calibration(p[:1], p[:1] > 0.5, bins=3, equal="widths")
    assert np.isnan([*one.brier_interval, *one.calibration_error_interval, *one.observed_low]).all()
    assert np.isnan(one.pooled.observed[1])
    assert one.to_dict()["observed_low"] == [None] * 3


def test_means_of_long_runs():
    p, faulty = streams(np.random.default_rng(3), 8, steps=500)
    each = [reliability(a, b, bins=5) for a, b in zip(p, faulty)]
    found = mean_reliability(each, 0.9)
    errors = np.array([r.calibration_error for r in each])
    assert found["ece"] == {"mean": pytest.approx(errors.mean()), "ci": interval(errors, 0.9)}
    observed = np.array([r.observed[2] for r in each])
    assert found["diagram"][2]["observed"] == pytest.approx(observed.mean())
    assert found["diagram"][2]["ci"] == interval(observed, 0.9)
    assert sum(b["share"] for b in found["diagram"]) == pytest.approx(1.0)


def test_what_is_no_probability_is_told():
    with pytest.raises(ModelError, match="must be between 0 and 1"):
        calibration(np.full((2, 20), 3.0), np.zeros((2, 20), bool))
    with pytest.raises(ModelError, match="2 runs of probability and 1 of faulty"):
        calibration(np.zeros((2, 20)), np.zeros((1, 20), bool))


def test_probabilities_between_are_judged_apart():
    """The many near 0 and 1 are right, and the error of the others is that which numpy finds."""
    rng = np.random.default_rng(0)
    p = np.concatenate([np.full(5000, 0.001), np.full(500, 0.999), rng.uniform(0.15, 0.85, 200)])
    faulty = rng.random(len(p)) < np.where((p > 0.1) & (p < 0.9), p / 2, p)
    result = reliability(p, faulty, equal="widths")
    inner = (p > 0.1) & (p < 0.9)
    places = np.floor(10 * p[inner])
    gaps = [abs((p[inner] - faulty[inner])[places == k].sum()) for k in np.unique(places)]
    assert result.between() == (200.0, pytest.approx(sum(gaps) / 200))
    assert f"in bins from 0.1 to 0.9 (200 of {len(p)} samples)" in result.label()
    samples, error = reliability(p[~inner], faulty[~inner], equal="widths").between()
    assert (samples, np.isnan(error)) == (0.0, True)
