"""Summaries, comparisons and merit of tables with a row for each run: against scipy and pandas, cell by cell."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.statistics import compare, corrected, merit, merit_counts, summary, total_merit

TECHNIQUES = ("none", "gamma", "switching")
FAULTS = ("freeze", "drift")
RUNS = 12


def runs():
    """Return a table in which each seed has noise that all techniques share, in an order of chance, and two failed runs."""
    rng = np.random.default_rng(0)
    common = rng.normal(0.0, 1.0, (2, RUNS))
    rows = [
        {
            "point": 3 * i + j,
            "seed": 100 + s,
            "fault": fault,
            "technique": technique,
            "rmse": 5.0 - 0.4 * j + common[i, s] + rng.normal(0.0, 0.2),
            "auc": rng.uniform(0.8, 1.0),
        }
        for i, fault in enumerate(FAULTS)
        for j, technique in enumerate(TECHNIQUES)
        for s in range(RUNS)
    ]
    table = pd.DataFrame(rows)
    table.loc[(table["fault"] == "drift") & (table["technique"] == "gamma") & (table["seed"] == 103), "rmse"] = np.nan
    table.loc[(table["fault"] == "drift") & (table["technique"] == "none") & (table["seed"] == 104), "rmse"] = np.inf
    table = table.sample(frac=1.0, random_state=3, ignore_index=True)
    table.insert(0, "run", range(len(table)))
    return table


TABLE = runs()


def values(fault, technique, metric="rmse"):
    rows = TABLE[(TABLE["fault"] == fault) & (TABLE["technique"] == technique)].sort_values("seed")
    return rows[metric].to_numpy()


def finite(x):
    return x[np.isfinite(x)]


def test_summary_has_the_figures_of_each_cell():
    found = summary(TABLE, ["rmse", "auc"], ["fault", "technique"], level=0.9).set_index(
        ["metric", "fault", "technique"]
    )
    assert len(found) == 12
    for metric in ("rmse", "auc"):
        for fault in FAULTS:
            for technique in TECHNIQUES:
                row, mine = found.loc[(metric, fault, technique)], values(fault, technique, metric)
                known = finite(mine)
                bounds = scipy.stats.ttest_1samp(known, 0.0).confidence_interval(0.9)
                assert (row["n"], row["left_out"]) == (len(known), len(mine) - len(known))
                assert row["mean"] == pytest.approx(known.mean(), rel=1e-12)
                assert row["sd"] == pytest.approx(known.std(ddof=1), rel=1e-12)
                assert (row["low"], row["high"]) == pytest.approx(tuple(bounds), rel=1e-12)
                assert row["median"] == np.median(known)
    assert found["left_out"].sum() == 2


def test_summary_of_all_runs_and_by_the_bootstrap():
    (row,) = summary(TABLE, "rmse").to_dict("records")
    assert (row["n"], row["left_out"]) == (70, 2)
    known = finite(TABLE["rmse"].to_numpy())
    (other,) = summary(TABLE, "rmse", bootstrap="BCa", resamples=3000, seed=4).to_dict("records")
    wanted = scipy.stats.bootstrap((known,), np.mean, n_resamples=3000, random_state=np.random.default_rng(4))
    assert (other["low"], other["high"]) == pytest.approx(tuple(wanted.confidence_interval))
    assert {k: v for k, v in row.items() if k not in ("low", "high")} == {
        k: v for k, v in other.items() if k not in ("low", "high")
    }


@pytest.mark.filterwarnings("error")
def test_summary_of_too_few_runs_is_nan_and_says_how_many_are_left_out():
    table = pd.DataFrame({"a": ["x", "y", "y"], "m": [1.0, None, None]})
    one, none = summary(table, "m", "a").to_dict("records")
    assert (one["n"], one["mean"], one["left_out"]) == (1, 1.0, 0)
    assert np.isnan([one["sd"], one["low"], one["high"]]).all()
    assert (none["n"], none["left_out"]) == (0, 2)
    assert np.isnan([none["mean"], none["median"]]).all()
    assert len(summary(table[:0], "m", "a")) == 0


def test_a_cell_of_missing_labels_is_a_cell():
    table = pd.DataFrame({"a": ["x", None, None], "m": [1.0, 2.0, 3.0]})
    assert summary(table, "m", "a")["n"].tolist() == [1, 2]


@pytest.mark.parametrize("test", ["t", "wilcoxon"])
def test_paired_comparisons_are_scipys_on_runs_of_the_same_seed(test):
    found = compare(TABLE, "rmse", "technique", "fault", test=test, level=0.9)
    assert len(found) == 2 * 3
    for row in found.to_dict("records"):
        x, y = values(row["fault"], row["first"]), values(row["fault"], row["second"])
        known = np.isfinite(x) & np.isfinite(y)
        x, y = x[known], y[known]
        t = scipy.stats.ttest_rel(x, y)
        wanted = t if test == "t" else scipy.stats.wilcoxon(x, y)
        assert row["p"] == pytest.approx(wanted.pvalue, rel=1e-9)
        assert row["statistic"] == pytest.approx(wanted.statistic, rel=1e-9)
        assert (row["low"], row["high"]) == pytest.approx(tuple(t.confidence_interval(0.9)), rel=1e-9)
        assert row["difference"] == pytest.approx(row["mean_first"] - row["mean_second"])
        assert row["n_first"] == row["n_second"] == len(x) == RUNS - row["left_out"]
        if test == "t":
            assert row["effect"] == pytest.approx((x - y).mean() / (x - y).std(ddof=1))
            assert row["freedom"] == len(x) - 1
    pairs = {(r["fault"], *sorted((r["first"], r["second"]))): r["left_out"] for r in found.to_dict("records")}
    assert pairs[("drift", "gamma", "none")] == 2
    assert sum(pairs.values()) == 4


@pytest.mark.parametrize("test", ["t", "wilcoxon"])
def test_unpaired_comparisons_are_scipys(test):
    found = compare(TABLE, "rmse", "technique", ["fault"], paired=False, test=test)
    for row in found.to_dict("records"):
        x, y = finite(values(row["fault"], row["first"])), finite(values(row["fault"], row["second"]))
        t = scipy.stats.ttest_ind(x, y, equal_var=False)
        wanted = t if test == "t" else scipy.stats.mannwhitneyu(x, y)
        assert row["p"] == pytest.approx(wanted.pvalue, rel=1e-9)
        assert row["statistic"] == pytest.approx(wanted.statistic, rel=1e-9)
        assert (row["low"], row["high"]) == pytest.approx(tuple(t.confidence_interval(0.95)), rel=1e-9)
        assert row["n_first"] + row["n_second"] + row["left_out"] == 2 * RUNS
        if test == "t":
            assert row["effect"] == pytest.approx((x.mean() - y.mean()) / np.sqrt((x.var(ddof=1) + y.var(ddof=1)) / 2))


def test_pairing_finds_what_the_noise_hides():
    unpaired, paired = (compare(TABLE, "rmse", "technique", "fault", paired=p)["p"].max() for p in (False, True))
    assert paired < 0.01 < 0.2 < unpaired


def test_corrections_are_over_all_cells_and_pairs():
    plain = compare(TABLE, "auc", "technique", "fault")
    assert plain["p_corrected"].tolist() == plain["p"].tolist()
    for correction in ("bonferroni", "holm", "benjamini-hochberg"):
        found = compare(TABLE, "auc", "technique", "fault", correction=correction)
        assert found["p_corrected"].to_numpy() == pytest.approx(corrected(plain["p"], correction))


def test_only_pairs_with_one_level():
    found = compare(TABLE, "rmse", "technique", "fault", against="gamma", correction="bonferroni")
    assert set(zip(found["first"], found["second"])) == {("none", "gamma"), ("switching", "gamma")}
    assert found["p_corrected"].to_numpy() == pytest.approx(np.minimum(4 * found["p"], 1.0))


@pytest.mark.filterwarnings("error")
def test_runs_that_do_not_scatter():
    table = pd.DataFrame({"a": list("xxyyzz"), "seed": [0, 1] * 3, "m": [1.0, 1.0, 1.0, 1.0, 2.0, 2.0]})
    for paired in (True, False):
        same, other, _ = compare(table, "m", "a", paired=paired).to_dict("records")
        assert same["p"] == 1.0
        assert other["p"] < 1e-100
        assert (other["low"], other["high"]) == (-1.0, -1.0)
        assert np.isnan([other["effect"], other["statistic"]]).all()


@pytest.mark.filterwarnings("error")
def test_too_few_runs_have_no_p():
    table = pd.DataFrame({"a": list("xxyy"), "seed": [0, 1] * 2, "m": [1.0, np.nan, 3.0, 4.0]})
    (row,) = compare(table, "m", "a", correction="holm").to_dict("records")
    assert (row["n_first"], row["left_out"], row["mean_second"]) == (1, 1, 3.0)
    assert np.isnan([row["p"], row["p_corrected"], row["low"]]).all()


@pytest.mark.parametrize(
    ("change", "options", "says"),
    [
        (lambda t: t.assign(seed=range(len(t))), {}, "24 seeds have a run of only one of them .*paired=False"),
        (lambda t: t, {"by": None}, "several have the seed 1.*in by="),
        (lambda t: t[t["technique"] == "none"], {}, "'technique' has only 'none'.*needs two levels"),
        (lambda t: t, {"test": "z"}, "test='z'"),
        (lambda t: t, {"correction": "fdr"}, "correction='fdr'"),
        (lambda t: t, {"level": 95}, "level is 95"),
        (lambda t: t.assign(rmse="much"), {}, "'rmse' has no numbers"),
        (lambda t: t, {"by": ["fault", "technique"]}, "'technique' is named twice"),
        (lambda t: [1], {}, "table is a list"),
    ],
)
def test_what_cannot_be_compared_is_told(change, options, says):
    options = {"metric": "rmse", "factor": "technique", "by": "fault", **options}
    with pytest.raises(ModelError, match=says):
        compare(change(TABLE), **options)


def test_unknown_names():
    with pytest.raises(UnknownNameError, match="no column 'rms'; did you mean 'rmse'"):
        summary(TABLE, "rms")
    with pytest.raises(UnknownNameError, match=r"no level 'gama'.* did you mean 'gamma'"):
        compare(TABLE, "rmse", "technique", "fault", against="gama")
    with pytest.raises(UnknownNameError, match="no column 'seed'"):
        compare(TABLE.drop(columns="seed"), "rmse", "technique", "fault")


def test_merit_counts_scenarios_for_the_column_against_the_row():
    rng = np.random.default_rng(1)
    good, bad = rng.normal(1, 0.1, 50), rng.normal(2, 0.1, 50)
    table = merit_counts([{"a": good, "b": bad}, {"a": good, "b": bad}, {"a": bad, "b": good}], ["a", "b"], 0.05)
    assert table == {"a": {"a": 0, "b": -1}, "b": {"a": 1, "b": 0}}
    assert total_merit(table) == {"a": 1, "b": -1}


def test_merit_of_a_table_is_that_of_its_arrays():
    errors = [{technique: values(fault, technique, "auc") for technique in TECHNIQUES} for fault in FAULTS]
    for significance in (0.01, 0.3, 0.5):
        counts = merit_counts(errors, TECHNIQUES, significance)
        found = merit(TABLE, "auc", "technique", "fault", significance=significance)
        assert {row: {c: found.loc[row, c] for c in TECHNIQUES} for row in TECHNIQUES} == counts
        assert found.loc["total merit"].to_dict() == total_merit(counts)
    assert found.loc["total merit"].abs().sum() > 0


def test_merit_by_paired_tests_with_correction():
    found = merit(TABLE, "rmse", "technique", "fault", paired=True, correction="holm")
    assert found.loc["none"].to_dict() == {"none": 0, "gamma": 2, "switching": 2}
    assert found.loc["total merit"].to_dict() == {"none": -4, "gamma": 0, "switching": 4}
    higher = merit(TABLE, "rmse", "technique", "fault", paired=True, correction="holm", better="higher")
    assert (higher == -found).all(axis=None)


def test_what_has_no_merit_is_told():
    without = TABLE[(TABLE["fault"] != "drift") | (TABLE["technique"] != "gamma")]
    with pytest.raises(ModelError, match="no run of technique 'gamma' where fault is 'drift'"):
        merit(without, "rmse", "technique", "fault")
    failed = TABLE.assign(rmse=TABLE["rmse"].where((TABLE["technique"] != "gamma") | (TABLE["seed"] == 100)))
    with pytest.raises(ModelError, match=r"1 runs of technique 'gamma' where fault is '.*at least two"):
        merit(failed, "rmse", "technique", "fault")
    with pytest.raises(ModelError, match="better='less'"):
        merit(TABLE, "rmse", "technique", "fault", better="less")
    with pytest.raises(ModelError, match="significance=5"):
        merit(TABLE, "rmse", "technique", "fault", significance=5)
