"""Results: names, shapes, tables, files that are whole or not there."""

import builtins
import json
import os
import pickle
import re
import zipfile
from fractions import Fraction
from itertools import permutations
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim import Port, Result
from bayesftc.cosim.judging.blame import alarms_of_all
from bayesftc.scenario import load_scenario


def write(t, k, a, b, c):
    a[0] = t
    for i in range(2):
        b[i] = k + i
        for j in range(3):
            c[i, j] = 100.0 * k + 10 * i + j


@pytest.fixture
def result(make_block):
    diagram = cosim.Diagram("1/30")
    ports = [Port("a", unit="s"), Port("b", (2,)), Port("c", (2, 3), unit="m")]
    diagram.add(make_block(outputs=ports, output=write), "block")
    return diagram.simulate("1/2", seed=3, decimation=2)


@pytest.fixture
def partial(make_block):
    def odd(k, y):
        y[0] = 1.0 / (2 - k)
        y[1] = -0.0

    diagram = cosim.Diagram(1)
    diagram.add(make_block(outputs=[Port("y", (2,))], output=odd, finite=True), "p")
    with pytest.raises(cosim.SimulationError) as caught:
        diagram.simulate(9)
    return caught.value.result


def test_a_signal_without_a_unit_has_that_of_its_connections(tmp_path):
    """A control has the unit of the plant's input, samples that of the measured variable, also behind faults."""
    loop = load_scenario("cruise_control").loop()
    result = loop.simulate(0.1, engine="interpreted", record=["*", "controller.y"])
    units = {"controller.u": "N", "controller.y": "m/s", "sensors.y": "m/s", "freeze_0.y": "m/s", "plant.v": "m/s"}
    result.save(tmp_path / "run.npz")
    for one in (result, pickle.loads(pickle.dumps(result)), Result.load(tmp_path / "run.npz")):
        assert {name: one.units.get(name) for name in units} == units
        assert "controller.precision" not in one.units


def test_signals(result):
    assert list(result) == ["block.a", "block.b", "block.c"]
    assert len(result) == 3
    assert "block.b" in result
    assert result.units == {"block.a": "s", "block.c": "m"}
    assert [result[name].shape for name in result] == [(8,), (8, 2), (8, 2, 3)]
    np.testing.assert_array_equal(result["block.a"], result.time)
    np.testing.assert_array_equal(result.time, [k / 30 for k in range(0, 15, 2)])
    assert result["block.c"][3].tolist() == [[600, 601, 602], [610, 611, 612]]
    assert all(np.shares_memory(result[name], result[name]) for name in result)  # views, no copies
    assert repr(result) == "<Result: 3 signals, 8 rows to t = 0.466667 s>"
    assert result.stopped is None
    with pytest.raises(cosim.UnknownNameError, match=r"no signal 'block.d'; known names: block.a, block.b, block.c\.$"):
        result["block.d"]
    with pytest.raises(cosim.UnknownNameError, match=r"no signal 'block.u'; known names: block.a,"):
        result["block.u"]
    with pytest.raises(cosim.UnknownNameError, match=r"no signal 'quad.c'; did you mean 'block.c'\?$"):
        result["quad.c"]
    with pytest.raises(cosim.UnknownNameError, match="no signal 0"):
        result[0]
    with pytest.raises(
        cosim.UnknownNameError, match=r"one signal at a time.*to_pandas\(\)\[\['block.a', 'block.b'\]\]"
    ):
        result[["block.a", "block.b"]]
    assert result.get("nothing") is None
    assert result == result
    assert result != pickle.loads(pickle.dumps(result))


def test_a_signal_that_was_not_recorded_is_told_from_one_that_does_not_exist(tmp_path):
    diagram = cosim.Diagram(0.1)
    diagram.connect(diagram.add(cosim.Ramp(1.0), "ramp")["y"], diagram.add(cosim.Gain(2.0), "double")["u"])
    run = diagram.build().simulate(1.0, engine="interpreted")
    with pytest.raises(
        cosim.UnknownNameError, match=r"^The signal 'double.u' was not recorded. .*\['\*', 'double.u'\]\)\.$"
    ):
        run["double.u"]
    for wrong in ("double.uu", "dubble.u", "u"):
        with pytest.raises(
            cosim.UnknownNameError, match=rf"no signal '{wrong}'; did you mean '?[^=]*'double.u'[^=]*\?$"
        ):
            run[wrong]
    with pytest.raises(
        cosim.UnknownNameError, match=r"no signal 'double.mass'; did you mean [^=]*\?$|known names: [^=]*$"
    ):
        run["double.mass"]
    part = diagram.simulate(1.0, engine="interpreted", record="ramp.y")
    part.save(tmp_path / "run.npz")
    for one in (part, pickle.loads(pickle.dumps(part)), Result.load(tmp_path / "run.npz")):
        with pytest.raises(cosim.UnknownNameError, match=r"'double\.y' was not recorded"):
            one["double.y"]


