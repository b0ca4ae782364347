"""Delays and false alarms at many thresholds: those of `judge_alarms` at each, and intervals that count runs."""

from functools import reduce
from operator import add

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.alarms import Alarms, judge_alarms
from bayesftc.cosim.statistics import delay_curve, ratio
from bayesftc.cosim.statistics._alarm_counts import count_alarms

SCORES = st.sampled_from([0.0, 1.0, 2.0, 3.0, -np.inf, np.inf, np.nan])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(SCORES, st.booleans(), SCORES, st.booleans()), min_size=1, max_size=25))
def test_counts_at_all_thresholds_are_those_of_judging_each(rows):
    score = np.array([(a, c) for a, _, c, _ in rows])
    faulty = np.array([(b, d) for _, b, _, d in rows])
    thresholds = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0, np.inf])
    counts = count_alarms([(score, faulty)], thresholds, 0.5)
    for i, threshold in enumerate(thresholds):
        wanted, mine = judge_alarms(score, faulty, threshold=threshold, step=0.5), counts.at(i)
        assert mine.delays.tolist() == wanted.delays.tolist()
        assert mine.false_alarms == wanted.false_alarms
        assert (mine.hours, mine.false_hours) == pytest.approx((wanted.hours, wanted.false_hours))


def streams(rng, runs, steps=300, faults=2, size=2.0, spread=0.5):
    """Return scores with a level for each run, and faults of some seconds in each."""
    faulty = np.zeros((runs, steps), dtype=bool)
    for i in range(runs):
        for begin in rng.choice(np.arange(1, steps // 40), faults, replace=False) * 40:
            faulty[i, begin : begin + rng.integers(5, 15)] = True
    level = spread * rng.normal(size=(runs, 1))
    return level + rng.normal(size=(runs, steps)) + size * faulty, faulty


def garwood_over_runs(alarms, hours):
    """Return the interval of a rate by its definition: Garwood's, with dispersion, and as much wider as Student's t."""
    rate, freedom = alarms.sum() / hours.sum(), len(alarms) - 1
    wider = 1.0
    if (factor := stats.chisquare(alarms, rate * hours).statistic / freedom) > 1:
        wider = stats.t.ppf(0.975, freedom) / stats.norm.ppf(0.975)
    factor = max(1.0, factor)
    shape, scale = alarms.sum() / factor, factor / hours.sum()
    low, high = stats.gamma.ppf(0.025, shape) * scale, stats.gamma.ppf(0.975, shape + 1) * scale
    return max(rate - wider * (rate - low), 0.0), rate + wider * (high - rate)


def test_figures_are_those_of_all_runs_together():
    score, faulty = streams(np.random.default_rng(0), 20)
    score[3, 100:] = np.nan
    score[4] = np.nan
    found = delay_curve(score, faulty, step=0.1, thresholds=[3.0, 1.5, 2.5])
    assert found["threshold"].tolist() == [1.5, 2.5, 3.0]
    for row in found.to_dict("records"):
        each = [judge_alarms(s, f, threshold=row["threshold"], step=0.1) for s, f in zip(score, faulty)]
        each = [a for a in each if a.hours]
        total = reduce(add, each)
        assert row["runs"] == len(each) == 19
        assert row["faults"] == total.faults
        assert row["false_alarms_per_hour"] == pytest.approx(total.false_alarms_per_hour)
        assert row["false_share"] == pytest.approx(total.false_share)
        assert row["missed_share"] == total.missed_share
        assert row["median_delay"] == pytest.approx(0.1 * total.delay())
        assert row["delay_90"] == pytest.approx(0.1 * total.delay(0.9), nan_ok=True)
        assert row["mean_delay"] == pytest.approx(0.1 * total.delays[np.isfinite(total.delays)].mean())
        alarms, hours = np.array([a.false_alarms for a in each]), np.array([a.hours for a in each])
        bounds = garwood_over_runs(alarms, hours)
        assert (row["false_alarms_per_hour_low"], row["false_alarms_per_hour_high"]) == pytest.approx(bounds)
        if alarms.sum() > 100:  # of many alarms it is about that of a ratio over runs
            assert np.ptp(bounds) == pytest.approx(np.ptp(ratio(alarms, hours)[1]), rel=0.1)
    assert (np.diff(found["missed_share"]) > 0).all()
    assert (np.diff(found["median_delay"]) > 0).all()


def test_thresholds_that_are_chosen_go_from_always_to_hardly_ever():
    score, faulty = streams(np.random.default_rng(1), 10)
    found = delay_curve(score, faulty, step=0.1, thresholds=12)
    shares = [(score[~faulty] >= t).mean() for t in found["threshold"]]
    assert shares[0] == 1.0
    assert shares[-1] == pytest.approx(1 / (~faulty).sum())
    steps = np.diff(np.log(shares))[:-3]  # the last ones are rounded to whole samples
    assert steps == pytest.approx(steps.mean() * np.ones_like(steps), abs=0.05)
    assert found["missed_share"].iloc[0] == 0
    assert len(delay_curve(np.round(score), faulty, step=0.1)) < 12  # no threshold twice


def test_intervals_are_those_of_the_bootstrap_over_runs():
    rng = np.random.default_rng(2)
    score, faulty = streams(rng, 60)
    (row,) = delay_curve(score, faulty, step=0.1, thresholds=[2.5]).to_dict("records")
    each = [judge_alarms(s, f, threshold=2.5, step=0.1) for s, f in zip(score, faulty)]
    drawn = [reduce(add, [each[i] for i in rng.integers(0, 60, 60)]) for _ in range(1000)]
    figures = {
        "false_alarms_per_hour": [a.false_alarms_per_hour for a in drawn],
        "missed_share": [a.missed_share for a in drawn],
        "median_delay": [0.1 * a.delay() for a in drawn],
        "mean_delay": [0.1 * a.delays[np.isfinite(a.delays)].mean() for a in drawn],
    }
    for name, values in figures.items():
        low, high = np.nanquantile(values, [0.025, 0.975])
        width = high - low
        assert row[f"{name}_low"] == pytest.approx(low, abs=0.25 * width)
        assert row[f"{name}_high"] == pytest.approx(high, abs=0.25 * width)


def test_the_median_may_be_finite_although_most_of_what_was_seen_is_missed():
    rng = np.random.default_rng(5)
    score, faulty = streams(rng, 60, size=1.5)
    (row,) = delay_curve(score, faulty, step=0.1, thresholds=[2.95]).to_dict("records")
    assert 0.5 < row["missed_share"] < 0.6
    each = [judge_alarms(s, f, threshold=2.95, step=0.1) for s, f in zip(score, faulty)]
    drawn = [reduce(add, [each[i] for i in rng.integers(0, 60, 60)]) for _ in range(1000)]
    low = np.quantile(np.nan_to_num([0.1 * a.delay() for a in drawn], nan=np.inf), 0.025, method="inverted_cdf")
    assert np.isnan(row["median_delay"])
    assert row["median_delay_high"] == np.inf
    assert row["median_delay_low"] == pytest.approx(low, abs=0.11)


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say():
    """Against figures of very many runs; faults of one run are alike, for their runs have levels of their own."""
    rng = np.random.default_rng(3)
    options = {"step": 0.1, "thresholds": [3.0]}
    (truth,) = delay_curve(*streams(rng, 6000), **options).to_dict("records")
    names = ("false_alarms_per_hour", "missed_share", "median_delay", "mean_delay")
    hits = dict.fromkeys(names, 0)
    for _ in range(200):
        (row,) = delay_curve(*streams(rng, 40), **options).to_dict("records")
        for name in names:
            hits[name] += row[f"{name}_low"] <= truth[name] <= row[f"{name}_high"]
    # The delay comes in whole samples, so that its interval covers at least as often as it says.
    assert {name: h / 200 for name, h in hits.items() if not name.startswith("median")} == pytest.approx(
        dict.fromkeys((n for n in names if not n.startswith("median")), 0.95), abs=0.045
    )
    assert hits["median_delay"] / 200 >= 0.905


def test_false_alarms_of_runs_of_unequal_rates_widen_their_interval():
    rng = np.random.default_rng(4)
    alarms, hours = 20.0 * np.arange(6), np.full(6, 2.0)
    runs = [Alarms(1.0, np.array([]), int(k), h, 0.0) for k, h in zip(alarms, hours)]
    assert reduce(add, runs).rate_interval() == pytest.approx(garwood_over_runs(alarms, hours))
    shuffled = [runs[i] for i in rng.permutation(6)]
    halves = reduce(add, shuffled[:3]) + reduce(add, shuffled[3:])  # in any order
    assert halves.rate_interval() == pytest.approx(garwood_over_runs(alarms, hours))
    together = Alarms(1.0, np.array([]), int(alarms.sum()), float(hours.sum()), 0.0)
    assert np.ptp(together.rate_interval()) < 0.25 * np.ptp(halves.rate_interval())


@pytest.mark.filterwarnings("error")
def test_where_runs_tell_nothing_the_interval_is_the_exact_one():
    faulty = np.zeros((5, 100), dtype=bool)
    faulty[:, 50:60] = True
    score = np.where(faulty, 5.0, 0.0)
    never, always = delay_curve(score, faulty, step=36.0, thresholds=[1.0, 9.0]).to_dict("records")
    assert (never["false_alarms_per_hour"], never["false_alarms_per_hour_low"]) == (0, 0)
    assert never["false_alarms_per_hour_high"] == pytest.approx(-np.log(0.025) / 4.5)  # 5 runs of 0.9 hours
    assert never["missed_share_high"] == pytest.approx(1 - 0.025 ** (1 / 5))
    assert always["missed_share_low"] == pytest.approx(0.025 ** (1 / 5))
    assert (never["median_delay"], never["median_delay_low"], never["median_delay_high"]) == (0, 0, 0)
    assert np.isnan([always["median_delay"], always["mean_delay"], always["mean_delay_low"]]).all()
    assert always["median_delay_high"] == np.inf
    (one,) = delay_curve(score[:1], faulty[:1], step=36.0, thresholds=[1.0]).to_dict("records")
    assert one["missed_share_high"] == pytest.approx(1 - 0.025)
    assert np.isnan([one["mean_delay_low"], one["median_delay_low"]]).all()


def test_runs_without_faults_have_false_alarms_only():
    score = np.random.default_rng(4).normal(size=(5, 100, 2))
    (row,) = delay_curve(score, np.zeros(score.shape, bool), step=1.0, thresholds=[1.0]).to_dict("records")
    assert row["false_alarms_per_hour"] > 0
    assert row["faults"] == 0
    assert np.isnan([row["missed_share"], row["missed_share_low"], row["median_delay"], row["median_delay_low"]]).all()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"step": 0.0}, "step is 0.0"),
        ({"thresholds": 1}, "thresholds=1"),
        ({"thresholds": [np.nan]}, "one that is NaN"),
        ({"thresholds": []}, "no threshold"),
        ({"faulty": np.ones((3, 10), bool)}, "no fault-free sample"),
        ({"level": 2}, "level is 2"),
    ],
)
def test_what_has_no_curve_is_told(options, says):
    options = {"step": 0.1, "faulty": np.zeros((3, 10), bool), **options}
    with pytest.raises(ModelError, match=says):
        delay_curve(np.zeros((3, 10)), **options)
