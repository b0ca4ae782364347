"""The summary of a run: the figures of `bayesftc run` as tables."""

import math

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.findings import numbers_of
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.run import summary
from bayesftc.cosim.run.result import ESTIMATE_A_LOAD
from bayesftc.cosim.run.summary import findings_table, tables_of
from bayesftc.scenario import load_scenario


@pytest.fixture(scope="module")
def loop():
    return load_scenario("cruise_control").loop()


@pytest.fixture(scope="module")
def result(loop):
    return loop.simulate(8.0, seed=1)


def test_its_numbers_are_the_figures_of_the_run(loop, result):
    summary = result.summary()
    numbers = figures(loop_signals(loop, result))
    assert list(summary) == ["errors", "findings", "sensors"]
    assert summary["errors"].loc["tracking of v (m/s)", "during"] == numbers.tracking["v"].during
    error = result["plant.v"] - result["reference.y"]
    assert summary["errors"].loc["tracking of v (m/s)", "whole run"] == pytest.approx(np.sqrt(np.mean(error**2)))
    sensors = summary["sensors"]
    assert list(sensors.columns) == ["sensor 0", "sensor 1"]
    assert sensors.loc["faults"].tolist() == [1, 0]
    assert sensors.loc["mean precision in fault (1/(m/s)²)", "sensor 0"] == numbers.sensors[0].precision_faulty
    assert math.isnan(sensors.loc["faults missed", "sensor 1"])


def test_a_share_of_alarms_is_not_called_false_alarms(loop, result):
    summary = result.summary()
    shares = [each.false_alarm_rate for each in figures(loop_signals(loop, result)).sensors]
    assert summary["sensors"].loc["blamed while healthy (share of fault-free time)"].tolist() == shares
    assert not any("false alarm" in label.lower() for label in summary["sensors"].index)


def test_alarms_that_begin_without_a_fault_are_counted():
    """As by `cosim.judge_alarms`, also of a slow sensor and of one that drops out."""
    servo = cosim.FMU(fmus.path("PositionServo"))
    learner = controllers.SwitchingPrecision().rarer(0.01)  # it expects faults every few seconds
    controller = controllers.design(
        servo, measured="angle", actuated="voltage", sensors=3, sensor_std=0.01, precision=learner
    )
    loop = cosim.closed_loop(
        servo,
        controller,
        control="voltage",
        measured="angle",
        sensors=cosim.Sensors(3, std=0.01, every=(1, 1, 5)),
        faults=[
            cosim.Bias(sensor=1, start=20.0, stop=25.0, magnitude=0.1, name="bias"),
            cosim.Dropout(sensor=0, start=30.0, stop=31.0, name="dropout"),
        ],
        reference=1.0,
    )
    result = loop.simulate(40.0, seed=1)
    faulty = np.zeros((len(result.time), 3), bool)
    faulty[:, 1], faulty[:, 0] = result["bias.active"] > 0.5, result["dropout.active"] > 0.5
    judged = cosim.judge_alarms(
        result["controller.fault_probability"], faulty, threshold=0.5, step=float(result.time[1])
    )
    assert judged.rate_interval()[0] > 3600  # in an hour
    low, high = (f"{bound / 3600:.2g}" for bound in judged.rate_interval())
    assert judged.false_alarms >= 3
    seldom = {"false_alarms": 3, "false_alarms_per_hour_ci": (0.25, 121.0)}
    assert "3, which is 0.25 to 121 an hour of each sensor" in summary._below_sensors([], seldom)
    said = f"False alarms: {judged.false_alarms}, which is {low} to {high} a second of each sensor (95 % interval)."
    assert said in repr(result.summary())


@pytest.mark.parametrize(
    ("step", "delay", "printed"),
    [(0.005, 0.005, "0.005"), (0.02, 0.02, "0.02"), (0.1, 0.1, "0.10"), (1 / 30, 1 / 30, "0.033"), (1e-5, 3e-5, "0.00003"),
     (150.0, 300.0, "300.00"), (None, 0.5, "0.50")],
)  # fmt: skip
def test_a_delay_of_one_step_does_not_look_like_none(result, loop, step, delay, printed):
    numbers = numbers_of(loop_signals(loop, result))
    assert numbers["step"] == pytest.approx(0.02)
    numbers["sensors"][0]["delay"], numbers["step"] = delay, step
    (table,) = (each for each in tables_of(numbers) if each.key == "sensors")
    assert next(row for row in table.texts() if row[0] == "mean detection delay (s)")[1] == printed


