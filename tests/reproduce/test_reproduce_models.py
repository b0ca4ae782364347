"""Wrong models, small: what the experiment computes, by other ways of computing it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus, reproduce
from bayesftc.cosim.campaign.designs.seeds import hashed_seeds
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.alarms import judge_alarms
from bayesftc.cosim.random import numbers
from bayesftc.reproduce.experiments.models import figures as _models_figures, run as _models, tables as _models_tables
from bayesftc.reproduce.experiments.models.car import RIGHT, UNKNOWN_LIMIT, TrueCar, believed, conditions
from bayesftc.reproduce.experiments.tracking.run import techniques
from bayesftc.reproduce.settings import Car, Models, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble

SMALL = Models(runs=2, healthy_factor=2, threshold_runs=4, alarms_per_hour=60.0, unmodelled_times=(8.0,))
TWO = {"No FT": controllers.FixedPrecision(), "PL": controllers.GammaPrecision(forgetting=0.95, prior_shape=2.0)}


def small(jobs):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_models, "learners", lambda beyond: TWO)
        return _models.run(seed=3, jobs=jobs, settings=SMALL)


@pytest.fixture(scope="module")
def report():
    return small(2)


@pytest.fixture(scope="module")
def bench():
    car = Car()
    return _models._Bench(SMALL, car, Ensemble(3), conditions(SMALL, car), believed(SMALL, car))


def test_the_car_is_the_fmu_unless_it_is_said_to_be_another(same_bits):
    def run(plant):
        diagram = cosim.Diagram(dt=0.02)
        car = diagram.add(plant, "car")
        diagram.connect(diagram.add(cosim.Sine(300.0, 3.0, offset=50.0), "force")["y"], car["force"])
        diagram.connect(diagram.add(cosim.Gaussian(0.03), "noise")["y"], car["disturbance"])
        return diagram.simulate(4.0, seed=2, engine="interpreted")["car.v"]

    fmu = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 12.0, "m": 80.0, "b": 4.0})
    same_bits(run(TrueCar(12.0, mass=80.0, drag=4.0)), run(fmu))
    other = TrueCar(12.0, mass=80.0, drag=4.0, quadratic_drag=0.3, slope=0.1, force_limit=200.0)
    time = np.arange(201) * 0.02
    force = np.clip(300.0 * np.sin(2 * np.pi * time / 3.0) + 50.0, -200.0, 200.0)
    noise, v = 0.03 * numbers(2, "noise.noise", 201), [12.0]
    for f, q in zip(force[:-1], noise, strict=False):  # Newton's law, Euler's step
        forces = f - 4.0 * v[-1] - 0.3 * v[-1] ** 2 * np.sign(v[-1]) - 80.0 * 9.81 * 0.1 / np.hypot(1.0, 0.1)
        v.append(v[-1] + 0.02 * forces / 80.0 + q)
    np.testing.assert_allclose(run(other), v, rtol=1e-12)


def test_every_condition_differs_in_what_it_says(bench):
    """The loop's blocks are those of the right one but for the plant, the sensors or the controller."""
    loops = {name: bench.loop("as it is", name, TWO["No FT"]) for name in bench.conditions}
    right = loops[RIGHT]["plant"].block
    differs = {
        "mass up": {"mass": 140.0},
        "mass down": {"mass": 60.0},
        "drag": {"quadratic_drag": 0.4},
        "hill": {"slope": 0.05},
        "lag": {"lag": 0.5},
        "late": {"delay": 10},
        "sat.": {"force_limit": 400.0},
        "sat. told": {"force_limit": 400.0},
    }
    for name, loop in loops.items():
        assert loop["plant"].block == replace(right, **differs.get(name, {}))
        assert loop["sensors"].block.std == {"sd up": 2.0, "sd down": 0.5}.get(name, 1.0)
        assert float(loop["controller"].block.u_max[0]) == (400.0 if name == "sat. told" else np.inf)
    worn = loops["worn"].simulate(20.0, seed=4)
    noise = worn["noise_growth_1.y"] - worn["plant.v"][:, None]
    assert noise[:250].std() == pytest.approx(
        np.sqrt(1 + 8 / 3 / 16), rel=0.1
    )  # the mean of (t / T)^2 over its first quarter
    assert noise[900:].std() == pytest.approx(np.sqrt(1 + 8 * 0.95**2), rel=0.1)


