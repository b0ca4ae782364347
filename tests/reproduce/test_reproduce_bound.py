"""The exact posterior's filter against the full tree of hypotheses, and the experiment that measures detectors by it."""

from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest
from scipy import stats

from bayesftc import controllers, cosim, reproduce
from bayesftc.cosim.judging.metrics import auc
from bayesftc.reproduce.experiments.bound import (
    figures as _bound_figures,
    kernels as _bound_kernels,
    tables as _bound_tables,
)
from bayesftc.reproduce.experiments.bound.filter import PosteriorFilter
from bayesftc.reproduce.settings import Bound, Car, Detection
from bayesftc.reproduce.shared import residuals as _residuals
from bayesftc.reproduce.shared.streams import Faults, Streams

OFTEN = Detection(mean_time_to_fault=0.1, mean_time_to_recovery=0.07)
"""A fault every five steps, for as many: so that all that can happen does in a few steps."""
LARGE = Faults(1.5, 40.0)
FAILS, RECOVERS = 0.02 / 0.1, 0.02 / 0.07


def histories(samples):
    """Every history of the modes of one sensor that could have shown these samples, with its probability and its offsets.

    Modes are 0 (healthy), 1 (frozen), 2 (injected), 3 (drifting).
    """
    found = [((), 1.0)]
    for k in range(len(samples)):
        repeats = k > 0 and samples[k] == samples[k - 1]
        longer = []
        for modes, p in found:
            was = modes[-1] if modes else 0
            following = (
                {0: 1 - FAILS, 1: FAILS / 3, 2: FAILS / 3, 3: FAILS / 3}
                if was == 0
                else {0: RECOVERS, was: 1 - RECOVERS}
            )
            longer += [
                ((*modes, mode), p * chance) for mode, chance in following.items() if k == 0 or (mode == 1) == repeats
            ]
        found = longer
    offsets = []
    for modes, _ in found:
        ages = [
            next(i for i in range(k + 1) if k - i == 0 or modes[k - i - 1] != 3) if m == 3 else 0
            for k, m in enumerate(modes)
        ]
        offsets.append([{2: 1.5, 3: 40.0 * 0.02 * age}.get(m, 0.0) for m, age in zip(modes, ages, strict=True)])
    return [m for m, _ in found], np.array([p for _, p in found]), np.array(offsets)


def by_enumeration(y, u, car):
    """The probability of a fault of each sensor after the last step, from the joint density of all samples."""
    steps = len(y)
    a, b = 1 - car.drag / car.mass * car.step, car.step / car.mass
    mean, spread = [OFTEN.offset], [[car.initial_variance]]
    for k in range(1, steps):
        mean.append(a * mean[-1] + b * u[k - 1])
        row = [a * spread[-1][j] for j in range(k)]
        for j in range(k):
            spread[j].append(row[j])
        spread.append([*row, a * a * spread[-1][k - 1] + car.process_variance])
    state = np.array(spread)
    informs = np.array([[k == 0 or y[k, i] != y[k - 1, i] for i in range(2)] for k in range(steps)]).ravel()
    covariance = (np.kron(state, np.ones((2, 2))) + np.eye(2 * steps) * car.sensor_variance)[np.ix_(informs, informs)]
    error = (y - np.array(mean)[:, None]).ravel()
    each = [histories(y[:, i]) for i in range(2)]
    total = np.zeros((2, 2))
    density = stats.multivariate_normal(np.zeros(informs.sum()), covariance)
    for first in range(len(each[0][0])):
        offsets = np.stack([np.broadcast_to(each[0][2][first], each[1][2].shape), each[1][2]], axis=-1)
        rest = (error - offsets.reshape(len(each[1][0]), -1))[:, informs]
        weights = each[0][1][first] * each[1][1] * np.exp(density.logpdf(rest).reshape(-1))
        failed = np.array([modes[-1] > 0 for modes in each[1][0]])
        total[0, int(each[0][0][first][-1] > 0)] += weights.sum()
        total[1] += weights[~failed].sum(), weights[failed].sum()
    return total[:, 1] / total.sum(axis=1)


