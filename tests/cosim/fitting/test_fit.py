"""Fits of FMUs: against scipy over fmpy alone, against known parameters, and everything that can be wrong."""

import re
import threading
import warnings
from dataclasses import replace

import fmpy
import numpy as np
import pandas as pd
import pytest
from fmpy.fmi2 import FMU2Slave
from scipy.optimize import least_squares

from bayesftc import cosim, fmus
from bayesftc.cosim.fitting.simulator import Simulator
from bayesftc.examples.fitted_car.recordings import CAR, DT, NAMES, RANGES, TRUE, recording
from bayesftc.examples.fitted_car.study import KINDS, draw, errors

TABLE = recording(0, 400)


def by_fmpy(parameters, table, folder):
    """Return the car's speed at each row, by fmpy step by step."""
    description = fmpy.read_model_description(str(CAR))
    of = {variable.name: variable.valueReference for variable in description.modelVariables}
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="car",
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.setReal([of[name] for name in parameters], list(parameters.values()))
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    v = np.empty(len(table))
    for k, u in enumerate(table["u"]):
        v[k] = slave.getReal([of["v"]])[0]
        slave.setReal([of["force"]], [u])
        slave.doStep(k * DT, DT)
    slave.terminate()
    slave.freeInstance()
    return v


def test_it_is_the_fit_of_scipy_over_fmpy(tmp_path):
    table, names = TABLE[:200], list(TRUE)
    table.loc[50:80, "v1"] = np.nan
    folder = fmpy.extract(str(CAR), str(tmp_path))
    y = table[["v0", "v1"]].to_numpy()

    def residuals(p):
        return (y - by_fmpy(dict(zip(names, p, strict=True)), table, folder)[:, None])[np.isfinite(y)]

    low, high = np.array(list(RANGES.values()), float).T
    oracle = least_squares(residuals, [100.0, 5.0, 0.0], bounds=(low, high), x_scale=[100.0, 5.0, 1.0])
    std = np.sqrt(np.diag(np.linalg.inv(oracle.jac.T @ oracle.jac)) * 2 * oracle.cost / (np.isfinite(y).sum() - 3))
    fitted = cosim.fit(CAR, table, RANGES, **NAMES, held_out=0.0, weigh=None)
    ours, our_std = (np.array([of[name] for name in names]) for of in (fitted.parameters, fitted.std))
    assert (
        np.abs(ours - oracle.x).max() < 0.3 * std.min()
    )  # the noise of both sensors is estimated here, and equal there
    np.testing.assert_allclose(ours, oracle.x, atol=0.15 * std.max())
    np.testing.assert_allclose(our_std, std, rtol=0.05)
    np.testing.assert_allclose(fitted.fitted[:, 0], by_fmpy(fitted.parameters, table, folder), atol=1e-9)


@pytest.mark.slow
def test_samples_of_a_faulty_sensor_do_not_count():
    table = recording(1, 400)
    table.loc[100:200, "v1"] += 2.0
    fitted = cosim.fit(CAR, table, RANGES, **NAMES)
    counting_all = cosim.fit(CAR, table, RANGES, **NAMES, weigh=None)
    for name, value in TRUE.items():
        assert abs(fitted.parameters[name] - value) < 3 * fitted.std[name]
    assert any(abs(counting_all.parameters[n] - value) > 3 * fitted.std[n] for n, value in TRUE.items())
    assert fitted.weights[105:200, 1].max() < 0.1 < 0.9 < fitted.weights[:, 0].mean()
    assert any(s.startswith("v1: ") and "probably faulty" in s for s in fitted.sentences)
    assert fitted.held_out["v0"] == pytest.approx(0.5, rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "least"), [("no fault", 0.93), ("a fault and a gap", 0.93), ("coloured noise (0.8)", 0.9)]
)
def test_the_truth_is_within_two_standard_errors(kind, least):
    """With normal errors it is in 95.4 % of cases. Of 300 cases, 93 % leaves two standard deviations of that count."""
    assert np.mean(np.abs(errors(**KINDS[kind])) < 2) >= least


@pytest.mark.slow
def test_the_truth_is_within_two_standard_errors_though_a_sensor_is_off():
    """One of the sensors is off by a standard deviation of the noise, and one fails for a while.

    Which samples are faulty is found, too, which the standard errors take for known: a few percent are missing.
    """
    assert np.mean(np.abs(errors(faulty=True, offset=1.0, count=60)) < 2) >= 0.90  # of 180: 95.4 %, give or take 1.6 %


