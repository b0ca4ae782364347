"""Sobol indices: those of functions whose indices are known, and intervals that cover."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from SALib.analyze import sobol
from SALib.test_functions import Ishigami

from bayesftc.cosim import Grid, SaltelliDesign
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.statistics import sensitivity

ANGLES = dict.fromkeys(("a", "b", "c"), (-np.pi, np.pi))
SEEDS = 3


def table_of(design, function, seeds=SEEDS):
    """Return the table of a campaign on a design: each run has what the function says, and noise of its seed."""
    noise = np.random.default_rng(0).normal(0.0, 0.1, seeds)
    rows = [
        {"point": i, "seed": s, **point, "metric": function(**point) + noise[s]}
        for i, point in enumerate(design.points())
        for s in range(seeds)
    ]
    return pd.DataFrame(rows)


def ishigami(a, b, c):
    return np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


# By Ishigami and Homma (1990), with the constants 7 and 0.1.
VARIANCE = 7**2 / 8 + 0.1 * np.pi**4 / 5 + 0.01 * np.pi**8 / 18 + 0.5
FIRST = {"a": 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2 / VARIANCE, "b": 7**2 / 8 / VARIANCE, "c": 0.0}
PAIR = 0.01 * np.pi**8 * (1 / 18 - 1 / 50) / VARIANCE
TOTAL = {"a": FIRST["a"] + PAIR, "b": FIRST["b"], "c": PAIR}


def test_indices_of_ishigamis_function():
    design = SaltelliDesign(ANGLES, 1024, second_order=True)
    found = sensitivity(table_of(design, ishigami, 1), "metric", design)
    factors, pairs = found[found["other"].isna()], found[found["other"].notna()]
    for row in factors.to_dict("records"):
        name = row["factor"]
        assert row["first"] == pytest.approx(FIRST[name], abs=0.03)
        assert row["total"] == pytest.approx(TOTAL[name], abs=0.03)
        assert row["first_low"] < FIRST[name] < row["first_high"]
        assert row["total_low"] < TOTAL[name] < row["total_high"]
    indices = {(r["factor"], r["other"]): r["second"] for r in pairs.to_dict("records")}
    assert indices == {
        ("a", "b"): pytest.approx(0, abs=0.03),
        ("a", "c"): pytest.approx(PAIR, abs=0.03),
        ("b", "c"): pytest.approx(0, abs=0.03),
    }
    assert (found["n"] == 1024).all()


def test_they_are_salibs_of_the_means_over_seeds_in_whichever_order_runs_come():
    design = SaltelliDesign(ANGLES, 64, seed=3)
    table = table_of(design, ishigami)
    found = sensitivity(table.sample(frac=1.0, random_state=1), "metric", design, level=0.9, resamples=200, seed=5)
    values = Ishigami.evaluate(np.array([list(p.values()) for p in design.points()]))
    wanted = sobol.analyze(
        design.problem(),
        values,
        calc_second_order=False,
        num_resamples=200,
        conf_level=0.9,
        seed=np.random.default_rng(5),
    )
    assert found["first"].to_numpy() == pytest.approx(wanted["S1"])
    assert found["total"].to_numpy() == pytest.approx(wanted["ST"])
    assert ((found["first_high"] - found["first_low"]) / 2).to_numpy() == pytest.approx(wanted["S1_conf"])
    assert ((found["total_high"] - found["total_low"]) / 2).to_numpy() == pytest.approx(wanted["ST_conf"])
    assert list(found) == [
        "factor", "first", "first_low", "first_high", "total", "total_low", "total_high", "n", "left_out",
    ]  # fmt: skip


def test_distributions_and_whole_numbers():
    """A sum of independent factors: each one's index is its share of the variance."""
    design = SaltelliDesign({"x": scipy.stats.norm(5.0, 2.0), "n": range(1, 7), "u": (0.0, 3.0)}, 512)
    variances = np.array([4.0, 35 / 12, 9 / 12])
    found = sensitivity(table_of(design, lambda x, n, u: x + n + u), "metric", design)
    assert found["first"].to_numpy() == pytest.approx(variances / variances.sum(), abs=0.03)
    assert found["total"].to_numpy() == pytest.approx(variances / variances.sum(), abs=0.03)


def test_a_grid_beside_has_indices_in_each_of_its_cells():
    design = SaltelliDesign({"a": (0.0, 1.0), "b": (0.0, 1.0)}, 256)
    both = design * Grid({"kind": ["a only", "b only"]})
    table = table_of(both, lambda a, b, kind: a if kind == "a only" else b)
    found = sensitivity(table, "metric", design, by="kind").set_index(["kind", "factor"])["total"]
    assert found.to_dict() == {
        ("a only", "a"): pytest.approx(1.0, abs=0.05),
        ("a only", "b"): pytest.approx(0.0, abs=0.01),
        ("b only", "a"): pytest.approx(0.0, abs=0.01),
        ("b only", "b"): pytest.approx(1.0, abs=0.05),
    }
    with pytest.raises(ModelError, match=r"2048 points and the design 1024; .*by="):
        sensitivity(table, "metric", design)


def test_failed_runs_are_left_out_and_counted():
    design = SaltelliDesign(ANGLES, 512)
    table = table_of(design, ishigami)
    table.loc[(table["point"] == 7) & (table["seed"] == 0), "metric"] = np.nan  # two runs of this point are left
    table.loc[table["point"].isin([10, 11, 23]), "metric"] = np.nan  # of blocks of 5 points: 2, 2 and 4
    found = sensitivity(table, "metric", design)
    assert set(zip(found["n"], found["left_out"])) == {(510, 2)}
    assert found["total"].to_numpy() == pytest.approx(list(TOTAL.values()), abs=0.05)


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say():
    hits = np.zeros(2)
    for seed in range(40):
        design = SaltelliDesign(ANGLES, 128, seed)
        row = sensitivity(table_of(design, ishigami, 1), "metric", design, resamples=200).set_index("factor").loc["a"]
        hits += [row["first_low"] < FIRST["a"] < row["first_high"], row["total_low"] < TOTAL["a"] < row["total_high"]]
    assert (hits / 40 > 0.88).all()  # a Sobol sequence errs less than the bootstrap believes


@pytest.mark.filterwarnings("error")
def test_a_metric_that_does_not_vary_has_no_indices():
    design = SaltelliDesign(ANGLES, 8)
    found = sensitivity(table_of(design, lambda **_: 3.0, 1), "metric", design)
    assert found[["first", "total", "total_high"]].isna().all(axis=None)
    assert found["n"].tolist() == [8, 8, 8]


def test_another_design_than_the_tables_is_told():
    design = SaltelliDesign(ANGLES, 8)
    table = table_of(design, ishigami)
    with pytest.raises(ModelError, match="'a' has other values in the table"):
        sensitivity(table, "metric", SaltelliDesign(ANGLES, 8, 1))
    with pytest.raises(ModelError, match="40 points and the design 80"):
        sensitivity(table, "metric", SaltelliDesign(ANGLES, 16))
    with pytest.raises(ModelError, match="give the SaltelliDesign"):
        sensitivity(table, "metric", Grid({"a": [1]}))
    with pytest.raises(UnknownNameError, match="no column 'c'"):
        sensitivity(table.drop(columns="c"), "metric", design)
    with pytest.raises(ModelError, match="0 base points at which 'metric' is known"):
        sensitivity(table.assign(metric=np.nan), "metric", design)