@cache
def short_stream():
    """Six steps in which sensor 0 freezes at once after a healthy sample, recovers, and sensor 1 jumps."""
    rng = np.random.default_rng(4)
    y = 20.0 + rng.normal(size=(6, 2))
    y[3, 0] = y[2, 0] = y[1, 0]
    y[2:5, 1] += 3.0
    return y, 400.0 * rng.normal(size=6)


def probability(log_odds):
    return 1 / (1 + np.exp(-np.clip(log_odds, -700, 700)))


def test_without_reduction_it_is_the_posterior_of_the_full_tree():
    y, u = short_stream()
    car = Car()
    found = probability(PosteriorFilter(OFTEN, car, LARGE, 60_000, tolerance=0.0).log_odds(y, u))
    wanted = np.array([by_enumeration(y[: k + 1], u, car) for k in range(len(y))])
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    assert wanted[2:4, 0].tolist() == pytest.approx([1, 1])
    assert 0.1 < wanted[:2].min() < wanted[4, 1] < 0.99


def test_merging_and_few_particles_change_it_little():
    y, u = short_stream()
    exact = probability(PosteriorFilter(OFTEN, Car(), LARGE, 60_000, tolerance=0.0).log_odds(y, u))
    merged = probability(PosteriorFilter(OFTEN, Car(), LARGE, 500, tolerance=0.25).log_odds(y, u))
    assert np.abs(merged - exact).max() < 3e-3
    few = [
        probability(PosteriorFilter(OFTEN, Car(), LARGE, 24, tolerance=0.0).log_odds(y, u, seed=s)) for s in range(400)
    ]
    assert 0.002 < np.std(few, axis=0).max() < 0.2
    assert np.abs(np.mean(few, axis=0) - exact).max() < 0.01


def test_resampling_is_unbiased_keeps_the_large_and_makes_no_more_than_its_limit():
    rng = np.random.default_rng(0)
    weights, total = rng.exponential(size=40) ** 3, np.zeros(40)
    for uniform in (np.arange(2_000) + 0.5) / 2_000:
        floats, codes = np.zeros((2, 3, 40)), np.zeros((2, 1, 40), dtype=np.int64)
        floats[0, 1] = np.arange(40)
        count = _bound_kernels.resample(weights, uniform, 9, floats, codes, 0, 40)
        assert count in {8, 9}
        np.add.at(total, floats[1, 1, :count].astype(int), np.exp(floats[1, 0, :count]))
    np.testing.assert_allclose(total / 2_000, weights, atol=weights.sum() / 9 / 2_000)  # one of the draws more or less
    largest = np.argmax(weights)
    assert total[largest] / 2_000 == pytest.approx(weights[largest], rel=1e-12)


def test_compiled_and_interpreted_are_the_same(monkeypatch):
    y, u = short_stream()
    wanted = PosteriorFilter(OFTEN, Car(), LARGE, 30).log_odds(y, u, seed=3)
    monkeypatch.setattr("bayesftc.reproduce.experiments.bound.filter._compiled", lambda: _bound_kernels.track)
    np.testing.assert_allclose(PosteriorFilter(OFTEN, Car(), LARGE, 30).log_odds(y, u, seed=3), wanted, rtol=1e-12)


@pytest.fixture(scope="module")
def streams():
    """The same noise and faults in two loops: of a controller that trusts both sensors, and of one that ignores suspect ones."""
    source = Streams(Detection(steps=5_000), Car())
    faults = Faults(5.0, 10.0, "slow")
    learners = _residuals.PLAIN, controllers.SERFDI()
    return [next(source.run(source.loop(faults, learner), [9], ["fault_1.y", "controller.u"])) for learner in learners]


def test_it_is_calibrated_and_the_same_in_any_loop(streams):
    bound = PosteriorFilter(Detection(), Car(), Faults(5.0, 10.0), 64, tolerance=0.25)
    odds = [bound.log_odds(s.result["fault_1.y"], s.result["controller.u"].ravel()) for s in streams]
    assert not np.allclose(streams[0].result["fault_1.y"], streams[1].result["fault_1.y"], atol=1.0)
    assert np.quantile(np.abs(probability(odds[0]) - probability(odds[1])), 0.99) < 0.02
    found = cosim.reliability(probability(odds[0]), streams[0].faulty)
    assert found.calibration_error < 0.01
    assert found.brier < 0.3 * found.brier_of_constant
    assert auc(streams[0].faulty, odds[0]) > 0.93