@pytest.mark.slow
def test_the_study_of_some_recordings(tmp_path):
    found = {kind: errors(**KINDS[kind], count=1, rows=200) for kind in list(KINDS)[1:3]}
    assert all(z.shape == (1, 3) and np.isfinite(z).all() for z in found.values())
    draw(found, str(tmp_path / "coverage.png"))
    assert (tmp_path / "coverage.png").stat().st_size > 10_000


@pytest.mark.slow
def test_four_parameters_of_another_plant():
    true = {"R": 1.2, "L": 0.06, "J": 0.012, "b": 0.025}
    diagram = cosim.Diagram(dt=0.02)
    servo = diagram.add(cosim.FMU(fmus.path("PositionServo"), parameters=true), "servo")
    voltage = diagram.add(cosim.PRBS(5.0, 0.2), "voltage")
    diagram.connect(voltage["y"], servo["voltage"])
    run = diagram.simulate(8.0)
    noise = np.random.default_rng(0).standard_normal((2, len(run.time)))
    table = pd.DataFrame({"time": run.time, "voltage": run["voltage.y"]})
    table["speed"], table["current"] = run["servo.speed"] + 0.3 * noise[0], run["servo.current"] + 0.1 * noise[1]
    ranges = {"R": (0.5, 2), "L": (0.02, 0.2), "J": (0.005, 0.05), "b": (0.001, 0.1)}
    settings = cosim.FitSettings(screened=8, starts=1)
    fitted = cosim.fit(
        fmus.path("PositionServo"), table, ranges, inputs="voltage", outputs=["speed", "current"], settings=settings
    )
    for name, value in true.items():
        assert abs(fitted.parameters[name] - value) < 3 * fitted.std[name]
    assert fitted.rms == pytest.approx({"speed": 0.3, "current": 0.1}, rel=0.1)
    # The plant is a block with the fitted parameters.
    assert fitted.plant.start_value("J") == fitted.parameters["J"]


def test_what_cannot_be_told_apart_is_named():
    coasting = TABLE.assign(u=0.0)
    coasting[["v0", "v1"]] = 30.0 * np.exp(-6.0 / 110.0 * TABLE[["time"]].to_numpy()) + 0.1 * np.random.default_rng(
        0
    ).normal(size=(400, 2))
    car = cosim.FMU(CAR, parameters={"v0": 30.0})
    fitted = cosim.fit(car, coasting, {"m": (50, 200), "b": (1, 20)}, **NAMES, weigh=None)
    assert fitted.parameters["b"] / fitted.parameters["m"] == pytest.approx(6.0 / 110.0, rel=0.01)
    worst = fitted.profile[0]
    share = worst.direction["b"] * 19 / (worst.direction["m"] * 150)  # only b/m acts on the speed
    assert share == pytest.approx(fitted.parameters["b"] / fitted.parameters["m"], rel=0.05)
    assert any("m and b cannot be told apart" in sentence for sentence in fitted.sentences)
    assert fitted.correlation[0, 1] > 0.99


def test_a_parameter_without_effect_cannot_be_determined():
    still = TABLE.assign(
        u=0.0, v0=0.1 * np.sin(TABLE.index), v1=0.1 * np.cos(TABLE.index)
    )  # at rest the mass does nothing
    fitted = cosim.fit(cosim.FMU(CAR), still, {"m": (50, 200)}, **NAMES, weigh=None)
    assert fitted.std["m"] > 150
    (sentence,) = (s for s in fitted.sentences if s.startswith("m cannot be determined"))
    assert "Fix it" in sentence
    assert "changes" not in sentence
    assert fitted.undetermined == ("m",)
    assert "(not determined)" in str(fitted)