def test_to_pandas(result):
    table = result.to_pandas()
    assert list(table.columns[:4]) == ["block.a", "block.b[0]", "block.b[1]", "block.c[0,0]"]
    assert table.columns[-1] == "block.c[1,2]"
    assert table.index.name == "time"
    np.testing.assert_array_equal(table.index, result.time)
    np.testing.assert_array_equal(table["block.c[1,2]"], result["block.c"][:, 1, 2])
    np.testing.assert_array_equal(table["block.b[1]"], result["block.b"][:, 1])


def test_to_control(result, partial):
    import control

    response = result.to_control()
    assert isinstance(response, control.TimeResponseData)
    assert response.output_labels[:4] == ["block.a", "block.b[0]", "block.b[1]", "block.c[0,0]"]
    np.testing.assert_array_equal(response.outputs, result.to_pandas().to_numpy().T)
    np.testing.assert_array_equal(response.time, result.time)
    chosen = result.to_control(["block.b", "block.a"])
    assert chosen.output_labels == ["block.b[0]", "block.b[1]", "block.a"]
    np.testing.assert_array_equal(chosen.outputs[2], result["block.a"])
    assert result.to_control("block.a").outputs.shape == (1, len(result.time))
    assert partial.to_control().outputs.shape[1] == len(partial.time)
    with pytest.raises(cosim.UnknownNameError, match=r"did you mean 'block\.a'"):
        result.to_control(["blok.a"])


def test_to_xarray(result):
    data = result.to_xarray()
    assert set(data.data_vars) == set(result)
    assert data["block.c"].dims == ("time", "block.c_0", "block.c_1")
    assert data["block.c"].attrs == {"units": "m"}
    assert data["time"].attrs == {"units": "s"}
    assert json.loads(data.attrs["metadata"])["seed"] == 3
    np.testing.assert_array_equal(data["block.c"], result["block.c"])
    np.testing.assert_array_equal(data["time"], result.time)


def same(a, b, same_bits):
    assert list(a) == list(b)
    for name in a:
        same_bits(a[name], b[name])
    same_bits(a.time, b.time)
    assert (a.units, a.metadata, a.stopped, a.step, a.decimation) == (
        b.units,
        b.metadata,
        b.stopped,
        b.step,
        b.decimation,
    )


@pytest.mark.parametrize("which", ["result", "partial"])
def test_round_trips(which, request, tmp_path, same_bits):
    original = request.getfixturevalue(which)
    path = original.save(tmp_path / "run.bayesftc")
    assert os.listdir(tmp_path) == ["run.bayesftc"]
    same(Result.load(path), original, same_bits)
    same(Result.load(str(path)), original, same_bits)
    same(pickle.loads(pickle.dumps(original)), original, same_bits)
    assert (original.stopped is None) == (which == "result")
    original.save(path)  # overwrites


def test_save_and_load_keep_every_bit(tmp_path, same_bits):
    rng = np.random.default_rng(1)
    values = rng.integers(0, 2**64, (50, 3), dtype=np.uint64).view(np.float64)
    values[:4, 0] = [np.nan, np.inf, -0.0, 5e-324]
    result = Result(values, {"a.y": (0, ()), "b.y": (1, (2,))}, cosim.Diagram("1/7").step, stopped="It stopped: ü.")
    back = Result.load(result.save(tmp_path / "r"))
    np.testing.assert_array_equal(back._recording.view(np.uint64), values.view(np.uint64))
    assert back.stopped == "It stopped: ü."


def test_empty_results(tmp_path, same_bits, make_block):
    empty = cosim.Diagram(1).simulate(2)
    same(Result.load(empty.save(tmp_path / "empty")), empty, same_bits)
    nothing = cosim.Diagram(1)
    nothing.add(make_block(outputs=[Port("y", (2, 2))], output=_nan, finite=True), "n")
    with pytest.raises(cosim.SimulationError) as caught:
        nothing.simulate(2)
    rows = caught.value.result
    assert rows["n.y"].shape == (0, 2, 2)
    assert rows.to_pandas().shape == (0, 4)
    assert rows.to_xarray()["n.y"].shape == (0, 2, 2)
    same(Result.load(rows.save(tmp_path / "none")), rows, same_bits)


def _nan(t, y):
    y[0, 0] = t / t


