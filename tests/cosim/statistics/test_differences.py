"""Tests of differences and corrections for their number, against scipy's and by hand."""

import numpy as np
import pytest
import scipy.stats
from scipy.stats import ttest_ind

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.statistics import corrected, outcomes
from bayesftc.cosim.statistics._differences import paired, rank_sum, signed_ranks, welch

RNG = np.random.default_rng(0)
X, Y = RNG.normal(0.0, 1.0, 20), RNG.normal(0.7, 2.0, 33)
Z = X + RNG.normal(0.2, 0.3, 20)


def test_outcomes_are_those_of_welchs_test():
    rng = np.random.default_rng(0)
    a = rng.normal(0.0, 1.0, (25, 40))
    b = rng.normal(np.linspace(-0.6, 0.6, 25)[:, None], 0.4, (25, 60))
    for scale in (1.0, 1e-120):
        decided = outcomes(scale * a, scale * b, 0.05)
        test = ttest_ind(a, b, axis=1, equal_var=False)
        assert decided.tolist() == np.where(test.pvalue < 0.05, -np.sign(test.statistic), 0).tolist()
        assert set(decided) == {-1, 0, 1}
        assert outcomes(scale * b, scale * a, 0.05).tolist() == (-decided).tolist()


@pytest.mark.filterwarnings("error")
def test_samples_without_scatter_differ_if_their_means_do_by_more_than_rounding():
    ones, wobble = np.ones(50), 1.0 + np.finfo(float).eps * (np.arange(50) % 3)
    assert outcomes(ones, ones, 0.05) == 0
    assert outcomes(np.zeros(50), np.zeros(50), 0.05) == 0
    assert (
        outcomes(wobble, ones, 0.05) == 0
    )  # significant by the letter: every run is above 1, by less than can be computed
    assert outcomes(0.3 * ones, 0.1 * wobble + 0.2, 0.05) == 0
    assert outcomes(ones, 2.0 * ones, 0.05) == 1
    assert outcomes(ones, wobble - 1e-9, 0.05) == -1


def test_welch_and_the_paired_test_are_scipys():
    for mine, theirs in (
        (welch(X, Y), scipy.stats.ttest_ind(X, Y, equal_var=False)),
        (paired(X, Z), scipy.stats.ttest_rel(X, Z)),
    ):
        assert mine.p == pytest.approx(theirs.pvalue, rel=1e-10)
        assert mine.mean / mine.error == pytest.approx(theirs.statistic, rel=1e-10)
        assert mine.freedom == pytest.approx(theirs.df, rel=1e-10)
        assert mine.interval(0.9) == pytest.approx(list(theirs.confidence_interval(0.9)), rel=1e-10)


def test_rank_tests_are_scipys():
    mine, theirs = signed_ranks(X, Z), scipy.stats.wilcoxon(X, Z)
    assert (mine.p, mine.statistic) == (theirs.pvalue, theirs.statistic)
    ranks = scipy.stats.rankdata(np.abs(X - Z))
    assert mine.effect == pytest.approx((ranks[X > Z].sum() - ranks[X < Z].sum()) / ranks.sum())
    mine, theirs = rank_sum(X, Y), scipy.stats.mannwhitneyu(X, Y)
    assert (mine.p, mine.statistic) == (theirs.pvalue, theirs.statistic)
    above = np.sign(X[:, None] - Y).mean()  # probability that ours is larger, minus that theirs is
    assert mine.effect == pytest.approx(above)


@pytest.mark.filterwarnings("error")
def test_rank_tests_of_samples_that_are_all_the_same():
    assert signed_ranks(np.ones(5), np.ones(5)) == (0.0, 1.0, 0.0)
    assert rank_sum(np.ones(5), np.ones(7)).p == 1.0


def test_corrections_by_hand():
    p = np.array([0.03, 0.01, 0.04, np.nan, 0.5])
    assert corrected(p, None) == pytest.approx(p, nan_ok=True)
    assert corrected(p, "bonferroni") == pytest.approx([0.12, 0.04, 0.16, np.nan, 1.0], nan_ok=True)
    # In order 0.01 x 4, 0.03 x 3, 0.04 x 2 (which may not be below the one before), 0.5 x 1.
    assert corrected(p, "holm") == pytest.approx([0.09, 0.04, 0.09, np.nan, 0.5], nan_ok=True)
    # In order 0.01 x 4/1, 0.03 x 4/2, 0.04 x 4/3, 0.5 x 4/4; none above one that follows.
    assert corrected(p, "benjamini-hochberg") == pytest.approx([4 / 75, 0.04, 4 / 75, np.nan, 0.5], nan_ok=True)
    assert corrected([np.nan], "benjamini-hochberg") == pytest.approx([np.nan], nan_ok=True)


def test_corrections_of_many_tests():
    p = np.random.default_rng(1).beta(0.5, 2.0, 60)
    p[7] = p[20]  # a tie
    holm, bonferroni, bh = (corrected(p, c) for c in ("holm", "bonferroni", "benjamini-hochberg"))
    assert bh == pytest.approx(scipy.stats.false_discovery_control(p))
    assert (p <= bh).all()
    assert (bh <= holm).all()
    assert (holm <= bonferroni).all()
    for alpha in (0.01, 0.05, 0.2):  # Holm's own words: go up until the first that is not below alpha / (tests left)
        found = 0
        while found < 60 and np.sort(p)[found] <= alpha / (60 - found):
            found += 1
        assert (holm <= alpha).sum() == found


def test_holm_keeps_its_promise_where_nothing_differs():
    rng = np.random.default_rng(2)
    false = [(corrected(rng.uniform(size=10), "holm") < 0.05).any() for _ in range(4000)]
    assert np.mean(false) == pytest.approx(1 - (1 - 0.005) ** 10, abs=0.01)


def test_no_such_correction():
    with pytest.raises(ModelError, match="no correction 'fdr'; use one of 'bonferroni'"):
        corrected([0.1], "fdr")
