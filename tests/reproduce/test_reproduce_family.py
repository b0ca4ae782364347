"""The family of faults, small: what its cases are, and its numbers by other ways of computing them."""

import json
import re
from dataclasses import replace
from io import StringIO
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bayesftc import controllers, cosim, reproduce
from bayesftc.controllers.precision.base import keep_nominal
from bayesftc.cosim.errors import ModelError, SimulationError, UnknownNameError
from bayesftc.reproduce.experiments.family import (
    figures as _family_figures,
    page as family_page,
    run as _family,
    tables as _family_tables,
)
from bayesftc.reproduce.experiments.family.cases import CASES, GROUPS, PLANTS, Case
from bayesftc.reproduce.experiments.family.groups import by_group
from bayesftc.reproduce.experiments.family.loop import family_loop, faulty_samples, goal_error, signals_of_goals
from bayesftc.reproduce.experiments.family.unseen import KINDS, unseen_cases
from bayesftc.reproduce.settings import Family, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble

BY_NAME = {case.name: case for case in CASES}
TWO = {"explicit": controllers.ExplicitDetection(), "gamma": controllers.GammaPrecision()}
FEW = ("injection of 5 sd on and off every second", "two at once: freeze, 3 sensors", "healthy")
FIXED = controllers.FixedPrecision()


def small(jobs, **options):
    return reproduce.family(seed=5, jobs=jobs, runs=2, **options)


@pytest.fixture(scope="module")
def report():
    return small(2, cases=FEW, learners=TWO)


def test_the_family_is_as_large_as_it_should_be():
    assert len(BY_NAME) == len(CASES) >= 40
    assert {case.plant for case in CASES} == set(PLANTS)
    assert {PLANTS[name].fmu for name in PLANTS} == {
        "CruiseControl", "PositionServo", "TwoMasses", "CartPendulum", "HydroTurbine", "TwoLinkArm"
    }  # fmt: skip
    learners = _family.all_learners()
    assert {type(learner) for learner in learners.values()} == set(controllers.LEARNERS)
    assert [learner.joint for learner in learners.values() if isinstance(learner, controllers.SwitchingPrecision)] == [
        True,
        False,
    ]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_case_is_a_loop_in_which_the_oracle_misses_the_samples_that_are_wrong(case):
    """Faults and dropouts are blocks of their own names, present in the windows that the judge takes for faulty."""
    plant = PLANTS[case.plant]
    loop, oracle = family_loop(case, FIXED), family_loop(case, FIXED, drop_faulty=True)
    names = [node.name for node in oracle.nodes]
    assert len(set(names)) == len(names)
    time = np.arange(0.0, plant.duration, 0.05)
    truth = faulty_samples(case, time)
    assert truth.shape == (len(time), loop["sensors"].block.count)
    assert truth.any() == bool(case.faults or case.reads)
    assert all(0.0 <= fault.start < plant.duration for fault in case.faults)
    faults = [node.block for node in loop.nodes if isinstance(node.block, cosim.Fault)]
    missing = [node.block for node in oracle.nodes if node.name.startswith("missing")]
    assert len(faults) == len(case.faults)
    for sensor in range(truth.shape[1]):
        own = [f for f in [*faults, *([cosim.Dropout(sensor=s) for s in case.reads])] if f.sensor == sensor]
        for blocks in (own, [d for d in missing if d.sensor == sensor]):
            present = np.any([(b.start <= time) & (time < b.stop) for b in blocks], axis=0) if blocks else False
            assert np.array_equal(truth[:, sensor], np.broadcast_to(present, len(time)))


@pytest.mark.parametrize("name", FEW)
def test_the_controller_of_the_oracle_gets_no_faulty_sample(name):
    case = BY_NAME[name]
    loop = family_loop(case, FIXED, drop_faulty=True)
    result = loop.simulate(9.0, seed=1)
    last = [node.name for node in loop.nodes if isinstance(node.block, cosim.Fault)][-1:] or ["sensors"]
    assert np.array_equal(np.isnan(result[f"{last[0]}.y"]), faulty_samples(case, result.time))


