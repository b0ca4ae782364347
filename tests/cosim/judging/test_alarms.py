"""Detectors at a threshold and calibrated probabilities: by hand, by brute force, against scikit-learn and by Monte Carlo."""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats
from sklearn.metrics import brier_score_loss

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError

HOUR = 3600.0


def by_hand(**changes):
    #                v begins before    v late         v outlasts       v missed       v false
    score = np.array([0, 9, 9, 0, 0, 0, 9, 9, 9, 0, 0, 0, 0, 9, 0])
    truth = np.array([0, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0])
    return cosim.judge_alarms(score, truth, **{"threshold": 9.0, "step": HOUR / 2, **changes})


def test_by_hand():
    found = by_hand()
    assert found.delays.tolist() == [0, 1, np.inf]
    assert (found.faults, found.missed, found.false_alarms, found.hours, found.false_hours) == (3, 1, 2, 5, 2)
    assert (found.missed_share, found.false_share, found.false_alarms_per_hour) == (pytest.approx(1 / 3), 0.4, 0.4)
    assert found.time_between_false_alarms == 2.5 * HOUR
    assert (found.delay(), found.delay(0.3)) == (1, 0)
    assert np.isnan(found.delay(0.9))
    none = by_hand(threshold=10.0)
    assert (none.missed, none.false_alarms) == (3, 0)
    assert np.isnan([none.time_between_false_alarms, none.delay()]).all()
    assert none.to_dict()["delay_samples"]["median"] is None


def test_samples_that_are_left_out_count_neither_way():
    left_out = np.zeros(15, dtype=bool)
    left_out[[5, 6, 13]] = True
    found = by_hand(left_out=left_out)
    assert (found.faults, found.false_alarms, found.hours, found.false_hours) == (2, 1, 4.5, 1.5)


def test_missing_samples_neither_interrupt_an_alarm_nor_hide_a_fault():
    score = [np.nan, 9, np.nan, 9, 0, np.nan, 0, 9, np.nan, np.nan, 0]
    truth = [0, 0, 0, 0, 0, 1, 1, 1, 0, 1, 0]
    found = cosim.judge_alarms(score, truth, threshold=1.0, step=1.0)
    assert found.false_alarms == 1
    assert found.delays.tolist() == [1]  # from the first sample that arrived; the second fault was seen as missing
    assert found.hours == pytest.approx(4 / HOUR)


def test_sensors_and_runs_are_pooled():
    rng = np.random.default_rng(0)
    score, truth = rng.normal(size=(400, 3)), rng.random((400, 3)) < 0.3
    both = cosim.judge_alarms(score, truth, threshold=1.0, step=0.1)
    apart = [cosim.judge_alarms(score[:, i], truth[:, i], threshold=1.0, step=0.1) for i in range(3)]
    total = apart[0] + apart[1] + apart[2]
    assert sorted(both.delays) == sorted(total.delays)
    assert both.false_alarms == total.false_alarms
    assert both.hours == pytest.approx(total.hours)
    with pytest.raises(ModelError, match="cannot be pooled"):
        _ = both + by_hand()


def count(columns, threshold):
    """How many alarms there are, sample by sample."""
    total = 0
    for column in columns:
        before = False
        for value in column:
            total += value >= threshold and not before
            before = value >= threshold
    return total


@given(st.lists(st.lists(st.integers(0, 6), min_size=1, max_size=12), min_size=1, max_size=3), st.integers(1, 5))
def test_threshold_is_the_least_with_so_few_alarms(columns, allowed):
    """Every level is tried; sensors and runs are records of their own, so that an alarm does not go on in the next."""
    hours = sum(map(len, columns))
    found = cosim.alarm_threshold([np.array(c, float) for c in columns], step=HOUR, per_hour=allowed / hours * 1.0001)
    too_many = [c for c in range(7) if count(columns, c) > allowed]
    if too_many:
        assert found == np.nextafter(too_many[-1], np.inf)
    else:
        assert found == min(map(min, columns))
    assert count(columns, found) <= allowed


def test_threshold_among_many_samples_is_that_of_the_definition():
    rng = np.random.default_rng(1)
    runs = [rng.normal(size=(20_000, 2)) for _ in range(3)]
    for allowed in (1, 12, 3_000):
        found = cosim.alarm_threshold(runs, step=1.0, per_hour=allowed * HOUR / 120_000 * 1.0001)
        alarms = [
            sum(cosim.judge_alarms(r, np.zeros_like(r), threshold=c, step=1.0).false_alarms for r in runs)
            for c in (found, np.nextafter(found, -np.inf))
        ]
        assert alarms == [allowed, allowed + 1]
    saturated = np.tile([0.0, 1.0], 50)
    assert cosim.alarm_threshold(saturated, step=1.0, per_hour=10 * 36.0) > 1.0