def test_a_freeze_is_certain_from_its_first_sample(streams):
    (y, u), kind = (streams[0].result[name] for name in ("fault_1.y", "controller.u")), streams[0].kind
    odds = PosteriorFilter(Detection(), Car(), Faults(5.0, 10.0), 16, tolerance=0.25).log_odds(y, u.ravel())
    assert (odds[1:][kind[1:] == 0] == np.inf).all()
    assert not np.isnan(odds).any()
    assert not np.isposinf(odds[kind < 0]).any()


SMALL = Detection(steps=5_000, forgettings=(0.5,), prior_shapes=(0.1,))
FEW = Bound(cells=((5.0, 2.0), (10.0, 20.0)), particles=16, moves=0.02, choice_streams=2)


def run(jobs=2, settings=FEW):
    return reproduce.bound(seed=3, jobs=jobs, runs=2, settings=settings, detection=SMALL)


@pytest.fixture(scope="module")
def report():
    return run()


@pytest.mark.slow
def test_report_compares_stream_by_stream(report):
    small, large = report["cells"]
    for cell in report["cells"]:
        assert cell["auc"]["bound"]["mean"] > cell["auc"]["SwitchingPrecision"]["mean"] > cell["auc"]["beta"]["mean"]
        for name, of in cell["ratio"].items():
            mine = np.array(cell["streams"][name]) / np.array(cell["streams"]["bound"])
            assert of["mean"] == pytest.approx(mine.mean())
        assert cell["calibration"]["ece"]["mean"] < 0.02
    assert large["auc"]["bound"]["mean"] > small["auc"]["bound"]["mean"] + 0.02
    assert report["particles"] == report["doublings"][-1]["particles"] >= 32
    assert report["moved"] < FEW.moves


@pytest.mark.slow
def test_same_bits_for_any_number_of_jobs(report):
    assert run(jobs=1) == report


def test_tables_and_figure_show_all(report, printed):
    text = printed(_bound_tables.show(report))
    for words in (
        f"has {report['particles']} hypotheses",
        "Injection 10 m/s, drift 20",
        "SwitchingPrecision, default",
        "bound",
    ):
        assert words in text
    axis = _bound_figures.areas(report).axes[0]
    assert next(t.get_text() for t in axis.get_legend().get_texts()).startswith("bound (")
    assert len(axis.containers) == len(report["cells"][0]["auc"])


def test_particles_that_do_not_suffice_and_sensors_that_are_too_many_are_told():
    with pytest.raises(cosim.ModelError, match="Raise most_particles"):
        run(settings=replace(FEW, particles=4, most_particles=4, moves=1e-9, cells=((5.0, 2.0),)))
    with pytest.raises(cosim.ModelError, match="4 sensors"):
        PosteriorFilter(OFTEN, Car(sensors=4), LARGE, 8)
    with pytest.raises(cosim.ModelError, match="have a resolution"):
        PosteriorFilter(OFTEN, Car(resolution=0.1), LARGE, 8)


@pytest.mark.slow
def test_switching_is_close_to_the_bound():
    report = reproduce.bound(seed=0, jobs=2)
    for cell, least in zip(report["cells"], (0.97, 0.98, 0.979, 0.979, 0.98), strict=True):
        assert cell["ratio"]["SwitchingPrecision"]["mean"] > least
        assert cell["calibration"]["ece"]["mean"] < 0.005


def test_offsets_of_the_oracle_are_those_of_the_faults():
    """The tree of hypotheses counts a drift's age from its onset, which is still right, as the fault block does."""
    modes, chances, offsets = histories(np.arange(4.0))
    assert chances.sum() < 1  # a repetition would have been another history
    assert offsets[modes.index((0, 3, 3, 3))].tolist() == pytest.approx([0, 0, 0.8, 1.6])
    assert offsets[modes.index((3, 3, 0, 3))].tolist() == pytest.approx([0, 0.8, 0, 0])
    assert not [m for m in modes if any(a > 0 and b > 0 and a != b for a, b in pairwise(m))]
    assert len(set(modes)) == len(modes) == sum(1 for m in product(range(4), repeat=4) if m in set(modes))