@pytest.mark.parametrize(
    ("units", "head", "behind"),
    [
        (("m", "m"), " (1/m²)", ("", "")),
        (("m", "rad/s"), "", (" 1/m²", " 1/(rad/s)²")),
        (("m", None), "", (" 1/m²", "")),
        ((None, None), "", ("", "")),
        (("{a}", "m"), "", (" 1/({a})²", " 1/m²")),
    ],
)
def test_precisions_of_several_units_have_them_behind_the_numbers(result, loop, units, head, behind):
    numbers = numbers_of(loop_signals(loop, result))
    values = []
    for sensor, unit in zip(numbers["sensors"], units, strict=True):
        sensor["unit"] = unit
        values.append(sensor["precision_healthy"])
    (table,) = (each for each in tables_of(numbers) if each.key == "sensors")
    (shown,) = (row for row in table.texts() if row[0].startswith("mean precision without fault"))
    expected = [f"{value:.3g}{unit}" for value, unit in zip(values, behind, strict=True)]
    assert shown == (f"mean precision without fault{head}", *expected)
    assert table.frame().loc[shown[0]].tolist() == values


def test_it_prints_aligned_tables(result):
    text = repr(result.summary())
    heading, header, tracking, *_ = text.splitlines()
    assert heading.startswith("Root-mean-square errors")
    assert header.split("  ")[-1] == "after"
    assert len(header) == len(tracking.rstrip("–")) + 1  # no time after the fault
    assert "faults missed" in text
    assert "The tracking error uses the reference at the same instant." in text
    html = result.summary()._repr_html_()
    assert "<td" in html
    assert "tracking of v (m/s)" in html


