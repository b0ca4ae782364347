"""The tracking experiment, small: what it computes, by other ways of computing it."""

import time
from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim, reproduce
from bayesftc.cosim.campaign.designs.seeds import hashed_seeds
from bayesftc.cosim.random import numbers
from bayesftc.reproduce import paper
from bayesftc.reproduce.experiments.detection import filterpy
from bayesftc.reproduce.experiments.tracking import (
    bench as _tracking_bench,
    figures as _tracking_figures,
    tables as _tracking_tables,
)
from bayesftc.reproduce.experiments.tracking.oracle import over_oracle
from bayesftc.reproduce.settings import Car, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble, chunks

FOUR = ("EF-FDI", "No FT", "PL", "SER FT")


CELLS = (("healthy", 0.0, 1.005), ("injection", 3.0, 1.0), ("drift", 2.0, 100.0))
"""Faults with the errors over the oracle's that are aimed at."""


SMALL = {
    "runs": 30,
    "injections": (10.0,),
    "drifts": (),
    "effdi_durations": (8.0,),
    "oracle_factor": 2,
    "oracle_cells": CELLS,
    "filterpy_runs": 2,
}


class Twin(controllers.GammaPrecision):
    """A further learner whose step function is compiled already."""


TRACK = filterpy.track


def track_sines(bench, ours):
    """Track by filterpy, which takes a thousand times as long, on one of the three references only."""
    return TRACK(bench, {scenario: errors for scenario, errors in ours.items() if scenario.reference == "sine"})