@pytest.mark.parametrize("name", ["run.csv", "run.Parquet"])
def test_a_table_is_not_written_under_the_name_of_one(tmp_path, result, name):
    with pytest.raises(cosim.ResultFileError, match=r"Name the file run\.npz; or make a table: result\.to_pandas"):
        result.save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_files_that_are_no_results(tmp_path, result):
    with pytest.raises(cosim.ResultFileError, match=r"There is no result file .*nowhere; check the path"):
        Result.load(tmp_path / "nowhere")
    with pytest.raises(cosim.ResultFileError, match="There is no result file"):
        Result.load(tmp_path)
    foreign = {
        "empty": b"", "text": b"time,v\n0,1\n", "pickle": pickle.dumps([1]), "zip head": b"PK\x03\x04" + b"0" * 50,
        "npy head": b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'",
    }  # fmt: skip
    for name, content in foreign.items():
        (tmp_path / name).write_bytes(content)
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "arrays.npz", x=np.zeros(3))
    np.savez(tmp_path / "objects.npz", header=np.array([{}], dtype=object), recording=np.zeros(3))
    with zipfile.ZipFile(tmp_path / "fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<a/>")
    good = {
        "format": "bayesftc-result-1",
        "step": "1/2",
        "decimation": 1,
        "columns": {"a": [0, []]},
        "units": {},
        "metadata": {},
    }
    headers = {
        "list": [1],
        "other format": {**good, "stopped": None, "format": "x"},
        "no stopped": good,
        "wide": {**good, "stopped": None, "columns": {"a": [0, [9]]}},
        "zero step": {**good, "stopped": None, "step": "1/0"},
        "columns": {**good, "stopped": None, "columns": [1]},
        "text": "x",
    }
    for name, header in headers.items():
        np.savez(tmp_path / f"{name}.npz", header=np.array(json.dumps(header)), recording=np.zeros((3, 1)))
    np.savez(tmp_path / "flat.npz", header=np.array(json.dumps({**good, "stopped": None})), recording=np.zeros(3))
    np.savez(tmp_path / "fine.npz", header=np.array(json.dumps({**good, "stopped": None})), recording=np.zeros((3, 1)))
    for path in tmp_path.iterdir():
        if path.name == "fine.npz":
            assert Result.load(path)["a"].tolist() == [0, 0, 0]
            continue
        with pytest.raises(cosim.ResultFileError, match=r"is not a result file of bayesftc, or it is damaged"):
            Result.load(path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_noticed(result, tmp_path, data, same_bits):
    whole = result.save(tmp_path / "r").read_bytes()
    where = data.draw(st.integers(0, len(whole) - 1))
    cut = (
        whole[:where]
        if data.draw(st.booleans())
        else whole[:where] + bytes([whole[where] ^ data.draw(st.integers(1, 255))]) + whole[where + 1 :]
    )
    (tmp_path / "damaged").write_bytes(cut)
    try:
        loaded = Result.load(tmp_path / "damaged")
    except cosim.ResultFileError:
        return
    same(loaded, result, same_bits)  # a byte that the zip format does not need, such as a date


def test_a_write_that_fails_leaves_what_was_there(result, tmp_path, monkeypatch):
    path = result.save(tmp_path / "r")
    before = path.read_bytes()

    def full_disk(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(
        cosim.ResultFileError, match=r"cannot be written to .*r: No space left on device; choose another folder"
    ):
        result.save(path)
    with pytest.raises(cosim.ResultFileError, match="No space left"):
        result.save(tmp_path / "new")

    def interrupted(file, **arrays):
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez_compressed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        result.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["r"]
    assert path.read_bytes() == before


def test_places_that_cannot_be_written(result, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    for path in ("nowhere/r", "folder", "file/r", "x" * 400):
        with pytest.raises(cosim.ResultFileError, match=r"The result cannot be written to "):
            result.save(tmp_path / path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "folder"]


def test_a_file_that_cannot_be_read(result, tmp_path, monkeypatch):
    path = result.save(tmp_path / "r")

    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(builtins, "open", refuse)
    with pytest.raises(cosim.ResultFileError, match=r"cannot be read: Permission denied"):
        Result.load(path)


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_the_file_has_the_users_own_permissions(result, tmp_path):
    old = os.umask(0o077)
    try:
        path = result.save(tmp_path / "private")
    finally:
        os.umask(old)
    assert Path(path).stat().st_mode & 0o777 == 0o600


def test_a_result_says_from_when_on_the_model_is_suspect():
    run = cosim.Result(np.array([[0.1], [0.6], [0.2]]), {"ctrl.model_suspect": (0, ())}, Fraction(1, 2))
    suspect = "model of ctrl suspect from t = 0.5 s (controllers.diagnose(result, loop) looks for the cause)"
    assert repr(run) == f"<Result: 1 signal, 3 rows to t = 1 s, {suspect}>"
    assert run.suspicions == ["The model of ctrl is suspect from t = 0.5 s."]


@pytest.mark.parametrize("mean", [0.0, 20.0])
def test_a_result_says_that_the_belief_began_elsewhere_than_the_plant(mean):
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 1e-3, 1.0, dt=0.02)
    controller = controllers.BayesianController(
        model, controllers.SwitchingPrecision(start_doubt=0.0), initial_mean=mean, initial_covariance=0.01
    )
    loop = cosim.closed_loop(
        cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}), controller, control="force", measured="v",
        sensors=cosim.Sensors(2, 1.0), reference=20.0,
    )  # fmt: skip
    notes = loop.simulate(2.0, seed=1).notes
    wrong = "the controller's belief at the start (initial_mean, initial_spread) or its model is wrong"
    assert notes == ([f"both sensors of v agree but are blamed from t = 0 s: {wrong}"] if mean == 0.0 else [])