def test_an_error_by_hand(bench):
    """The first run of a cell again: Newton's law, a Kalman filter that knows of no quadratic drag, and deadbeat control."""
    cell = _models.Cell("as it is", "drag", "injection", "No FT")
    error = bench.measure("x", [cell], TWO, {})[cell].rmse[0]
    seed = hashed_seeds(3, "models/injection", 1)[0]
    q = np.sqrt(1e-3) * numbers(seed, "disturbance_noise.noise", 1001)
    noise = np.column_stack([numbers(seed, "sensors.noise", 1001, channel=i) for i in range(2)])
    time = np.arange(1001) * 0.02
    goal = 20.0 + 5.0 * np.sin(2 * np.pi * time / 8.0)
    v, x, P, u, errors = 20.0, 20.0, 1.0, None, []
    for k in range(1000):
        y = v + noise[k] + np.where((time[k] >= 6.0) & (time[k] < 14.0), [3.0, 0.0], 0.0)
        if u is not None:
            x, P = 0.999 * x + 2e-4 * u, 0.999**2 * P + 1e-3
        gain = P / (1.0 + 2.0 * P)
        x, P = x + gain * (y - x).sum(), P / (1.0 + 2.0 * P)
        u = (goal[k] - 0.999 * x) / 2e-4
        v = v + 0.02 / 100.0 * (u - 5.0 * v - 0.4 * v * abs(v)) + q[k]
        errors.append(v - goal[k])
    assert error == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)


def test_report_has_what_the_file_promises(report):
    names = list(report["settings"]["conditions"])
    assert names[0] == RIGHT
    assert UNKNOWN_LIMIT in names
    for model in ("as it is", "with disturbance"):
        assert list(report["errors"][model]) == list(report["oracle"][model]) == names
        for cells in report["errors"][model].values():
            assert set(cells) == set(TWO)
            for cell in cells.values():
                assert set(cell) == {"healthy", "freeze", "injection", "drift"}
                for entry in cell.values():
                    assert entry["ratio_ci"][0] <= entry["ratio"] <= entry["ratio_ci"][1]
                assert (cell["healthy"]["n"], cell["drift"]["n"]) == (4, 2)
            assert cells["No FT"]["healthy"]["ratio"] == 1.0
            assert cells["No FT"]["healthy"]["alarms"] is None
            assert cells["PL"]["healthy"]["actuator_alarms"] is None
            assert cells["PL"]["healthy"]["alarms"]["fault_free_hours"] == pytest.approx(4 * 2 * 20.02 / 3600)
    assert list(report["grid"]) == ["8"]
    for name in vars(SMALL):
        assert len(report["settings"]["why"][name]) > 5
    json.dumps(report, allow_nan=False)


def test_ratios_are_those_of_the_errors(report):
    for model, of in report["errors"].items():
        for condition, cells in of.items():
            fixed, learner = cells["No FT"]["healthy"]["rmse_mean"], cells["PL"]["healthy"]
            assert learner["ratio"] == pytest.approx(learner["rmse_mean"] / fixed)
            above = learner["ratio"] > 1.1
            assert (condition in report["above_the_bar"][model].get("PL", [])) == above
            for case, oracle in report["oracle"][model][condition].items():
                assert cells["PL"][case]["ratio"] == pytest.approx(cells["PL"][case]["rmse_mean"] / oracle)