@pytest.mark.parametrize(
    ("preview", "reference", "sentence"),
    [
        (
            0,
            cosim.Sine(1.0, 4.0),
            " The regulator lags behind a moving reference. If that is known n samples ahead, give the controller preview=n.",
        ),
        (20, cosim.Sine(1.0, 4.0), ""),
        (0, 1.0, ""),  # a constant one: the lag is no cause of the error
    ],
)
def test_it_says_of_a_tracking_error_that_the_regulator_lags(tmp_path, preview, reference, sentence):
    """bayesftc run said it alone, and an error of tracking that the law has by itself looked like a wrong design."""
    mass = control.ss([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"])
    controller = controllers.design(
        mass, measured="x", actuated="force", dt=0.05, sensor_std=0.01, acceptable_error=0.1, acceptable_control=1.0,
        preview=preview,
    )  # fmt: skip
    loop = cosim.closed_loop(
        mass, controller, control="force", measured="x", sensors=cosim.Sensors(1, 0.01), reference=reference
    )
    result = loop.simulate(1.0)
    result.save(tmp_path / "result.npz")
    for each in (result, cosim.Result.load(tmp_path / "result.npz")):
        lines = repr(each.summary()).splitlines()
        assert f"The tracking error uses the reference at the same instant.{sentence}" in lines


def test_a_wrong_model_is_said_above_the_faults_that_it_may_cause(tmp_path):
    """All sensors count as faulty, because the force has the opposite sign of the model's."""
    model = controllers.LinearModel([[0.999]], [[-2e-4]], [[1.0], [1.0]], 1e-3, 1.0, dt=0.02)
    controller = controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0)
    car = load_scenario("cruise_control")
    wrong = cosim.closed_loop(
        car.plant, controller, control="force", measured="v", sensors=cosim.Sensors(2, 1.0), reference=25.0
    )
    result = wrong.simulate(8.0, seed=1)
    result = cosim.Result.load(result.save(tmp_path / "run.npz"))
    since = result.time[np.argmax(result["controller.model_suspect"] >= 0.5)]
    sentence = f"The model of controller is suspect from t = {since:g} s."
    cause = (
        "If it is wrong, sensors may be blamed because of it. controllers.diagnose(result, loop) looks for the cause; None means "
        "too little evidence for any, not that the model is right."
    )
    cause = f"{cause} {ESTIMATE_A_LOAD}"
    assert "acts where the control does" in cause  # elsewhere it harms: docs/explanation/wrong-models.md
    assert repr(result.summary()).startswith(f"{sentence} {cause}\n\n")
    assert result.summary()._repr_html_().startswith(f"<p>{sentence}")
    assert controllers.diagnose(result, wrong).kind == "sign"  # the call that it names


def test_the_only_sensor_of_a_quantity_is_named_beside_the_model():
    """Its jump contradicts each set of sensors, as a wrong model does."""
    wheel = control.ss([[0, 1], [0, -2]], [[0], [2]], np.eye(2), 0, inputs=["u"], outputs=["position", "speed"])
    settings = {"measured": ["position", "speed"], "sensors": [1, 3], "sensor_std": [0.01] + [0.05] * 3}
    loop = cosim.closed_loop(
        wheel,
        controllers.design(wheel, actuated="u", goal="position", noise={"u": 0.05}, dt=0.02, **settings),
        control="u",
        measured=["position", "speed"],
        sensors=cosim.Sensors([1, 3], settings["sensor_std"]),
        reference=0.2,
        faults=[cosim.Bias(sensor=0, start=3.0, magnitude=0.5)],
    )
    result = loop.simulate(8.0, seed=1)
    named = "model of controller suspect, or sensor 0, the only one of its quantity, is faulty, from t ="
    assert result.notes[0].startswith(named)
    errors = repr(result.summary())
    assert "tracking of position" in errors
    assert "tracking of speed" not in errors


def test_an_estimator_beside_a_law_has_the_findings_of_a_loop(tmp_path):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1], [1]], 1e-3, 1.0, dt=0.02)
    diagram = cosim.Diagram(dt=0.02)
    names = {
        "car": cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        "sensors": cosim.Sensors(count=2, std=1.0),
        "drift": cosim.Drift(sensor=0, start=5.0, slope=1.0, channels=2),
        "estimator": controllers.StateEstimator(model, initial_mean=20.0),
        "mine": controllers.PID(500.0, integral_gain=100.0),
        "goal": cosim.Constant(22.0),
    }
    blocks = {name: diagram.add(block, name) for name, block in names.items()}
    for source, target in (
        (("car", "v"), ("sensors", "u")),
        (("sensors", "y"), ("drift", "u")),
        (("drift", "y"), ("estimator", "y")),
        (("estimator", "x_hat"), ("mine", "x_hat")),
        (("goal", "y"), ("mine", "goal")),
        (("mine", "u"), ("car", "force")),
        (("mine", "u"), ("estimator", "u")),
    ):
        diagram.connect(blocks[source[0]][source[1]], blocks[target[0]][target[1]])
    result = diagram.simulate(12.0, seed=1)
    result = cosim.Result.load(result.save(tmp_path / "run.npz"))
    assert result.findings()[["where", "kind", "unit"]].values.tolist() == [["sensor 0", "Drifting", "m/s"]]
    text = repr(result.summary())
    assert "belief of v (m/s)" in text
    assert "tracking" not in text.split("\n", 1)[1]
    labels = [axis.get_ylabel() for axis in result.plot().axes]
    assert "force (N)" in labels
    assert "v (m/s)" in labels
    assert controllers.diagnose(result, diagram) is None
    reversed_model = controllers.LinearModel([[0.999]], [[-2e-4]], [[1], [1]], 1e-3, 1.0, dt=0.02)
    assert (
        controllers.diagnose(
            result, controllers.StateEstimator(reversed_model, initial_mean=20.0), name="estimator"
        ).kind
        == "sign"
    )


def own_controller(goals):
    """Return an estimator and a law of the angle and the speed as one block; the goal is for the angle."""
    inside = cosim.Diagram(dt=0.02)
    model = controllers.LinearModel(
        [[1, 0.02], [0, 0.98]], [[0], [0.02]], [[1, 0]] * 2 + [[0, 1]], [1e-9, 1e-6], 1e-4, dt=0.02
    )
    estimator = inside.add(controllers.StateEstimator(model), "estimator")
    law = inside.add(controllers.PID(20.0, integral_gain=1.0), "law")
    inside.connect(estimator["x_hat"][0], law["x_hat"])
    inside.connect(law["u"], estimator["u"])
    shown = ("x_hat", "fault_probability", "fault_kind", "model_suspect")
    outputs = {"u": "law.u"} | {name: f"estimator.{name}" for name in shown}
    return cosim.Subsystem(inside, inputs={"y": "estimator.y", "goal": "law.goal"}, outputs=outputs, goals=goals)