def test_a_result_says_that_sensors_are_noisier_than_stated_and_how_noisy():
    """All kinds said so, but the note blamed the plant, and asked for an estimated load."""
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]] * 3, 1e-3, 1.0, dt=0.02)
    loop = cosim.closed_loop(
        cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}),
        controllers.BayesianController(model, initial_mean=20.0), control="force", measured="v",
        sensors=cosim.Sensors(3, 6.0), reference=20.0,
    )  # fmt: skip
    result = loop.simulate(8.0, seed=1)
    (note,) = [note for note in result.notes if note.startswith("all 3 sensors of v")]
    assert "because they are noisier than the model says" in note
    assert float(re.search(r"a standard deviation of about ([\d.]+) m/s\. State", note)[1]) == pytest.approx(
        6.0, rel=0.1
    )
    assert "behaves unlike" not in repr(result.summary())


def test_noise_that_all_sensors_share_is_not_called_theirs():
    """The plant moves more than its model, so that all are called noisier; their differences are as stated."""
    model = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0]] * 3, 1e-3, 1.0, dt=0.02)
    system = control.ss([[0.999]], [[2e-4]], [[1.0]], 0, 0.02, inputs=["force"], outputs=["v"])
    loop = cosim.closed_loop(
        cosim.StateSpace(system, initial=[20.0], process_noise=[[30.0]]),
        controllers.BayesianController(model, initial_mean=20.0), control="force", measured="v",
        sensors=cosim.Sensors(3, 1.0), reference=20.0,
    )  # fmt: skip
    notes = [note for seed in range(4) for note in loop.simulate(8.0, seed=seed).notes]
    assert any("agree but are blamed" in note or "suspect" in note for note in notes)
    assert not any("noisier" in note for note in notes)


def _two_masses(stiffness: float, damping: float) -> control.StateSpace:
    A = [
        [0, 1, 0, 0],
        [-stiffness / 0.01, -(damping + 0.05) / 0.01, stiffness / 0.01, damping / 0.01],
        [0, 0, 0, 1],
        [stiffness / 0.02, damping / 0.02, -stiffness / 0.02, -(damping + 0.01) / 0.02],
    ]
    return control.ss(
        A, [[0, 0], [50, 0], [0, 0], [0, 50]], [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0]], 0,
        inputs=["voltage", "load"], outputs=["load_angle", "motor_angle", "motor_speed"],
    )  # fmt: skip


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_a_result_says_that_a_healthy_sensor_is_blamed_often(factor):
    measured, std = ["load_angle", "motor_angle", "motor_speed"], (0.002, 0.002, 0.002, 0.05)
    controller = controllers.design(
        _two_masses(5.0, 0.02), measured=measured, actuated="voltage", sensors=[2, 1, 1], sensor_std=std, goal="load_angle",
        dt=0.005, noise={"load": 0.05}, acceptable_error=0.05, acceptable_control=5.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        _two_masses(factor * 5.0, factor * 0.02), controller, control="voltage", measured=measured,
        sensors=cosim.Sensors(count=[2, 1, 1], std=std), noise={"load": cosim.Gaussian(std=0.05)},
        reference=cosim.Sine(amplitude=0.5, period=3.0),
    )  # fmt: skip
    result = loop.simulate(4.0, seed=1)
    if factor == 1.0:
        assert not result.notes
        assert not result.summary().notes
        return
    (note,) = result.notes
    assert re.fullmatch(r"sensor 2 \(motor_angle\) is blamed for 3\d% of its fault-free time", note)
    assert repr(result).endswith(f", {note}>")
    (sentence,) = result.summary().notes
    assert sentence.startswith(f"S{note[1:]}. Look at the model first. ")