def test_what_is_not_as_believed():
    """Noise, resolution, parameters and wiring of the plant's sensors, and what the controller takes them for."""

    def parts(name):
        loop = family_loop(BY_NAME[name], FIXED)
        blocks = (loop[name].block for name in ("sensors", "controller", "plant"))
        sensors, controller, plant = blocks
        return sensors, np.sqrt(np.diag(controller.model.sensor_covariance)), plant

    sensors, believed, _ = parts("sensors 2 times noisier than believed, freeze")
    assert (sensors.std, believed.tolist()) == ((2.0, 2.0), [1.0, 1.0])
    sensors, believed, _ = parts("unequal noise, healthy")
    assert sensors.std == (1.0, 0.3)
    assert believed == pytest.approx([1.0, 0.3])
    sensors, _, _ = parts("resolution of 1 sd untold, freeze")
    assert sensors.resolution == (1.0, 1.0)
    sensors, believed, _ = parts("masses: sensors of x1 and x2 swapped")
    assert np.array_equal(sensors.matrix, [[0, 1], [1, 0], [1, 0], [0, 1]])
    assert believed == pytest.approx([0.01] * 4)
    _, _, plant = parts("pendulum: cart 40 % heavier than believed, healthy")
    assert plant.parameters == {"M_cart": pytest.approx(0.7)}
    switching = controllers.SwitchingPrecision()
    for name, slower in (("healthy", 1.0), ("turbine: healthy", 2.5)):
        controller = family_loop(BY_NAME[name], switching)["controller"].block
        assert controller.precision.paced(float(controller.model.step)) == switching.slowed(slower)