def test_a_controller_of_blocks_is_judged_as_any_other():
    plant = control.ss([[0, 1], [0, -1]], [[0], [1]], np.eye(2), 0, inputs=["u"], outputs=["angle", "speed"])

    def loop(controller):
        return cosim.closed_loop(
            plant, controller, control="u", measured=["angle", "speed"], sensors=cosim.Sensors([2, 1], 0.01), reference=0.3,
            faults=[cosim.Freeze(sensor=0, start=1.0)],
        )  # fmt: skip

    mine = loop(own_controller(["angle"]))
    result = mine.simulate(4.0, seed=1)
    assert result.findings()["kind"].tolist() == ["Frozen"]
    errors = result.summary()["errors"]
    assert errors.index.tolist() == ["tracking of angle", "belief of angle", "belief of speed"]
    assert controllers.diagnose(result, mine) is None
    table = cosim.compare({"one": mine, "other": loop(own_controller("angle"))}, duration=2.0, seeds=2).table
    assert table["error"].notna().all()
    unnamed = loop(own_controller([]))
    with pytest.raises(ModelError, match=r"No known signal of the loop 'other' has a goal.*goals=\['angle'\]"):
        cosim.compare({"one": mine, "other": unnamed}, duration=2.0, seeds=2)
    with pytest.raises(ModelError, match="The subsystem 'controller' has a goal for 'angel'; did you mean 'angle'"):
        find_roles(loop(own_controller(["angel"])))


def test_what_was_not_recorded_is_named(loop, result):
    """Its rows were left out without a word; with little recorded, the summary was empty."""
    said = loop.simulate(1.0, record=["plant.v", "controller.fault_probability"], engine="interpreted").summary()
    (note,) = said.notes
    assert note.startswith("Not recorded: freeze_0.active, controller.precision,")
    assert note.endswith("more. The tables lack what needs them. A run without record= records all signals.")
    for name in ("controller.x_hat", "controller.fault_probability", "reference.y"):
        record = [each for each in result if each != name]
        (note,) = loop.simulate(1.0, record=record, engine="interpreted").summary().notes
        assert note.startswith(f"Not recorded: {name}. ")
    record = [each for each in result if not each.endswith(("controller.P", "controller.mode_probability"))]
    assert not loop.simulate(1.0, record=record, engine="interpreted").summary().notes  # only the figure needs them
    assert str(said).startswith("Not recorded")
    plant = control.ss([[0, 1], [0, -1]], [[0], [1]], np.eye(2), 0, inputs=["u"], outputs=["angle", "speed"])
    law = cosim.Subsystem(
        own_controller([]).diagram,
        inputs={"y": "estimator.y", "goal": "law.goal"},
        outputs={"u": "law.u"},
        goals=["angle"],
    )  # without x_hat
    own = cosim.closed_loop(
        plant, law, control="u", measured=["angle", "speed"], sensors=cosim.Sensors([2, 1], 0.01), reference=0.3,
        input_faults={"u": cosim.Bias(magnitude=50.0, start=1.0)},
    )  # fmt: skip
    assert not own.simulate(1.2, engine="interpreted").summary().notes
    assert not result.summary().notes


def test_a_constant_dead_time_of_a_control_is_no_fault():
    car = load_scenario("cruise_control")
    faults = {"late": cosim.Delay(delay=0.02, initial=0.0), "later": cosim.Delay(delay=0.02, initial=0.0, start=1.0)}
    for name, late in faults.items():
        loop = cosim.closed_loop(
            car.plant, car.controller, control="force", measured="v", sensors=car.sensors, reference=5.0,
            faults=[cosim.Bias(sensor=0, magnitude=5.0, start=1.5)], input_faults={"force": [late]},
        )  # fmt: skip
        summary = loop.simulate(2.0, engine="interpreted").summary()
        assert ("inputs" in dict(summary.items())) == (name == "later")
        assert find_roles(loop).controls[0].faults == (("force_delay_0",) if name == "later" else ())
        assert summary["errors"].loc["tracking of v (m/s)", "before faults"] > 0