def test_what_is_told_helps(report):
    """A limit that the controller knows of, and a load that it estimates, cost less than one of which it knows nothing."""
    plain, estimated = (
        {c: cells["No FT"]["healthy"]["rmse_mean"] for c, cells in report["errors"][m].items()}
        for m in ("as it is", "with disturbance")
    )
    assert plain["sat. told"] < plain["sat."]
    assert estimated["sat. told"] < estimated["sat."]
    assert estimated["drag"] < 0.5 * plain["drag"]
    assert plain[RIGHT] < estimated[RIGHT]  # what there is to be paid for it


@pytest.mark.slow
def test_same_bits_for_any_number_of_jobs(report):
    assert small(1) == report


def test_thresholds_allow_as_many_alarms_as_they_should(bench):
    """On the very runs that set it, a threshold has no more; a little below, it has."""
    found = bench.detectors(TWO)
    assert found["as it is", "No FT"] is None
    detector = found["as it is", "PL"]
    loop = bench.loop("as it is", RIGHT, TWO["PL"])
    own = hashed_seeds(3, "models/thresholds", 4)
    precision = [loop.simulate(20.0, seed=s, record=["controller.precision"])["controller.precision"] for s in own]

    def alarms(threshold):
        return sum(judge_alarms(-p, p < 0, threshold=threshold, step=0.02).false_alarms for p in precision)

    allowed = 60.0 * 4 * 2 * 20.02 / 3600
    assert alarms(detector.threshold) <= allowed < alarms(np.nextafter(detector.threshold, -np.inf))


@pytest.mark.slow
def test_the_actuator_is_blamed_where_it_does_less_than_it_is_told(bench):
    """And sensors are not: a learner with modes of the actuator tells a limit that the controller does not know of."""
    learner = _models.learners(True)["SwitchingPrecision, actuator modes"]
    shares = {}
    for condition in (RIGHT, UNKNOWN_LIMIT):
        loop = bench.loop("with disturbance", condition, learner)
        result = loop.simulate(8.0, seed=1)
        sensors = _models._judged([result], _models._own_detector(learner, bench.models["with disturbance"]))
        actuator = _models._judged([result], _models.ACTUATOR)
        shares[condition] = actuator.false_share, sensors.false_share
        assert sensors.hours == 2 * actuator.hours  # two sensors, one actuator
    assert shares[RIGHT] == (0.0, 0.0)
    assert shares[UNKNOWN_LIMIT][0] > 0.5
    assert shares[UNKNOWN_LIMIT][1] < 0.01


def test_what_counts_as_an_alarm():
    model = believed(SMALL, Car())["as it is"]
    found = {name: _models._own_detector(learner, model) for name, learner in techniques(Tracking()).items()}
    assert found.pop("No FT") is None
    signals = {name: detector.signal for name, detector in found.items()}
    for name in ("EF-FDI", "SER FT", "SwitchingPrecision"):
        assert signals[name] == "fault_probability"
    assert signals["ExplicitDetection"] == "detected"
    for name in ("PL", "PointMassPrecision", "WishartPrecision", "VariationalBayesKF"):
        assert signals[name] == "precision"


def test_false_alarms_are_those_of_the_precision(bench):
    """Of the runs of one cell, from the recorded precision."""
    detector = _models.Detector("precision", -0.7)
    cell = _models.Cell("as it is", "drag", "healthy", "PL")
    alarms = bench.measure("x", [cell], TWO, {("as it is", "PL"): detector})[cell].alarms
    loop, begins, share = bench.loop("as it is", "drag", TWO["PL"]), 0, []
    for seed in hashed_seeds(3, "models/healthy", 4):
        low = loop.simulate(20.0, seed=seed, record=["controller.precision"])["controller.precision"] <= 0.7
        begins += int(low[0].sum() + (low[1:] & ~low[:-1]).sum())
        share.append(low.mean())
    assert alarms.false_alarms == begins > 0
    assert alarms.false_share == pytest.approx(np.mean(share))