def run(seed, jobs):
    """Return the report of few runs with one further learner, a grid of two sizes and two durations, and three bars."""
    settings = Tracking(**SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(controllers, "LEARNERS", (Twin,))
        patch.setattr(filterpy, "track", track_sines)
        return reproduce.tracking(seed=seed, jobs=jobs, settings=settings)


@pytest.fixture(scope="module")
def report():
    return run(seed=3, jobs=2)


def without_speed(report):
    return {key: value for key, value in report.items() if key != "speed"}


@pytest.mark.slow
def test_report_has_what_the_file_promises(report):
    kinds = {f"{f}/{r}" for f in ("freeze", "injection", "drift") for r in ("constant", "ramp", "sine")}
    assert {"settings", "scenarios", "merit", "total_merit", "oracle", "over_oracle", "paper", "speed", "grid"} <= set(
        report
    )
    assert set(report["scenarios"]) == set(report["oracle"]) == kinds
    for techniques in report["scenarios"].values():
        assert tuple(techniques) == (*FOUR, "Twin")
        for cell in techniques.values():
            assert set(cell) == {"rmse_mean", "rmse_sd", "n"}
            assert cell["n"] == 30
            assert 0.1 < cell["rmse_mean"] < 10
    assert report["speed"]["steps"] == 4 * 9 * 30 * 1000


def assert_filterpy_tracks_as_ours(cells):
    for cell in cells.values():
        assert cell["filterpy"] == pytest.approx(cell["ours"], rel=1e-9)
        assert cell["largest_difference"] < 1e-9


def test_filterpy_in_the_loop_tracks_as_the_compiled_baseline_does(report):
    theirs = report["filterpy"]
    assert theirs["runs"] == SMALL["filterpy_runs"]
    assert theirs["scenarios"].keys() == {"freeze/sine", "injection/sine", "drift/sine"}
    assert_filterpy_tracks_as_ours(theirs["scenarios"])
    settings = Tracking(runs=3)
    bench = _tracking_bench.Bench(settings, Car(), Ensemble(3))
    scenario = _tracking_bench.Scenario("drift", "sine", settings.drift)
    errors = bench.measure("x", [scenario], {"SER FT": controllers.SERFDI()}).errors()[scenario]["SER FT"]
    assert theirs["scenarios"]["drift/sine"]["filterpy"] == pytest.approx(errors[:2].mean(), rel=1e-9)


@pytest.mark.slow
def test_filterpy_tracks_so_in_every_scenario():
    report = reproduce.tracking(seed=3, jobs=2, settings=Tracking(**SMALL), beyond=False)
    assert report["filterpy"]["scenarios"].keys() == report["scenarios"].keys()
    assert_filterpy_tracks_as_ours(report["filterpy"]["scenarios"])


def test_settings_in_the_report_are_those_of_the_objects_with_a_reason_for_each(report):
    settings = report["settings"]
    for name, value in vars(Tracking()).items():
        assert (settings[name] == (list(value) if isinstance(value, tuple) else value)) != (
            name in SMALL
        ) or name == "oracle_cells"
        assert len(settings["why"][name]) > 5
    assert settings["car"]["drag"] == Car().drag
    assert "forgetting=0.95" in settings["techniques"]["PL"]


@pytest.mark.slow
def test_same_bits_for_any_number_of_jobs(report):
    assert without_speed(run(seed=3, jobs=1)) == without_speed(report)


@pytest.mark.slow
def test_another_seed_is_other_noise_and_the_papers_part_is_the_same_alone(report):
    other = reproduce.tracking(seed=4, jobs=2, runs=30, beyond=False)
    assert other["scenarios"].keys() == report["scenarios"].keys()
    assert other["scenarios"]["injection/sine"]["PL"] != report["scenarios"]["injection/sine"]["PL"]
    alone = reproduce.tracking(seed=3, jobs=2, runs=30, beyond=False)
    assert alone["grid"] is alone["over_oracle"] is None
    for name in ("merit", "total_merit", "oracle"):
        assert alone[name] == report[name]
    assert alone["scenarios"] == {k: {n: c[n] for n in FOUR} for k, c in report["scenarios"].items()}
    assert set(report["mean_absolute_error"]) == {*FOUR, "Twin", "oracle"}
    for name, curve in alone["mean_absolute_error"].items():
        assert curve == report["mean_absolute_error"][name]


def test_merit_is_antisymmetric_and_its_columns_add_up(report):
    for table, sums in ((report["merit"], report["total_merit"]), (paper.MERIT, paper.TOTAL_MERIT)):
        for a in FOUR:
            assert sums[a] == sum(table[row][a] for row in FOUR)
            for b in FOUR:
                assert table[a][b] == -table[b][a]
                assert abs(table[a][b]) <= 9


def test_knowing_the_faulty_sensor_is_never_worse(report):
    for kind, techniques in report["scenarios"].items():
        best = min(cell["rmse_mean"] for cell in techniques.values())
        assert report["oracle"][kind]["rmse_mean"] < best


def test_oracle_is_as_good_as_one_kalman_filter_says(report):
    """Between the steady error with two sensors and with one: deadbeat control leaves a P + Q of the belief and the noise."""

    def steady(sensors):
        P = 1.0
        for _ in range(10_000):
            predicted = 0.999**2 * P + 0.001
            P = predicted / (1 + sensors * predicted)
        return np.sqrt(0.999**2 * P + 0.001)

    for cell in report["oracle"].values():
        assert steady(2) < cell["rmse_mean"] < 1.1 * steady(1)


def test_errors_over_the_oracles_are_of_all_runs_on_the_same_noise(report):
    """The runs again: the others' share the oracle's first ones; with healthy sensors the oracle is fixed precision."""
    cells = report["over_oracle"]["cells"]
    assert set(cells) == {
        f"{fault}/{r}" for fault in ("healthy", "injection 3", "drift 2") for r in ("constant", "ramp", "sine")
    }
    for reference in ("constant", "ramp", "sine"):
        healthy = cells[f"healthy/{reference}"]
        assert healthy["bar"] == 1.005
        assert healthy["ratio"]["No FT"] == {"ratio": 1.0, "ratio_ci": [1.0, 1.0], "n": 30}
        squares = {
            name: cell["rmse_mean"] ** 2 + cell["rmse_sd"] ** 2 * 29 / 30
            for name, cell in report["scenarios"][f"injection/{reference}"].items()
        }
        cell = cells[f"injection 3/{reference}"]
        for name in (*FOUR, "Twin"):
            low, high = cell["ratio"][name]["ratio_ci"]
            assert low < cell["ratio"][name]["ratio"] < high
            expected = np.sqrt(squares[name] / squares["PL"])
            assert cell["ratio"][name]["ratio"] / cell["ratio"]["PL"]["ratio"] == pytest.approx(expected, rel=1e-9)


def test_chosen_techniques_and_the_oracle_make_more_runs():
    settings = Tracking(runs=2, duration=2.0, fault_start=0.4, fault_stop=2.0, oracle_factor=2, oracle_cells=CELLS)
    bench = _tracking_bench.Bench(settings, Car(), Ensemble(3))
    known = {"No FT": controllers.FixedPrecision(), "often": controllers.FixedPrecision()}
    for cell in over_oracle(bench, known, ["often"])["cells"].values():
        assert [cell["ratio"][name]["n"] for name in known] == [2, 4]
        assert 0.0 < cell["oracle"] < 5.0


def test_tables_say_which_aims_are_missed(printed):
    def cell(bar, ratio):
        return {"bar": bar, "ratio": {"Twin": {"ratio": 9.0, "ratio_ci": [8.0, 10.0], "n": 3},
                                      "ours": {"ratio": ratio, "ratio_ci": [ratio - 0.2, ratio + 0.4], "n": 6}}}  # fmt: skip

    cells = {f"{fault}/{r}": cell(1.1, 1.0) for fault in ("freeze", "drift 2") for r in ("constant", "sine")}
    text = printed(_tracking_tables.show_oracle(cells))
    assert "ours meets the target in all 4 cells." in text
    assert "1.000 ± 0.3" in text
    assert "9.00" in text
    text = printed(_tracking_tables.show_oracle(cells | {"drift 2/sine": cell(1.1, 1.2)}))
    assert "ours meets the target in 3 of 4 cells and misses it on drift 2/sine (1.2 for 1.1)." in text


def test_an_error_is_the_root_mean_square_of_a_run_by_hand():
    """The first run of a scenario again, with a Kalman filter and deadbeat control written out."""
    settings = replace(Tracking(), runs=2)
    bench = _tracking_bench.Bench(settings, Car(), Ensemble(3))
    learner = controllers.FixedPrecision()
    scenario = _tracking_bench.Scenario("injection", "sine", settings.injection)
    error = bench.measure("x", [scenario], {"No FT": learner}).runs[scenario]["No FT"].rmse[0]
    seed = hashed_seeds(3, "injection/sine", 1)[0]
    q = np.sqrt(1e-3) * numbers(seed, "disturbance_noise.noise", 1001)
    eta = [numbers(seed, "sensors.noise", 1001, channel=i) for i in range(2)]
    v, mean, P, errors = 20.0, 20.0, 1.0, []
    for k in range(1000):
        goal = 20 + 5 * np.sin(2 * np.pi * k * 0.02 / 8)
        y = [v + eta[0][k] + (3.0 if 300 <= k < 700 else 0.0), v + eta[1][k]]
        weight = 1 / P + 2.0
        belief = (mean / P + y[0] + y[1]) / weight
        u = (goal - 0.999 * belief) / 2e-4
        v = 0.999 * v + 2e-4 * u + q[k]
        mean, P = 0.999 * belief + 2e-4 * u, 0.999**2 / weight + 1e-3
        errors.append(v - goal)
    assert error == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)