def test_faults_of_inputs_have_a_table(loop):
    car = load_scenario("cruise_control")
    faulty = cosim.closed_loop(
        car.plant, car.controller, control="force", measured="v", sensors=car.sensors, reference=20.0,
        input_faults={"force": cosim.Bias(magnitude=50.0, start=1.0)},
    )  # fmt: skip
    inputs = faulty.simulate(2.0, engine="interpreted").summary()["inputs"]
    assert inputs.loc["received - sent in fault (root mean square)"].tolist() == [pytest.approx(50.0)]


def test_a_diagram_that_is_no_loop_has_none():
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Ramp(1.0), "ramp")
    sentence = r"need a run of a closed loop: .*one Sensors block.*one controller.* Make the loop with cosim.closed_loop\(...\)"
    for table in ("summary", "findings"):
        with pytest.raises(ModelError, match=sentence):
            getattr(diagram.simulate(1.0, engine="interpreted"), table)()


def of_car(precision, **settings):
    car = load_scenario("cruise_control")
    model = car.controller.model
    return cosim.closed_loop(
        car.plant, controllers.BayesianController(model, precision, initial_mean=20.0), control="force", measured="v",
        sensors=car.sensors, reference=20.0, **settings,
    )  # fmt: skip


def test_inferred_faults_are_listed_with_kind_time_size_and_unit():
    loop = of_car(controllers.SwitchingPrecision(), faults=[cosim.Injection(sensor=1, start=3.0, magnitude=12.0)])
    result = loop.simulate(6.0, seed=1)
    found = result.findings()
    assert list(found) == ["where", "kind", "onset", "from", "until", "size", "unit", "probability", "alarms"]
    jump = found.iloc[-1]
    assert (jump["where"], jump["kind"], jump["unit"]) == ("sensor 1", "Offset", "m/s")
    assert jump["from"] == pytest.approx(3.0, abs=0.2)
    assert jump["onset"] <= jump["from"]
    assert jump["until"] == 6.0
    assert jump["size"] == pytest.approx(12.0, abs=1.5)
    assert jump["probability"] > 0.99
    assert jump["alarms"] < 5
    assert "Alarms: " not in repr(result.summary())
    table = result.summary()["findings"]
    assert table.loc["sensor 1", "kind"] == "Offset"
    assert f"{jump['size']:.3g} m/s" in repr(result.summary())
    assert "Faults that the controller infers" in result._repr_html_()
    assert len(result.findings(threshold=0.999999, hold=0.0)) >= 1


def test_outliers_are_told_from_a_lasting_offset_by_the_number_of_their_alarms():
    faults = [cosim.Spikes(sensor=1, start=3.0, magnitude=12.0, probability=0.05)]
    result = of_car(controllers.SwitchingPrecision([controllers.Offset()]), faults=faults).simulate(20.0, seed=1)
    found = result.findings()
    longest = found.loc[(found["until"] - found["from"]).idxmax()]
    p = result["controller.fault_probability"][:, 1]
    time = result.time
    inside = (time >= longest["from"]) & (time <= longest["until"])
    assert longest["alarms"] == np.sum(np.diff((p[inside] >= 0.5).astype(int), prepend=0) == 1) > 5
    text = repr(result.summary())
    assert "probability  alarms" in text
    assert "Many short alarms may be outliers" in text


def test_an_alarm_of_the_process_is_explained_below_the_table():
    alarm = {
        "where": "process",
        "kind": "NoisierProcess",
        "onset": None,
        "start": 1.0,
        "end": 2.0,
        "size": None,
        "unit": "",
    }
    (row,) = findings_table([alarm | {"probability": 0.7, "end": 123456.0}]).texts()
    assert row[2:5] == ("–", "1", "123456")  # not 1.2346e+05
    of_process = findings_table([alarm | {"probability": 0.7}]).remark
    assert (
        "the plant moved more than its model expects, as after a kick or a sudden load. It is no fault of a sensor."
        in of_process
    )
    assert "kick" not in findings_table([alarm | {"probability": 0.7, "where": "sensor 0"}]).remark


def test_a_saved_run_has_the_same_findings(result, tmp_path):
    assert cosim.Result.load(result.save(tmp_path / "run.npz")).findings().equals(result.findings())


def test_sizes_in_noise_have_no_unit_of_the_sensor(loop):
    kinds = dict(zip(find_roles(loop).fault_kinds, find_roles(loop).fault_sizes, strict=True))
    assert (kinds["Offset"], kinds["Noisier"]) == ("unit", "noise")