def test_numbers_are_those_of_the_runs(report):
    """Each run again by itself, alarms counted by hand."""
    for name in FEW:
        case, squares, sizes, false, delays = BY_NAME[name], {}, {}, [], []
        for learner, told in (("gamma", False), ("explicit", False), ("oracle", True)):
            loop = family_loop(case, TWO.get(learner, FIXED), drop_faulty=told)
            results = [loop.simulate(20.0, seed=seed) for seed in (5, 6)]
            errors = [r["plant.v"][1:] - r["reference.y"][:-1] for r in results]
            squares[learner] = np.mean(np.square(errors))
            sizes[learner] = np.sqrt(np.mean(np.square(errors), axis=1))
            for r in results if learner == "explicit" else ():
                alarm, truth = r["controller.detected"] >= 0.5, faulty_samples(case, r.time)
                arrived = ~np.isnan(r["sensors.y"])
                false.append(alarm[~truth & arrived])
                for sensor in range(truth.shape[1]):
                    onsets = np.flatnonzero(np.diff(truth[:, sensor].astype(int), prepend=0) == 1)
                    for onset in onsets:
                        end = onset + np.argmin(np.append(truth[onset:, sensor], False))
                        seen = np.flatnonzero(alarm[onset:end, sensor])
                        delays.append(seen[0] * 0.02 if len(seen) else np.inf)
        cells = report["table"][name]
        for learner in TWO:
            assert cells[learner]["ratio"] == pytest.approx(np.sqrt(squares[learner] / squares["oracle"]), rel=1e-12)
            assert (cells[learner]["n"], cells[learner]["lost"]) == (2, 0)
            assert cells[learner]["above_share"] == np.mean(sizes[learner] > 1.25 * sizes["oracle"])
        assert report["oracle"][name] == pytest.approx(np.sqrt(squares["oracle"]), rel=1e-12)
        entry = cells["explicit"]
        assert entry["false_share"] == pytest.approx(np.concatenate(false).mean(), rel=1e-9)
        assert cells["gamma"]["false_share"] is None
        if delays:
            assert entry["missed_share"] == np.isinf(delays).mean()
            median = np.sort(delays)[(len(delays) - 1) // 2]
            assert entry["delay"] == (pytest.approx(median) if np.isfinite(median) else None)
        else:
            assert entry["missed_share"] is entry["delay"] is None


def test_errors_of_other_plants_count_once_they_have_settled():
    case = BY_NAME["arm: gain of 0.7"]
    result = family_loop(case, FIXED).simulate(0.2, seed=1, engine="interpreted")
    names = ("plant.q1", "plant.q2", "reference_0.y", "reference_1.y")
    assert signals_of_goals(case) == names
    q1, q2, r1, r2 = (result[name] for name in names)
    assert np.array_equal(goal_error(case, result), [q1 - r1, q2 - r2])
    case = BY_NAME["turbine: healthy"]
    result = family_loop(case, FIXED).simulate(11.0, seed=1)
    assert np.array_equal(goal_error(case, result), [(result["plant.power"] - result["reference.y"])[200:]])


def test_the_summary_is_that_of_the_table(report):
    for name, summary in report["summary"].items():
        ratios = {case: cells[name]["ratio"] for case, cells in report["table"].items()}
        assert summary["worst"]["ratio"] == max(ratios.values()) == ratios[summary["worst"]["case"]]
        assert summary["mean"] == pytest.approx(np.prod(list(ratios.values())) ** (1 / 3))
        assert summary["above_the_bar"] == [case for case, ratio in ratios.items() if ratio > 1.25]
        best = {case: min(cell["ratio"] for cell in cells.values()) for case, cells in report["table"].items()}
        assert summary["behind_the_best"] == [case for case in ratios if ratios[case] > best[case] + 0.05]


def gives_up(sample, trust, memory, settings, work):
    if np.abs(sample.e).max() > 1e3:
        raise SimulationError("The learner gives up.")
    keep_nominal(sample, trust, memory, settings, work)


class GivesUp(controllers.PrecisionLearner):
    """A learner of a user's that stops the run where a sample is far from what is expected."""

    def learner(self, model):
        """Return its step function."""
        return controllers.Learner(gives_up, np.zeros(1), np.array([np.nan]))


def test_runs_that_cannot_go_on_are_counted_and_worst(monkeypatch):
    """A gain of a thousand is too much for the learner, which no compiler takes; the oracle does not see that sensor."""

    def interpreted(loop, duration, seeds, record):
        return [loop.simulate(duration, seed=seed, record=record, engine="interpreted") for seed in seeds]

    monkeypatch.setattr(_family, "repeat", interpreted)
    monkeypatch.setattr(Ensemble, "prepare", lambda self, loops: None)
    lost = Case("beyond all bounds", (cosim.GainFault(factor=1e3, start=1.0),))
    made = small(1, cases=[lost], learners={"wild": GivesUp()})
    cell = made["table"]["beyond all bounds"]["wild"]
    assert (cell["lost"], cell["ratio"], cell["n"]) == (2, None, 2)
    assert made["summary"]["wild"]["worst"] == {"case": "beyond all bounds", "ratio": None}
    assert made["summary"]["wild"]["above_the_bar"] == ["beyond all bounds"]
    text = shown(made)
    assert "lost 2*" in text
    _family_figures.ratios(made)
    json.dumps(made, allow_nan=False)


def shown(report):
    console = Console(file=StringIO(), width=120)
    for part in _family_tables.show(report):
        console.print(part)
    return console.file.getvalue()


def test_what_is_printed_and_drawn(report):
    text = " ".join(shown(report).split())
    for name in FEW:
        entry = report["table"][name]["gamma"]["ratio"]
        assert f"{entry:.2f}{'*' * (entry > 1.25)}" in text
        assert name in text
    assert "explicit gamma" in text
    figure = _family_figures.ratios(report)
    values = figure.axes[0].images[0].get_array()
    assert np.allclose(values, [[report["table"][c][n]["ratio"] for n in TWO] for c in FEW_IN_ORDER])
    assert [t.get_text() for t in figure.axes[0].get_yticklabels()] == FEW_IN_ORDER


FEW_IN_ORDER = [case.name for case in CASES if case.name in FEW]


@pytest.mark.parametrize(
    ("group", "cases"),
    {
        "healthy sensors": ["healthy, 5 sensors", "unequal noise, healthy", "arm: healthy"],
        "freezes": ["freeze", "freeze on and off every second", "pendulum: freeze"],
        "offsets and drifts": ["injection of 1 sd", "bias of 3 sd from the first step", "servo: drift of 2 sd per second"],
        "dithers, gains, oscillations": [
            "freeze with dither of 0.3 sd", "gain of 0.7, 3 sensors", "oscillation of 5 sd, period 1 s",
            "reads the negated speed",
        ],
        "noise, spikes, dropout": ["noise 2 times", "dropout", "spikes of 10 sd in 5 % of samples"],
        "filtered, late, clipped, rounded, stuck": [
            "low-pass of 2 s", "delay of 0.5 s", "clips above the mean speed", "stuck at 0",
        ],
        "two sensors at once, or swapped": ["both sensors: freeze", "arm: a sensor of q2 reads q1"],
        "plant not as believed": ["car 40 % heavier than believed, healthy"],
        "noise or resolution not as believed": [
            "sensors 2 times noisier than believed, freeze", "resolution of 1 sd untold, freeze",
        ],
    }.items(),
)  # fmt: skip
def test_each_case_is_in_a_group(group, cases):
    assert group in GROUPS
    assert {BY_NAME[name].group for name in cases} == {group}
    assert {case.group for case in CASES} == set(GROUPS)
    walk = Case("a walk", (cosim.NoiseGrowth(slope=1.0, sensor=0),))
    assert walk.group == "other faults"


def test_groups_are_those_of_the_table(report):
    found = by_group(report)
    assert list(found) == ["healthy sensors", "offsets and drifts", "two sensors at once, or swapped"]
    for case, group in zip(("healthy", *FEW[:2]), found, strict=True):  # each has one case
        for name, figures in found[group].items():
            cell = report["table"][case][name]
            assert figures.mean == pytest.approx(cell["ratio"])
            assert (figures.worst, figures.lost, figures.false_share) == (cell["ratio"], 0, cell["false_share"])
    doubled = {**report, "groups": dict.fromkeys(FEW, "all")}
    ratios = [cells["gamma"]["ratio"] for cells in report["table"].values()]
    assert by_group(doubled)["all"]["gamma"].mean == pytest.approx(report["summary"]["gamma"]["mean"])
    assert by_group(doubled)["all"]["gamma"].worst == max(ratios)


def test_the_page_gets_the_table_between_its_marks(report, tmp_path):
    page, file = tmp_path / "page.md", tmp_path / "family.json"
    file.write_text(json.dumps(report))
    page.write_text(f"before\n{family_page.BEGIN}\nold\n{family_page.END}\nafter\n")
    for _ in range(2):  # a second time changes nothing
        family_page.main([str(file), str(page)])
        text = page.read_text()
    assert text.startswith(f"before\n{family_page.BEGIN}\n2 runs of each of 3 cases, seed 5.\n")
    assert text.endswith(f"{family_page.END}\nafter\n")
    assert "old" not in text
    rows = {line.split(" | ")[0]: line.split(" | ")[1:] for line in text.splitlines() if line.startswith("| `")}
    cell = report["table"]["healthy"]["gamma"]["ratio"]
    assert rows["| `gamma`"][1] == f"{cell:.2f} / {cell:.2f}"
    above = [case for case, cells in report["table"].items() if cells["explicit"]["ratio"] > family_page.BAR]
    assert f"`explicit` is above 1.10 in {len(above)} of 3 cases: " in text
    page.write_text("no marks")
    with pytest.raises(SystemExit, match="lacks the lines"):
        family_page.main([str(file), str(page)])


def test_the_page_on_learners_has_the_familys_marks():
    page = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "which-learner.md"
    text = page.read_text(encoding="utf-8")
    assert text.index(family_page.BEGIN) < text.index(family_page.END)
    measured = set(
        re.findall(r"^\| `([^`]+)` \|", text[text.index(family_page.BEGIN) : text.index(family_page.END)], re.M)
    )
    assert len(measured) >= 10
    assert measured <= set(_family.all_learners())


def test_the_report_is_the_same_for_any_number_of_jobs_and_says_why(report):
    assert small(1, cases=FEW, learners=TWO) == report
    json.dumps(report, allow_nan=False)
    assert list(report["table"]) == FEW_IN_ORDER
    for name in vars(Family()):
        assert len(report["settings"]["why"][name]) > 5


def test_cases_and_learners_are_chosen_by_pattern_or_given():
    assert [case.name for case in _family.chosen_cases("Freeze from*")] == ["freeze from the first step"]
    own = Case("mine", (cosim.Stuck(at=1.0),))
    assert _family.chosen_cases([own]) == [own]
    assert [case.name for case in _family.chosen_cases(["healthy", own])] == ["healthy", "mine"]
    assert _family.chosen_cases(None) == list(CASES)
    assert list(_family.chosen_learners(["ser*", "gamma*"])) == ["GammaPrecision", "SERFDI"]
    assert _family.chosen_learners(TWO) == TWO
    mine = [name for name in _family.chosen_learners(None) if name.startswith("Switching")]
    assert mine == ["SwitchingPrecision", "SwitchingPrecision, per sensor"]


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: reproduce.family(cases=["frezee"]), UnknownNameError, "no case 'frezee'.*did you mean 'freeze'"),
        (lambda: reproduce.family(learners="gama*"), UnknownNameError, "no learner"),
        (lambda: reproduce.family(cases=[]), ModelError, "no case"),
        (lambda: reproduce.family(learners={}), ModelError, "at least one"),
        (lambda: reproduce.family(learners={"mine": 3}), ModelError, "at least one"),
        (lambda: reproduce.family(runs=1), ModelError, "runs is 1"),
        (lambda: reproduce.family(settings=Tracking()), ModelError, "takes Family"),
        (
            lambda: small(1, cases=[Case("light", parameters={"m": 1e-3})], learners=TWO),
            ModelError,
            "oracle loses the plant in the case 'light'",
        ),
        (lambda: reproduce.family(unseen=0), ModelError, "unseen is 0"),
        (lambda: reproduce.family(unseen=2, cases="healthy"), ModelError, "both unseen and cases"),
        (lambda: Family(bar=1.0), ModelError, "bar=1.0"),
        (lambda: Family(oracle_lost=1.0), ModelError, "oracle_lost=1.0"),
        (lambda: Family(behind=-0.1), ModelError, "behind=-0.1"),
        (lambda: Family(tuning_seed=-1), ModelError, "tuning_seed is -1"),
    ],
)
def test_wrong_input_is_a_sentence(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_seeds_for_tuning_and_judging_are_apart():
    settings = Family()
    assert settings.judging_seed + 10 * settings.runs <= settings.tuning_seed


def test_the_command(bayesftc_, tmp_path):
    only = ("--case", "healthy", "--learner", "FixedPrecision", "--runs", 2, "--jobs", 1)
    done = bayesftc_("reproduce", "family", *only, "--out", "here")
    assert done.exit_code == 0, done.output
    assert "of 1 cases" in done.stdout
    report = json.loads((tmp_path / "here" / "family.json").read_text())
    assert report["table"] == {"healthy": {"FixedPrecision": report["table"]["healthy"]["FixedPrecision"]}}
    assert report["table"]["healthy"]["FixedPrecision"]["ratio"] == 1.0
    assert (tmp_path / "here" / "family.png").stat().st_size > 5_000
    refused = bayesftc_("reproduce", "tracking", "--learner", "PL")
    assert refused.exit_code == 9
    assert "tracking has no choice of learners" in refused.stderr


def test_a_changed_case_is_another(report):
    """Cases are data: what is replaced in one is what changes in its loop."""
    case = replace(BY_NAME["injection of 3 sd"], sensors=4)
    assert family_loop(case, FIXED)["sensors"].block.count == 4
    assert faulty_samples(case, np.array([5.98, 6.0, 13.98, 14.0])).sum(axis=1).tolist() == [0, 1, 1, 0]


def test_unseen_cases_are_drawn_once_by_their_seed():
    """The same seed gives the same cases, however many; another seed others; none is a case that has a name."""
    first = list(islice(unseen_cases(7), 300))
    assert first[:5] == list(islice(unseen_cases(7), 5)) != list(islice(unseen_cases(8), 5))
    assert len({case.name for case in first} - set(BY_NAME)) == len(first)
    assert {case.plant for case in first} == set(PLANTS)
    assert {case.sensors for case in first} == {2, 3}
    assert {len(case.faults) for case in first} == {1, 2}
    kinds = {type(fault) for case in first for fault in case.faults}
    assert kinds == set(KINDS)
    for case in first:
        plant = PLANTS[case.plant]
        assert len({fault.sensor for fault in case.faults}) == len(case.faults)
        for fault in case.faults:
            assert fault.sensor < case.sensors * len(plant.measured)
            assert isinstance(fault, cosim.Bias) or plant.settled <= fault.start <= 0.8 * plant.duration
            assert 0.05 * plant.duration <= 1.01 * (fault.stop - fault.start) <= 1.01 * 0.81 * plant.duration


def test_sizes_of_unseen_cases_are_in_the_sensors_own_units():
    sizes = [
        abs(fault.magnitude) / PLANTS[case.plant].std[fault.sensor % len(PLANTS[case.plant].std)]
        for case in islice(unseen_cases(7), 1000)
        for fault in case.faults
        if isinstance(fault, cosim.Bias)
    ]
    assert len(sizes) > 50
    assert 0.49 < min(sizes) < 1.0
    assert 15.0 < max(sizes) < 30.1


@pytest.mark.slow
def test_an_unseen_case_in_which_the_oracle_loses_the_plant_is_drawn_again(monkeypatch):
    """Of a car both whose sensors are silent for ten seconds nobody knows anything; the next one takes its place."""
    blind = Case("blind", tuple(cosim.Dropout(sensor=i, start=2.0, stop=18.0) for i in (0, 1)))
    fine, more = Case("fine", (cosim.Freeze(start=6.0, stop=8.0),)), Case("more", (cosim.Stuck(at=0.0, start=9.0),))
    monkeypatch.setattr(_family, "unseen_cases", lambda seed: iter([blind, fine, more]))
    strict = replace(Family(), oracle_lost=1.5)
    made = small(1, unseen=2, learners=TWO, settings=strict)
    assert list(made["table"]) == ["fine", "more"]
    assert list(made["settings"]["cases"]) == ["fine", "more"]