def _turbine(stated):
    """Return a run of a rotor whose pitch has one sensor and no noise, with a model that states some."""
    measured, std = ["speed", "pitch"], [0.004, 0.004, 0.01, 0.002]
    A = [[-0.2, -1.8, 1.0], [0.0, -1 / 0.3, 0.0], [0.0, 0.0, -0.25]]
    plant = control.ss(
        A, [[0, 0], [1 / 0.3, 0], [0, 0.25]], np.eye(2, 3), 0, inputs=["command", "gust"], outputs=measured
    )
    controller = controllers.design(
        plant, measured=measured, actuated="command", sensors=[3, 1], sensor_std=std, goal="speed", dt=0.1,
        noise={"gust": 0.4, "command": stated}, acceptable_error=0.05, acceptable_control=0.05,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="command", measured=measured, sensors=cosim.Sensors(count=[3, 1], std=std, unit="rad"),
        noise={"gust": cosim.Gaussian(std=0.4)}, reference=0.0,
    )  # fmt: skip
    return loop.simulate(60.0, seed=1)


def _compass(stated):
    """Return a run of a vehicle that only a compass sees and nothing moves, with a model that states a noise of the torque."""
    plant = control.ss(
        [[0, 1], [0, -0.2]], [[0, 0], [1 / 30, 1 / 30]], [[1, 0]], 0, inputs=["torque", "gust"], outputs=["heading"]
    )
    controller = controllers.design(
        plant, measured="heading", actuated="torque", sensors=1, sensor_std=0.02, dt=0.1, noise={"gust": stated},
        acceptable_error=0.1, acceptable_control=50.0,
    )  # fmt: skip
    loop = cosim.closed_loop(
        plant, controller, control="torque", measured="heading", sensors=cosim.Sensors(1, std=0.02, unit="rad"),
        reference=0.0,
    )  # fmt: skip
    return loop.simulate(120.0, seed=1)


def test_a_process_noise_that_is_stated_too_large_is_named_where_it_makes_a_sensor_blamed():
    result = _compass(20.0)
    blamed = result.findings().iloc[0]
    assert (blamed["kind"], blamed["unit"]) == ("Unmodelled", "x noise from the belief")
    (sentence,) = result.summary().notes
    assert re.match(r"Sensor 0 is blamed for \d\d% of its fault-free time\. While it is blamed, ", sentence)
    apart, expected = map(float, re.findall(r"by ([\d.]+) rad .* expects \(([\d.]+) rad", sentence)[0])
    assert apart < 0.7 * expected
    assert "The process noise of the model (noise= in design, process_covariance) is probably too large." in sentence
    assert "Look at the model first" not in sentence


@pytest.mark.parametrize("stated", [0.01, 0.1])
def test_it_makes_no_sensor_blamed_beside_others(stated):
    """The pitch's only sensor was blamed for 77 to 98 % of the time."""
    result = _turbine(stated)
    assert not len(result.findings())
    assert not result.summary().notes


def test_agreement_is_that_of_all_pairs_of_sensors_in_any_order():
    rng = np.random.default_rng(0)
    noise, late = 0.1 * rng.standard_normal((3, 200)), np.arange(200) >= 60
    alarms = [late] * 3
    assert alarms_of_all(list(noise), alarms) == 60
    apart = noise + np.array([[0.0], [-0.25], [0.25]]) * late
    assert all(alarms_of_all([apart[i] for i in order], alarms) is None for order in permutations(range(3)))
    gaps = noise.copy()
    gaps[0, ::9] = np.nan
    assert alarms_of_all(list(gaps), alarms) == 60
    gaps[0, ::2], gaps[1, 1::2] = np.nan, np.nan
    assert alarms_of_all(list(gaps), alarms) is None  # never compared


def test_a_fault_of_the_actuator_is_no_wrong_belief_at_the_start():
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    control = pytest.importorskip("control")
    plant = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["u"], outputs=["y"])
    loop = cosim.closed_loop(
        plant, controllers.LQGController(model, controllers.SwitchingPrecision()), control="u", measured="y",
        sensors=cosim.Sensors(2, 0.1), reference=5.0, input_faults={"u": cosim.GainFault(factor=0.0, start=1.0)},
    )  # fmt: skip
    for run in (loop.simulate(20.0), loop.simulate(150.0, decimation=50)):
        assert not any("at the start" in note for note in run.notes)
