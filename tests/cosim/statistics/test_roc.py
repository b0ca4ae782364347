"""Receiver operating characteristics of many runs: scikit-learn's, with intervals that know that samples of a run are alike."""

import numpy as np
import pytest
import sklearn.metrics
import xarray as xr
from scipy.stats import norm, rankdata
from sklearn.metrics import roc_auc_score

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import auc
from bayesftc.cosim.statistics import interval, roc, roc_curve, roc_rates


def test_area_is_that_of_scikit_learn_with_ties():
    rng = np.random.default_rng(0)
    for share in (0.02, 0.5, 0.9):
        faulty = rng.random((3_000, 2)) < share
        score = np.round(rng.normal(size=faulty.shape) + faulty, 1)
        assert auc(faulty, score) == pytest.approx(roc_auc_score(faulty.ravel(), score.ravel()), abs=1e-12)


def test_curve_is_that_of_scikit_learn():
    rng = np.random.default_rng(1)
    faulty = rng.random(20_000) < 0.2
    score = rng.normal(size=20_000) + 1.5 * faulty
    false, true, _ = sklearn.metrics.roc_curve(faulty, score)
    mine = roc_curve(faulty, score)
    assert np.abs(mine - np.interp(roc_rates(), false, true)).max() < 2e-3
    assert mine[0] < 0.01
    assert mine[-1] == 1.0
    assert np.trapezoid(mine, roc_rates()) == pytest.approx(auc(faulty, score), abs=2e-3)


@pytest.mark.parametrize("decimals", [0, 1])
def test_curve_with_ties_is_that_of_scikit_learn(decimals):
    """Above all of a probability that is 0 most of the time: the curve must not rise before its time."""
    rng = np.random.default_rng(1)
    faulty = rng.random(20_000) < 0.3
    score = np.maximum(np.round(rng.normal(size=20_000) + 1.5 * faulty, decimals), 0.0)
    false, true, _ = sklearn.metrics.roc_curve(faulty, score, drop_intermediate=False)
    mine = roc_curve(faulty, score)
    assert np.abs(mine - np.interp(roc_rates(), false, true))[1:].max() < 2e-3
    assert np.trapezoid(mine, roc_rates()) == pytest.approx(auc(faulty, score), abs=3e-3)


def test_curves_rise():
    """Also where the highest score is that of many, above all of healthy samples."""
    rng = np.random.default_rng(2)
    faulty = rng.random(1000) < 0.5
    for score in (np.ones(1000), np.minimum(rng.normal(size=1000) + faulty, 0.2), np.round(rng.random(1000))):
        assert (np.diff(roc_curve(faulty, score)) >= 0).all()
        assert np.trapezoid(roc_curve(faulty, score), roc_rates()) == pytest.approx(auc(faulty, score), abs=3e-3)


def streams(rng, runs, steps=60, spread=0.7, sensors=None):
    """Return scores that are alike within a run, and faults of random onset; in some runs there is none."""
    shape = (runs, steps) if sensors is None else (runs, steps, sensors)
    level = spread * rng.normal(size=(runs, *[1] * (len(shape) - 1)))
    onset = rng.integers(10, int(1.3 * steps), size=runs)
    faulty = np.broadcast_to(
        (np.arange(steps) >= onset[:, None]).reshape((runs, steps, *[1] * (len(shape) - 2))), shape
    )
    return level + rng.normal(size=shape) + 1.5 * faulty, faulty


def test_areas_are_those_of_scikit_learn():
    score, faulty = streams(np.random.default_rng(0), 25, sensors=2)
    score[3, 20:] = np.nan  # a run that has failed
    score[4] = np.nan
    found = roc(score, faulty)
    known = ~np.isnan(score)
    assert found.auc == pytest.approx(roc_auc_score(faulty[known], score[known]), abs=1e-12)
    assert (found.runs, found.left_out) == (24, 1)
    for i, mine in enumerate(found.auc_of_runs):
        its = faulty[i][known[i]]
        if len(its) and its.any() and not its.all():
            assert mine == pytest.approx(roc_auc_score(its, score[i][known[i]]), abs=1e-12)
        else:
            assert np.isnan(mine)
    assert np.isnan(found.auc_of_runs).sum() > 1
    assert np.abs(found.true_positive_rate_pooled - roc_curve(faulty[known], score[known])).max() == 0