def test_seeds_of_two_purposes_never_meet():
    drawn = [s for purpose in ("a", "b", "c") for seed in (0, 1) for s in hashed_seeds(seed, purpose, 500)]
    assert len(set(drawn)) == len(drawn)
    assert hashed_seeds(0, "a", 5) == hashed_seeds(0, "a", 9)[:5]
    assert all(0 <= s < 2**63 for s in drawn)


def test_tasks_keep_their_places_and_an_error_ends_the_work():
    assert Ensemble(0, 4).run([lambda i=i: i * i for i in range(20)], "Squares") == [i * i for i in range(20)]
    assert chunks(list(range(7)), 3) == [[0, 1, 2], [3, 4, 5], [6]]
    begun = []

    def fail():
        raise ValueError("broken")

    def wait():
        begun.append(1)
        time.sleep(0.01)

    with pytest.raises(ValueError, match="broken"):
        Ensemble(0, 2).run([fail] + [wait] * 1000, "Waiting")
    assert len(begun) < 1000


def test_threshold_of_effdi_is_its_quantile_without_fault():
    rng = np.random.default_rng(0)
    y = rng.normal(size=4_000_000)
    r = np.abs(y[2:] - 2 * y[1:-1] + y[:-2])
    statistic = r[2:] + r[1:-1] + r[:-2]
    assert np.quantile(statistic, 0.999) == pytest.approx(Tracking().effdi_threshold, abs=0.05)