def test_a_parameter_that_the_fmu_rounds_gets_the_best_of_some_values(monkeypatch):
    run, fitted = Simulator._run, None

    def rounding(self, parameters, rows, stopped):
        parameters = {"m": fitted.parameters["m"] if fitted else 0.0, **parameters}
        return run(self, {**parameters, "m": 20.0 * round(parameters["m"] / 20.0)}, rows, stopped)

    monkeypatch.setattr(Simulator, "_run", rounding)
    car, settings = cosim.FMU(CAR, parameters={"b": 6.0}), cosim.FitSettings(screened=12, starts=1)
    fitted = cosim.fit(
        car, TABLE, {"v0": (-10, 10), "m": (92, 408)}, **NAMES, weigh=None, settings=settings
    )  # 110 kg is 100 or 120
    assert 90 < fitted.parameters["m"] < 130
    (sentence,) = (s for s in fitted.sentences if s.startswith("m has no standard error"))
    assert "The FMU may round it. Its value is the best of 12 over its range" in sentence
    assert fitted.undetermined == ("m",)
    alone = cosim.fit(replace(car, parameters=fitted.plant.parameters), TABLE, {"v0": (-10, 10)}, **NAMES, weigh=None)
    assert fitted.parameters["v0"] == pytest.approx(alone.parameters["v0"], rel=1e-4)
    assert fitted.std["v0"] == pytest.approx(alone.std["v0"], rel=0.05)


def test_an_input_that_is_not_given_is_named_if_the_recording_has_it():
    table = TABLE[:60].rename(columns={"u": "force"})
    names = {"outputs": {"v": ["v0", "v1"]}, "weigh": None}
    with pytest.warns(UserWarning, match=r"force is not given .* a column of that name. Add inputs=\[\"force\"\]"):
        cosim.fit(CAR, table, {"m": (50, 200)}, **names)
    with pytest.warns(UserWarning, match=r"force is not given .* a column of that name."):
        cosim.fit(CAR, table.rename(columns={"force": "force [N]"}), {"m": (50, 200)}, **names)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cosim.fit(CAR, table, {"m": (50, 200)}, **names, inputs="force")
        cosim.fit(cosim.FMU(CAR, parameters={"force": 9.0}), table, {"m": (50, 200)}, **names)  # on purpose


def test_a_bound_is_named_and_has_no_standard_error():
    fitted = cosim.fit(CAR, TABLE, {"m": (50, 90), "b": (1, 20)}, **NAMES, weigh=None)
    assert fitted.parameters["m"] == pytest.approx(90.0, abs=0.05)
    assert np.isnan(fitted.std["m"])
    assert fitted.std["b"] > 0
    assert any("is at the upper bound" in sentence for sentence in fitted.sentences)
    assert "nan" in str(fitted)


@pytest.mark.slow
def test_it_is_repeated_with_the_same_bits_on_any_number_of_threads():
    one, two, again = (cosim.fit(CAR, TABLE[:100], RANGES, **NAMES, jobs=jobs) for jobs in (1, 2, 2))
    assert one.parameters == two.parameters == again.parameters
    assert one.std == two.std
    np.testing.assert_array_equal(one.weights, two.weights)


def test_a_recording_can_be_a_result_a_table_or_a_file(tmp_path):
    csv, parquet = tmp_path / "drive.csv", tmp_path / "drive.parquet"
    TABLE.to_csv(csv, index=False)
    TABLE.to_parquet(parquet)
    fits = [cosim.fit(CAR, data, {"m": (80, 120)}, **NAMES, weigh=None) for data in (TABLE, csv, str(parquet))]
    assert fits[0].parameters == fits[2].parameters
    assert fits[0].parameters == pytest.approx(fits[1].parameters, rel=1e-9)


def test_a_run_without_noise_gives_the_parameter_itself():
    diagram = cosim.Diagram(dt=DT)
    car = diagram.add(cosim.FMU(CAR, parameters={"m": 110.0}), "car")
    force = diagram.add(cosim.PRBS(300.0, 4.0), "force")
    diagram.connect(force["y"], car["force"])
    names = {"inputs": {"force": "force.y"}, "outputs": {"v": "car.v"}}
    fitted = cosim.fit(CAR, diagram.simulate(20.0), {"m": (80, 120)}, **names)
    assert fitted.parameters["m"] == pytest.approx(110.0, rel=1e-6)


def test_where_the_fmu_fails_the_search_goes_elsewhere():
    # With a negative mass the speed grows beyond all bounds, and the run stops.
    car = cosim.FMU(CAR, parameters={"v0": 3.0})
    fitted = cosim.fit(car, TABLE, {"m": (-150, 200), "b": (1, 20)}, **NAMES, weigh=None)
    assert fitted.parameters["m"] == pytest.approx(110.0, rel=0.05)
    with pytest.raises(cosim.SimulationError, match=r"at none of 33 points .* came out"):
        cosim.fit(CAR, recording(0, 1500), {"m": (-1e-3, -1e-4)}, **NAMES)