def test_the_curve_is_the_mean_of_those_of_the_runs_with_a_band():
    score, faulty = streams(np.random.default_rng(1), 12)
    both = np.flatnonzero(faulty.any(axis=1))
    curves = np.array([roc_curve(faulty[i], score[i]) for i in both])
    found = roc(score, faulty, level=0.8)
    assert found.true_positive_rate == pytest.approx(curves.mean(axis=0))
    low, high = np.transpose([interval(column, 0.8) for column in curves.T])
    assert found.lower == pytest.approx(np.clip(low, 0, 1))
    assert found.upper == pytest.approx(np.clip(high, 0, 1))
    assert (found.lower <= found.true_positive_rate).all()
    assert found.true_positive_rate.tolist() == found.to_dict()["true_positive_rate"]


def test_without_dependence_the_interval_is_delongs():
    """Each sample a run of its own: then it is DeLong's, whose variance is written out here from its definition."""
    rng = np.random.default_rng(2)
    faulty = np.arange(400) < 150
    score = rng.normal(size=400) + 1.2 * faulty
    x, y = score[faulty], score[~faulty]
    psi = (x[:, None] > y) + 0.5 * (x[:, None] == y)
    error = np.sqrt(psi.mean(axis=1).var(ddof=1) / len(x) + psi.mean(axis=0).var(ddof=1) / len(y))
    found = roc(score[:, None], faulty[:, None])
    logit = np.log(found.auc / (1 - found.auc))
    half = norm.ppf(0.975) * error / (found.auc * (1 - found.auc))
    wanted = 1 / (1 + np.exp(-(logit + np.array([-half, half]))))
    assert (found.low, found.high) == pytest.approx(tuple(wanted), abs=1e-3)


def test_the_interval_is_that_of_the_bootstrap_over_runs():
    rng = np.random.default_rng(3)
    score, faulty = streams(rng, 80)
    found = roc(score, faulty)
    drawn = []
    for _ in range(600):
        some = rng.integers(0, 80, 80)
        above, ranks = faulty[some].ravel(), rankdata(score[some])  # scikit-learn takes ten times as long
        n = above.sum()
        drawn.append((ranks[above].sum() - n * (n + 1) / 2) / (n * (~above).sum()))
    assert (found.low, found.high) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])), abs=0.008)
    assert found.high - found.low > 0.04


@pytest.mark.slow
def test_the_interval_covers_the_area_as_often_as_it_says():
    """Runs whose levels differ: one that counted samples would cover a third of the time."""
    rng = np.random.default_rng(4)
    truth = norm.cdf(1.5 / np.sqrt(2 * (1 + 0.7**2)))  # of samples of two runs, as nearly all pairs are
    hits = 0
    for _ in range(400):
        found = roc(*streams(rng, 30, steps=40))
        hits += found.low < truth < found.high
    assert hits / 400 == pytest.approx(0.95, abs=0.035)


def test_runs_may_come_as_a_list_or_from_a_dataset():
    score, faulty = streams(np.random.default_rng(5), 10)
    wanted = roc(score, faulty)
    array = xr.DataArray(score, dims=("run", "time"))
    flags = xr.DataArray(faulty.astype(float), dims=("run", "time"))
    assert roc(array, flags).to_dict() == wanted.to_dict()
    assert roc(list(score), [f.tolist() for f in faulty]).to_dict() == wanted.to_dict()
    assert roc([s[:50] for s in score], [f[:50] for f in faulty]).auc != wanted.auc
    flags[2, 30:] = np.nan  # recorded until the run has failed
    assert roc(array, flags).auc != wanted.auc


@pytest.mark.filterwarnings("error")
def test_scores_that_are_infinite_or_separate_all():
    faulty = np.tile(np.arange(20) >= 10, (3, 1))
    found = roc(np.where(faulty, np.inf, -np.inf), faulty)
    assert found.auc == 1.0
    assert np.isnan([found.low, found.high]).all()
    assert (found.true_positive_rate == 1.0).all()
    assert np.isnan(roc(np.where(faulty, 1.0, 0.0)[:1], faulty[:1]).lower).all()


@pytest.mark.parametrize(
    ("score", "faulty", "says"),
    [
        (np.zeros((3, 4)), np.zeros((2, 4), bool), "3 runs of score and 2 of faulty"),
        (np.zeros((3, 4)), np.zeros((3, 5), bool), r"Run 0 has score of shape \(4,\) and faulty of shape \(5,\)"),
        (np.zeros(4), np.zeros(4, bool), "as a list of one"),
        ([], [], "no run"),
        (np.zeros((3, 4)), np.zeros((3, 4), bool), "12 samples with a score, and none of them faulty"),
        (np.zeros((3, 4)), np.ones((3, 4), bool), "all of them faulty"),
        ([["a"]], [[True]], "run 0 is no array of numbers"),
    ],
)
def test_what_has_no_curve_is_told(score, faulty, says):
    with pytest.raises(ModelError, match=says):
        roc(score, faulty)
