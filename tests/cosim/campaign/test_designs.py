"""Designs of campaigns: all combinations, lists, and samples that fill ranges as scipy and SALib say."""

import pickle
import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scipy.stats
from SALib.sample import sobol
from scipy.stats import qmc

from bayesftc.cosim import Grid, LatinHypercube, Points, SaltelliDesign, SobolSequence
from bayesftc.cosim.errors import ModelError

RANGES = {"a": (-1.0, 3.0), "n": range(2, 12, 3), "g": scipy.stats.norm(1.0, 2.0), "k": scipy.stats.poisson(3.0)}
SAMPLED = [LatinHypercube(RANGES, 16, 1), SobolSequence(RANGES, 16, 1), SaltelliDesign(RANGES, 4, 1)]


def column(design, name):
    return np.array([point[name] for point in design.points()])


def test_a_grid_has_all_combinations_and_the_last_factor_changes_first():
    thing = object()
    design = Grid({"a": [1, 2], "b": {"none": None, "some": thing}, "c": (0.5,)})
    assert design.points() == [{"a": a, "b": b, "c": 0.5} for a, b in product((1, 2), (None, thing))]
    assert design.labels() == [{"a": a, "b": b, "c": 0.5} for a, b in product((1, 2), ("none", "some"))]
    assert design.factors == ("a", "b", "c")
    assert len(design) == 4


def test_a_value_that_is_no_number_is_called_by_its_text():
    design = Points([{"a": np.float64(0.5), "b": (1, 2)}])
    assert design.labels() == [{"a": 0.5, "b": "(1, 2)"}]
    assert design.points() == [{"a": 0.5, "b": (1, 2)}]


def test_designs_multiply():
    drawn, grid = LatinHypercube({"x": (0, 1)}, 3, 5), Grid({"a": ["one", "two"]})
    both = drawn * grid
    assert both.points() == [{**x, **a} for x in drawn.points() for a in grid.points()]
    assert both.factors == ("x", "a")
    assert len(both * Grid({"b": [1, 2, 3]})) == 18
    with pytest.raises(ModelError, match="both set 'a'"):
        both * grid


@pytest.mark.parametrize("design", SAMPLED, ids=lambda d: type(d).__name__)
@pytest.mark.filterwarnings("error")
def test_samples_lie_in_their_ranges_and_are_the_same_for_a_seed(design):
    points = design.points()
    assert len(points) == len(design)
    assert all(-1 <= p["a"] <= 3 and p["n"] in RANGES["n"] for p in points)
    assert {type(v) for p in points for v in p.values()} == {float, int}
    assert pickle.loads(pickle.dumps(design)).points() == points
    assert replace(design, seed=1).points() == points
    assert replace(design, seed=2).points() != points
    assert design.labels() == points


def test_latin_hypercube_is_scipys():
    unit = qmc.LatinHypercube(d=4, seed=np.random.default_rng(1)).random(16)
    design = SAMPLED[0]
    assert column(design, "a") == pytest.approx(-1 + 4 * unit[:, 0])
    assert column(design, "n").tolist() == [[2, 5, 8, 11][i] for i in (4 * unit[:, 1]).astype(int)]
    assert np.bincount(column(design, "n")).tolist() == [0, 0, 4, 0, 0, 4, 0, 0, 4, 0, 0, 4]  # one in each slice
    assert column(design, "g") == pytest.approx(RANGES["g"].ppf(unit[:, 2]))
    assert column(design, "k").tolist() == RANGES["k"].ppf(unit[:, 3]).tolist()
    assert sorted((16 * unit[:, 0]).astype(int)) == list(range(16))


def test_a_sobol_sequence_fills_better_than_chance_and_grows():
    ranges = {"a": (0, 1), "b": (0, 1)}
    few, more = SobolSequence(ranges, 50, 3), SobolSequence(ranges, 129, 3)
    assert more.points()[:50] == few.points()
    assert len(more) == 129
    unit = np.column_stack([column(more, "a"), column(more, "b")])
    assert (unit[:128] == qmc.Sobol(d=2, seed=np.random.default_rng(3)).random(128)).all()
    assert qmc.discrepancy(unit) < 0.2 * qmc.discrepancy(np.random.default_rng(0).random((129, 2)))
    assert SobolSequence(ranges, 1, 3).points() == few.points()[:1]


@pytest.mark.parametrize("second", [False, True])
def test_saltelli_design_is_salibs(second):
    design = SaltelliDesign({"a": (-1.0, 3.0), "b": (0.0, 1.0)}, 8, 2, second_order=second)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points = sobol.sample(
            {"num_vars": 2, "names": ["a", "b"], "bounds": [[-1.0, 3.0], [0.0, 1.0]]},
            8,
            calc_second_order=second,
            seed=np.random.default_rng(2),
        )
    assert len(design) == len(points) == 8 * (6 if second else 4)
    assert np.column_stack([column(design, "a"), column(design, "b")]) == pytest.approx(points, abs=1e-12)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Grid({}), "give a mapping"),
        (lambda: Grid({"a": 3}), "'a' has the values 3; give a list"),
        (lambda: Grid({"a": "text"}), "give a list"),
        (lambda: Grid({"a": []}), "'a' has no value"),
        (lambda: Grid({"a": [1.0, 2.0, 1]}), "'a' has 1 twice"),
        (lambda: Points([]), "no point"),
        (lambda: Points({"a": [1]}), "a list of mappings"),
        (lambda: Points([{"a": 1}, {"b": 1}]), "Point 1 sets 'b' and point 0 'a'"),
        (lambda: LatinHypercube({"a": (2, 1)}, 5), r"'a' has the range \(2, 1\); low must be below high"),
        (lambda: LatinHypercube({"a": (0, np.inf)}, 5), "both finite"),
        (lambda: LatinHypercube({"a": 3}, 5), "range 3; give"),
        (lambda: LatinHypercube({"a": range(3, 3)}, 5), "is empty"),
        (lambda: LatinHypercube({}, 5), "give a mapping"),
        (lambda: LatinHypercube({"a": (0, 1)}, 0), "count=0"),
        (lambda: LatinHypercube({"a": (0, 1)}, 2.5), "count=2.5"),
        (lambda: SobolSequence({"a": (0, 1)}, 5, -1), "seed=-1"),
        (lambda: SaltelliDesign({"a": (0, 1)}, 24), "count=24.*use 16 or 32"),
        (lambda: LatinHypercube({"a": scipy.stats.norm(0, np.nan)}, 5).points(), "'a' is nan"),
    ],
)
def test_what_cannot_be_a_design_is_told(make, says):
    with pytest.raises(ModelError, match=says):
        make()