@pytest.mark.slow
def test_own_weights():
    seen = []

    def trust_the_first(y, predicted, dt):
        seen.append((y.shape, predicted.shape, dt))
        return np.array([1.0, 0.0]) * np.ones_like(y)

    fitted = cosim.fit(CAR, TABLE, RANGES, **NAMES, weigh=trust_the_first)
    alone = cosim.fit(CAR, TABLE, RANGES, inputs={"force": "u"}, outputs={"v": "v0"}, weigh=None)
    assert set(seen) == {((400, 2), (400,), DT)}
    for name in TRUE:
        assert abs(fitted.parameters[name] - alone.parameters[name]) < 0.05 * alone.std[name]


@pytest.mark.slow
def test_a_sample_may_count_in_none_of_the_sensors():
    with pytest.raises(cosim.ModelError, match="Nearly all samples are probably faulty"):
        cosim.fit(CAR, TABLE, RANGES, **NAMES, weigh=lambda y, predicted, dt: np.zeros_like(y))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": {}}, "give a range for each name"),
        ({"parameters": {"m": 3}}, r"'m' has the range 3; give \(low, high\)"),
        ({"parameters": {"m": (120, 80)}}, "low < high"),
        ({"parameters": {"m": (80, np.inf)}}, "low < high"),
        ({"parameters": {"mass": (80, 120)}}, "no parameter 'mass'"),
        ({"parameters": {"force": (80, 120)}}, "is an input"),
        ({"inputs": {"push": "u"}}, "no input 'push'"),
        ({"inputs": {"force": "uu"}}, "no column 'uu' for an input"),
        ({"outputs": {"speed": "v0"}}, "no output 'speed'"),
        ({"outputs": {"v": ["v0", "v0"]}}, "twice"),
        ({"outputs": {}}, "no outputs"),
        ({"outputs": {"v": 3}}, "names of columns"),
        ({"held_out": 1.0}, "a share"),
        ({"held_out": np.nan}, "a share"),
        ({"weigh": "never"}, "weigh='never'"),
        ({"weigh": lambda y, predicted, dt: -y}, "must return an array of shape"),
        ({"jobs": 0}, "jobs is 0"),
        ({"dt": -1}, "must be positive"),
        ({"time": "t"}, "no column 't'"),
        ({"recording": 3}, "data of the type int"),
        ({"recording": "nothing.csv"}, "cannot be read"),
        ({"recording": TABLE[:0]}, "no rows"),
        ({"recording": TABLE[:3], "outputs": {"v": "v0"}}, "Record more"),
        ({"recording": TABLE.assign(v1=TABLE["v1"].where(TABLE.index < 10))}, "'v1' has 10 samples"),
        ({"recording": TABLE.assign(v1=np.nan)}, "'v1' has 0 samples"),
        ({"recording": TABLE.assign(v1="high")}, "contains text"),
        ({"recording": TABLE.assign(u=TABLE["u"].where(TABLE.index > 0))}, "no value in the first row"),
        ({"recording": TABLE.assign(time=TABLE["time"] ** 2)}, "not evenly spaced"),
        ({"fmu": "nothing.fmu"}, "nothing.fmu"),
    ],
)
def test_what_is_wrong_is_said(change, words):
    given = {"fmu": CAR, "recording": TABLE, "parameters": RANGES, **NAMES, **change}
    with pytest.raises(cosim.BayesFTCError, match=words) as raised:
        cosim.fit(**given)
    assert re.search(r"[.;:?] ?\w", str(raised.value))  # what to do follows