def test_a_learner_without_kinds_has_findings_without_them():
    fault = [cosim.Freeze(sensor=0, start=1.0), cosim.Injection(sensor=1, start=3.0, magnitude=20.0)]
    run = of_car(controllers.ExplicitDetection(), faults=fault).simulate(6.0, seed=1)
    found = run.findings()
    assert "sensor 1" in set(found["where"])
    assert set(found["kind"]) == {""}
    assert found["size"].isna().all()
    assert "sensor 1" in repr(run.summary())


def test_nothing_is_listed_without_an_inference():
    run = of_car(controllers.FixedPrecision()).simulate(2.0, engine="interpreted")
    assert not len(run.findings())
    assert list(run.summary()) == ["errors", "sensors"]
    assert "infers no fault" not in repr(run.summary())


def test_actuator_faults_are_listed():
    learner = controllers.SwitchingPrecision(actuator_modes=[controllers.LostEffect()])
    car = load_scenario("cruise_control")
    loop = cosim.closed_loop(
        car.plant, controllers.LQGController(car.controller.model, learner, initial_mean=20.0), control="force", measured="v",
        sensors=cosim.Sensors(2, 0.05), reference=cosim.Sine(amplitude=5.0, period=4.0, offset=20.0),
        input_faults={"force": cosim.GainFault(factor=0.2, start=4.0)},
    )  # fmt: skip
    found = loop.simulate(10.0, seed=1).findings()
    lost = found[found["where"] == "actuator force"].iloc[-1]
    assert (lost["kind"], lost["unit"]) == ("LostEffect", "of the effect")
    assert lost["size"] == pytest.approx(0.8, abs=0.2)


@pytest.mark.parametrize("settings", [{"threshold": 0.0}, {"threshold": 1.5}, {"hold": -1.0}])
def test_impossible_settings_are_refused(result, settings):
    with pytest.raises(ModelError, match=next(iter(settings))):
        result.findings(**settings)


def test_an_alarm_of_a_single_step_is_a_finding_with_any_hold():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    controller = controllers.LQGController(
        model, controllers.SwitchingPrecision(start_doubt=0.0), initial_mean=50.0, initial_covariance=1e-4
    )
    plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"]))
    loop = cosim.closed_loop(plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), reference=0.0)
    run = loop.simulate(0.0)
    assert (run["controller.fault_probability"] > 0.5).all()
    for hold in (None, 0.0, float("inf")):
        assert run.findings(hold=hold)["where"].tolist() == ["sensor 0", "sensor 1"]


def test_sensors_that_fail_together_are_named_as_another_explanation_of_a_suspect_model():
    """Three of four sensors have failed, and the model is right."""
    car = load_scenario("cruise_control")
    faults = [
        cosim.Bias(sensor=0, start=4.0, magnitude=8.0), cosim.Drift(sensor=1, start=4.0, slope=3.0),
        cosim.Bias(sensor=2, start=8.0, stop=10.0, magnitude=8.0),
    ]  # fmt: skip
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]] * 4, 1e-3, 1.0, dt=0.02)
    controller = controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0)
    loop = cosim.closed_loop(
        car.plant,
        controller,
        control="force",
        measured="v",
        sensors=cosim.Sensors(4, 1.0),
        faults=faults,
        reference=20.0,
    )
    text = repr(loop.simulate(12.0, seed=1).summary())
    assert text.startswith("The model of controller is suspect, or several sensors are faulty, from t = 8.04 s.")


def test_sensors_that_fail_one_after_another_are_named_as_another_explanation():
    """The check remembers the first fault, of a sensor of the other set, for some 300 samples."""
    car = load_scenario("cruise_control")
    faults = [
        cosim.Bias(sensor=0, start=4.0, stop=5.0, magnitude=10.0),
        cosim.Bias(sensor=1, start=5.5, magnitude=-10.0),
    ]
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]] * 2, 1e-3, 1.0, dt=0.02)
    controller = controllers.BayesianController(model, initial_mean=20.0, u_min=-4000.0, u_max=4000.0)
    parts = {"control": "force", "measured": "v", "sensors": cosim.Sensors(2, 1.0), "reference": 20.0}
    result = cosim.closed_loop(car.plant, controller, faults=faults, **parts).simulate(8.0, seed=1)
    said = "The model of controller is suspect, or several sensors have failed, one after another, from t = 5.52 s."
    assert result.suspicions == [said]