def test_intervals_are_those_of_scipy_and_cover_as_often_as_they_say():
    found = cosim.Alarms(0.1, np.array([0.0] * 31 + [2.0] * 20 + [np.inf] * 9), 7, 3.5, 0.1)
    exact = stats.binomtest(9, 60).proportion_ci(0.95, "exact")
    assert found.missed_interval() == pytest.approx((exact.low, exact.high))
    wanted = stats.chi2.ppf(0.025, 14) / 7, stats.chi2.ppf(0.975, 16) / 7
    assert found.rate_interval() == pytest.approx(wanted)
    rng = np.random.default_rng(2)
    for quantile in (0.5, 0.9):
        truth = stats.expon.ppf(quantile)
        runs = [cosim.Alarms(1.0, rng.exponential(size=41), 0, 1.0, 0.0).delay_interval(quantile) for _ in range(3_000)]
        assert 0.945 < np.mean([low <= truth <= high for low, high in runs]) < 0.99
    assert cosim.Alarms(1.0, np.array([3.0]), 0, 0.0, 0.0).delay_interval() == (0.0, np.inf)
    nothing = cosim.Alarms(1.0, np.array([]), 0, 0.0, 0.0)
    assert np.isnan([*nothing.delay_interval(), *nothing.missed_interval(), *nothing.rate_interval()]).all()
    assert np.isnan([nothing.delay(), nothing.missed_share, nothing.false_share, nothing.false_alarms_per_hour]).all()
    assert cosim.Alarms(1.0, np.zeros(5), 0, 2.0, 0.0).missed_interval()[0] == 0


def of_counts(counts):
    """Return the alarms of runs of an hour with these numbers of false alarms."""
    return reduce(add, [cosim.Alarms(1.0, np.array([]), int(count), 1.0, 0.0) for count in counts])


def in_clusters(rng, mean, runs):
    """Return numbers of alarms that come in clusters of a geometric number, with a variance of 2.5 times the mean."""
    return [rng.geometric(1 / 1.75, clusters).sum() for clusters in rng.poisson(mean / 1.75, runs)]


@pytest.mark.parametrize(
    "counts",
    [in_clusters, lambda rng, mean, runs: rng.negative_binomial(mean / 1.5, 0.4, runs)],
    ids=["clusters", "negative binomial"],
)
@pytest.mark.parametrize("runs", [5, 40])
def test_interval_of_the_rate_covers_alarms_in_clusters(counts, runs):
    rng = np.random.default_rng(5)
    hits = {"runs": 0, "one": 0}
    for _ in range(400):
        drawn = of_counts(counts(rng, 3.0, runs))
        for name, alarms in (("runs", drawn), ("one", replace(drawn, runs=None))):
            low, high = alarms.rate_interval()
            hits[name] += low <= 3.0 <= high
    assert 0.92 < hits["runs"] / 400 < 0.985
    assert hits["one"] / 400 < 0.86  # Garwood's, of independent alarms


def test_sensors_of_one_run_are_one_run():
    score = np.zeros((3600, 4))
    score[::100, :2] = 1.0
    found = cosim.judge_alarms(score, np.zeros_like(score), threshold=0.5, step=1.0)
    wanted = stats.chi2.ppf(0.025, 144) / 8, stats.chi2.ppf(0.975, 146) / 8
    assert found.rate_interval() == pytest.approx(wanted)


def test_reliability_is_that_of_its_definition():
    rng = np.random.default_rng(3)
    p = rng.beta(0.3, 2.0, 5_000)
    truth = rng.random(5_000) < p**1.3
    for equal in ("counts", "widths"):
        found = cosim.reliability(np.append(p, np.nan), np.append(truth, True), equal=equal)
        assert found.brier == pytest.approx(brier_score_loss(truth, p))
        assert found.brier_of_constant == pytest.approx(truth.var())
        order = np.argsort(p)
        bins = (
            np.array_split(order, 10)
            if equal == "counts"
            else [np.flatnonzero((p * 10).astype(int) == i) for i in range(10)]
        )
        gaps = [abs(p[b].mean() - truth[b].mean()) for b in bins]
        assert np.abs(found.predicted - found.observed) == pytest.approx(gaps)
        assert found.samples.tolist() == [len(b) for b in bins]
        assert found.calibration_error == pytest.approx(np.average(gaps, weights=found.samples))
    honest = cosim.reliability(p, rng.random(5_000) < p)
    assert honest.calibration_error < 0.02 < cosim.reliability(p, rng.random(5_000) < np.sqrt(p)).calibration_error
    assert cosim.reliability([0.5, 0.5], [0, 1], bins=2, equal="widths").to_dict()["observed"] == [None, 0.5]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: cosim.judge_alarms([1.0], [0, 1], threshold=0.0, step=1.0), "shape"),
        (lambda: cosim.judge_alarms([1.0], [0], threshold=np.nan, step=1.0), "threshold=nan"),
        (lambda: cosim.judge_alarms([1.0], [0], threshold=0.0, step=0.0), "step is 0.0"),
        (lambda: cosim.judge_alarms("abc", [0], threshold=0.0, step=1.0), "is not an array of numbers"),
        (lambda: cosim.judge_alarms([], [], threshold=0.0, step=1.0), "not empty"),
        (lambda: cosim.alarm_threshold(np.zeros(10), step=1.0), "at least 1 hours"),
        (lambda: cosim.alarm_threshold(np.zeros(10), step=1.0, per_hour=np.nan), "per_hour=nan"),
        (lambda: cosim.alarm_threshold([np.inf], step=HOUR), "infinite"),
        (lambda: cosim.alarm_threshold([], step=HOUR), "not empty"),
        (lambda: cosim.reliability([0.5, 2.0], [0, 1], bins=2), "from 0.5 to 2"),
        (lambda: cosim.reliability([0.5], [0, 1]), "shape"),
        (lambda: cosim.reliability([0.5], [0]), "bins=10 for 1 samples"),
        (lambda: cosim.reliability([0.5], [0], bins=1, equal="size"), "'counts' or 'widths'"),
    ],
)
def test_wrong_input_is_a_sentence(call, words):
    with pytest.raises(ModelError, match=words):
        call()