def with_all_techniques(report):
    """The same report with the names of all techniques, whose cells are those of the two, and some of their own."""
    names = list(_models.learners(True))

    def widened(cells):
        return {name: cells["No FT" if name == "No FT" else "PL"] for name in names}

    return report | {
        "errors": {m: {c: widened(cells) for c, cells in of.items()} for m, of in report["errors"].items()},
        "grid": {t: {c: widened(cells) for c, cells in of.items()} for t, of in report["grid"].items()},
    }


def test_tables_fit_a_terminal_and_say_what_is_above_the_bar(report, printed):
    text = printed(_models_tables.show(with_all_techniques(report)))
    for words in (
        "the mass is 1.4 times",
        "false alarms per hour",
        "the worst of freeze (f), injection (i) and drift (d)",
    ):
        assert words in text.replace("\n", " ")
    for model, worse in report["above_the_bar"].items():
        for name, where in worse.items():
            assert f"{name} ({', '.join(where)})" in text, model
    assert "32 N" not in text
    assert "8 N" in text


@pytest.mark.slow
def test_figures_show_each_case_and_model(report):
    for name, panels in (("models_healthy", 2), ("models_failed", 6)):
        figure = _models_figures.FIGURES[name](report)
        images = [image for axis in figure.axes for image in axis.images]
        assert len(images) == panels
        assert images[0].get_array().shape == (2, len(report["settings"]["conditions"]))
        figure.savefig("/dev/null", format="png", dpi=40)
    shown = _models_figures.FIGURES["models_healthy"](report).axes[0].images[0].get_array()
    assert shown[1, 3] == pytest.approx(report["errors"]["as it is"]["drag"]["PL"]["healthy"]["ratio"])


@pytest.mark.slow
def test_the_papers_techniques_alone():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_models, "PAPERS", ("No FT", "PL"))
        alone = reproduce.models(seed=3, jobs=2, settings=SMALL, beyond=False)
    assert alone["grid"] is None
    assert list(alone["settings"]["techniques"]) == ["No FT", "PL"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Models(runs=1), "runs is 1"),
        (lambda: Models(healthy_factor=0), "healthy_factor is 0"),
        (lambda: Models(force_limit=-1.0), "force_limit=-1.0"),
        (lambda: Models(ageing=0.5), "ageing=0.5"),
        (lambda: reproduce.models(settings=Tracking()), "This experiment takes Models"),
    ],
)
def test_wrong_settings_are_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()


@pytest.mark.slow
def test_what_the_page_says_holds_on_other_noise():
    """With the disturbance estimated no learner is worse than 1.1 times fixed precision, unless a limit is not told.

    With modes of the actuator, even then. A loop that is slower or later than its model swings with fixed precision, too.
    """
    report = reproduce.models(seed=1, jobs=2)
    bar = report["settings"]["bar"]
    learners = [n for n in report["settings"]["techniques"] if n not in {"No FT", "EF-FDI", "SER FT"}]
    actuator, offset = learners.pop(), learners.pop()
    estimated = dict(report["errors"]["with disturbance"])
    swinging = [estimated.pop(condition) for condition in ("lag", "late")]
    for condition, cells in estimated.items():
        for name in learners:
            assert (cells[name]["healthy"]["ratio"] <= bar) == (condition != UNKNOWN_LIMIT), (condition, name)
        assert all(cells[name]["healthy"]["ratio"] <= bar for name in (actuator, offset)), condition
        if condition != UNKNOWN_LIMIT:
            assert cells["SwitchingPrecision"]["freeze"]["ratio_ci"][0] < 1.05  # one run in thirty may lose its way
    assert swinging[0]["SwitchingPrecision"]["healthy"]["ratio"] < 1.0
    assert all(cells[actuator]["healthy"]["ratio"] > 10.0 for cells in swinging)  # the page warns of that
    plain = report["errors"]["as it is"]
    assert plain["drag"]["PL"]["healthy"]["ratio"] > bar
    assert all(plain[c][actuator]["healthy"]["ratio"] < 0.7 for c in ("mass up", "mass down", "drag"))