@pytest.mark.parametrize(
    "wrong",
    [{"screened": 0}, {"starts": 1.5}, {"difference": 0}, {"settled": -1}, {"seed": -1}, {"rounds": True}],
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(cosim.ModelError, match=next(iter(wrong))):
        cosim.FitSettings(**wrong)


def test_rounds_that_do_not_settle_are_named():
    turns = iter(range(100))

    def of_two_minds(y, predicted, dt):
        return np.ones_like(y) * (np.arange(len(y)) < 100 + 150 * (next(turns) % 2))[:, None]

    fitted = cosim.fit(CAR, TABLE, RANGES, **NAMES, weigh=of_two_minds, settings=cosim.FitSettings(rounds=2))
    assert any("still move after 2 rounds" in sentence for sentence in fitted.sentences)


def test_a_worse_held_out_part_is_named():
    table = TABLE.copy()
    table.loc[330:, ["v0", "v1"]] += 3.0
    fitted = cosim.fit(CAR, table, RANGES, **NAMES, weigh=None)
    assert any("held-out part the error is" in sentence for sentence in fitted.sentences)


def test_the_figure_has_samples_and_differences_of_each_output():
    fitted = cosim.fit(CAR, TABLE[:150], RANGES, **NAMES, weigh=None)
    figure = fitted.plot()
    assert [axis.get_ylabel() for axis in figure.axes] == ["v (m/s)", "samples - fit"]
    assert {line.get_label() for line in figure.axes[0].lines} >= {"v0", "v1", "fit"}
    line = next(line for line in figure.axes[0].lines if line.get_label() == "fit")
    np.testing.assert_array_equal(line.get_ydata(), fitted.fitted[:, 0])


def test_a_stop_from_outside_ends_all_runs(monkeypatch):
    """As by Ctrl-C, which arrives while the main thread waits for the others."""
    from bayesftc.cosim.fitting.samples import sample

    simulator = Simulator(cosim.FMU(CAR), sample(TABLE, **NAMES, time="time", dt=None), jobs=2)
    before, calls = threading.active_count(), []

    def fail(parameters):
        calls.append(parameters)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulator, "diagram", fail)
    with pytest.raises(KeyboardInterrupt):
        simulator.runs([{"m": 100.0}] * 50, 400)
    assert len(calls) < 50
    assert threading.active_count() <= before


def test_parameters_of_the_fmu_stay():
    car = cosim.FMU(CAR, parameters={"b": 6.0, "v0": 3.0})
    fitted = cosim.fit(car, TABLE, {"m": (80, 120)}, **NAMES, weigh=None)
    assert fitted.plant.parameters == {"b": 6.0, "v0": 3.0, "m": fitted.parameters["m"]}
    assert abs(fitted.parameters["m"] - 110.0) < 3 * fitted.std["m"]
    assert replace(fitted.plant).start_value("v0") == 3.0


@pytest.mark.slow
def test_several_inputs_each_with_its_column():
    diagram, rng = cosim.Diagram("1/100"), np.random.default_rng(0)
    arm = diagram.add(cosim.FMU(fmus.path("TwoLinkArm"), parameters={"m2": 1.2}), "arm")
    for interval, name in ((0.3, "torque1"), (0.2, "torque2")):
        diagram.connect(diagram.add(cosim.PRBS(1.0, interval), name)["y"], arm[name])
    run = diagram.simulate(10.0)
    table = pd.DataFrame({"time": run.time, **{f"t{i}": run[f"torque{i}.y"] for i in (1, 2)}})
    for name in ("q1", "q2"):
        table[name] = run[f"arm.{name}"] + 1e-3 * rng.standard_normal(len(table))
    inputs = {"torque1": "t1", "torque2": "t2"}
    fitted = cosim.fit(fmus.path("TwoLinkArm"), table, {"m2": (0.5, 2.0)}, inputs=inputs, outputs=["q1", "q2"])
    assert abs(fitted.parameters["m2"] - 1.2) < 3 * fitted.std["m2"] < 0.1


@pytest.mark.slow
def test_a_fit_says_where_it_contradicts_its_weights():
    table = TABLE.copy()
    table.loc[200:, "v0"] -= 0.05 * np.arange(200)

    def trust_the_drift(y, predicted, dt):
        return np.where(np.arange(len(y))[:, None] < 200, 1.0, [1.0, 0.0])

    fitted = cosim.fit(CAR, table, RANGES, **NAMES, held_out=0.5, weigh=trust_the_drift)
    (sentence,) = [each for each in fitted.sentences if "contradicts its weights" in each]
    assert "Probably v0 has failed, and not v1. Fit again without the column v0" in sentence
    again = cosim.fit(CAR, table, RANGES, inputs={"force": "u"}, outputs={"v": "v1"})
    assert not any("contradicts" in each for each in again.sentences)