@pytest.mark.parametrize(
    "wrong",
    [{"jobs": 0}, {"jobs": 1.5}, {"jobs": True}, {"runs": 1}, {"runs": "many"}, {"seed": -1}, {"seed": 0.5}],
    ids=str,
)
@pytest.mark.parametrize("experiment", reproduce.__all__)
def test_numbers_that_cannot_be(experiment, wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(cosim.ModelError, match=rf"{name} is {value!r}[;.] [Ii]t must be"):
        getattr(reproduce, experiment)(**wrong)


@pytest.mark.slow
def test_headline_is_the_papers_order_and_switching_precision_is_as_good_as_the_oracle():
    report = reproduce.tracking(seed=0, jobs=2, settings=Tracking(oracle_factor=5))
    merits = report["total_merit"]
    assert merits["PL"] == max(merits.values()) >= paper.TOTAL_MERIT["PL"]
    assert sorted(merits, key=merits.get)[-2] == "SER FT"
    assert max(merits["EF-FDI"], merits["No FT"]) < 0
    assert len(report["grid"]["tables"]) == 5 * 4 * 3
    assert sum(report["merit_of_all"][name]["SwitchingPrecision"] for name in ("EF-FDI", "No FT", "SER FT")) == 27
    assert len(report["over_oracle"]["cells"]) == 8 * 3
    for cell in report["over_oracle"]["cells"].values():
        assert cell["ratio"]["SwitchingPrecision"]["ratio_ci"][0] <= cell["bar"]
    assert {c.__name__ for c in controllers.LEARNERS} - set(report["scenarios"]["freeze/sine"]) == {
        "FixedPrecision", "GammaPrecision", "EFFDI", "SERFDI",
    }  # fmt: skip


def test_grid_has_a_table_for_each_pair_of_sizes_and_duration_and_agrees_with_the_headline(report):
    grid = report["grid"]
    tables = {(t["injection"], t["drift"], t["effdi_duration"]): t for t in grid["tables"]}
    assert set(tables) == {(i, 2.0, d) for i in (3.0, 10.0) for d in (0.4, 8.0)}
    assert tables[3.0, 2.0, 0.4]["merit"] == report["merit"]
    assert grid["scenarios"]["injection 3/sine"]["PL"] == report["scenarios"]["injection/sine"]["PL"]
    # A sensor that is 10 m/s off is ignored for the whole fault by the one, and trusted again at once by the other.
    far = grid["scenarios"]["injection 10/sine"]
    assert far["EF-FDI 8 s"]["rmse_mean"] < far["EF-FDI"]["rmse_mean"]


def test_tables_fit_a_terminal_and_say_what_is_not_as_in_the_paper(report, printed):
    text = printed(_tracking_tables.show(report))
    for row in (
        "total merit",
        "freeze/constant",
        "Twin",
        "injection     drift 2",
        "PL : SER FT",
        "million closed-loop steps",
    ):
        assert row in text
    changed = {
        **report,
        "total_merit": {"EF-FDI": -17, "No FT": -11, "PL": 21, "SER FT": 7},
        "total_merit_of_all": {"EF-FDI": -20, "No FT": -10, "PL": 5, "SER FT": 0, "Twin": 25},
        "lost": {"freeze/sine": ["No FT", "Twin"]},
        "grid": {
            **report["grid"],
            "tables": [{**t, "total_merit": dict.fromkeys(FOUR, 0)} for t in report["grid"]["tables"]],
        },
    }
    text = printed(_tracking_tables.show(changed))
    assert "EF-FDI (-17) and No FT (-11) are in the reverse order of the paper's (-10 and -22)." in text
    assert "total merits are Twin 25, PL 5, SER FT 0, No FT -10 and EF-FDI -20. Twin is ahead of PL." in text
    assert "PL) tracks significantly worse on freeze/sine than No FT." in text
    assert "significantly better than PL in some of the 9 scenarios: Twin in 1." in text
    assert "PL has the highest total merit in all 4 tables" in text
    changed["total_merit"] = paper.TOTAL_MERIT
    changed["grid"]["tables"][0]["total_merit"] = {"EF-FDI": 0, "No FT": 0, "PL": 1, "SER FT": 2}
    text = printed(_tracking_tables.show(changed))
    assert "reverse order" not in text
    assert "in 1 of the 4 tables" in text
    assert "1 : 2 *" in text
    assert "* SER FT ahead of PL." in text


def test_figures_show_every_technique(report):
    figures = {name: draw(report) for name, draw in _tracking_figures.FIGURES.items()}
    (axis,) = figures["tracking_error_over_time"].axes
    colours = {line.get_label(): line.get_color() for line in axis.lines}
    assert set(colours) == {*FOUR, "Twin", "oracle"}
    assert len(set(colours.values())) == 6
    legend = [text.get_text() for text in axis.get_legend().get_texts()]
    assert {*FOUR, "oracle", "fault", "Twin"} < set(legend)
    cells = [text.get_text() for text in figures["tracking_errors"].axes[0].texts]
    assert cells[0] == f"{report['scenarios']['freeze/constant']['EF-FDI']['rmse_mean']:.2f}"
    assert len(cells) == 6 * 9
    assert len(figures["tracking_grid"].axes[0].texts) == 5 * (3 + 2 * 3 + 3)
    assert _tracking_figures.grid({**report, "grid": None}) is None
