"""Values that devices send in place of a sample: for controllers, in loops and scenarios, for monitors."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus, monitoring
from bayesftc.controllers import (
    EFFDI,
    BayesianController,
    FixedPrecision,
    GammaPrecision,
    Proportional,
    StateEstimator,
)
from bayesftc.cosim.errors import ModelError, RecordingError
from bayesftc.scenario import load_scenario

MODEL = controllers.LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], 0.02)
READERS = [
    BayesianController(MODEL, EFFDI(), initial_mean=20.0),
    controllers.LQGController(MODEL, controllers.FixedPrecision(), initial_mean=20.0),
    controllers.NonlinearBayesianController(MODEL, GammaPrecision(), initial_mean=20.0, iterations=3),
    controllers.UnbiasedActiveInference(model=MODEL, law=Proportional(1.0), control="law", initial_mean=20.0),
    StateEstimator(MODEL, controllers.SwitchingPrecision(joint=False), initial_mean=20.0),
]


def run(block, y):
    step = block.online(compiled=False)
    return [step(y=row, **{port.name: 20.0 for port in block.inputs if port.name != "y"}) for row in y]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("block", READERS, ids=lambda block: type(block).__name__)
def test_a_sample_of_such_a_value_is_a_missing_one(block):
    rng = np.random.default_rng(0)
    y = 20.0 + rng.normal(size=(60, 2))
    gone = rng.random(y.shape) < 0.2
    sent = np.where(rng.random(y.shape) < 0.5, 19.0, -9999)
    for invalid, missing in (
        ([-9999, 19.0], gone),
        (([-9999, 19.0], []), gone & [True, False]),
        (np.array([-9999.0]), gone & (sent == -9999)),
    ):
        got = run(replace(block, invalid=invalid), np.where(gone, sent, y))
        expected = run(block, np.where(missing, np.nan, np.where(gone, sent, y)))
        for out, other in zip(got, expected, strict=True):
            for name in out:
                np.testing.assert_array_equal(out[name], other[name])


@pytest.mark.parametrize(
    ("invalid", "words"),
    [
        ([np.nan], "invalid=.* must be finite numbers"),
        (["x"], "must be finite numbers"),
        ([True], "must be finite numbers"),
        (None, "must be finite numbers"),
        ([[1.0], [2.0], [3.0]], "a list for each of 3 sensors, but there are 2"),
        ([[1.0], 2.0], "must be finite numbers"),
    ],
)
def test_other_values_are_refused(invalid, words):
    for block in (*READERS, cosim.Sensors(count=2)):
        with pytest.raises(ModelError, match=f"^{type(block).__name__} has .*{words}"):
            replace(block, invalid=invalid)


def loop(controller, invalid):
    return cosim.closed_loop(
        cosim.FMU(fmus.path("CruiseControl")),
        controller,
        control="force",
        measured="v",
        sensors=cosim.Sensors(count=2, std=1.0, invalid=invalid),
        faults=[cosim.Stuck(at=65535.0, sensor=0, start=2.0, stop=4.0)],
        reference=20.0,
    )


def test_sensors_of_a_loop_give_them_to_the_controller():
    own = BayesianController(MODEL, FixedPrecision(), initial_mean=20.0, invalid=[65535])
    results = [
        loop(controller, invalid).simulate(6.0, seed=1)
        for controller, invalid in ((replace(own, invalid=()), [65535]), (own, ()), (own, [65535]))
    ]
    assert results[0]["stuck_0.y"].max() == 65535.0
    for result in results:
        np.testing.assert_array_equal(result["controller.x_hat"], results[0]["controller.x_hat"])
        assert np.abs(result["controller.x_hat"][:, 0] - result["plant.v"])[100:].max() < 2.0
        stuck = result["stuck_0.y"][:, 0] == 65535.0
        np.testing.assert_array_equal(np.isnan(result["controller.innovation"][:, 0]), stuck)
    with pytest.raises(ModelError, match="leave one of them out"):
        loop(own, [-1.0])


class Plain(cosim.Block):
    """A controller that knows of no such values."""

    sample_time = None
    inputs = cosim.Port("y", (2,)), cosim.Port("goal")
    outputs = (cosim.Port("u"),)


def test_a_controller_without_the_setting_is_named():
    with pytest.raises(ModelError, match="Plain, has no setting 'invalid'"):
        cosim.closed_loop(
            cosim.FMU(fmus.path("CruiseControl")), Plain(), control="force", measured="v", reference=20.0, dt=0.02,
            sensors=cosim.Sensors(count=2, invalid=[0.0]),
        )  # fmt: skip


def test_scenario_files_name_them(tmp_path):
    from importlib.resources import files

    text = (files("bayesftc.examples.cruise_control") / "cruise_control.toml").read_text()
    sensors = text.replace("[sensors]\n", "[sensors]\ninvalid = [[-9999], [65535, 0]]\n")
    file = tmp_path / "car.toml"
    file.write_text(sensors)
    assert load_scenario(file).controller.invalid == ((-9999,), (65535, 0))
    file.write_text(text.replace("[controller]\n", "[controller]\ninvalid = [-9999, 65535]\n"))
    assert load_scenario(file).controller.invalid == (-9999, 65535)
    file.write_text(sensors.replace("65535, 0", "'x'"))
    with pytest.raises(cosim.errors.BayesFTCError, match="invalid"):
        load_scenario(file)


def recording(folder, of_all="", of_speed=""):
    """Write a recording of two sensors, and return it monitored."""
    t, rng = np.arange(0.0, 20.0, 0.02), np.random.default_rng(0)
    v = 10.0 + np.cumsum(0.005 * rng.normal(size=len(t)))
    speed, wheel = np.round(v + 0.05 * rng.normal(size=len(t)), 4), np.round(v + 0.05 * rng.normal(size=len(t)), 4)
    speed[[0, 200, 201, 500]], wheel[[0, 300]] = -9999, 65535
    (folder / "model.toml").write_text(
        f'dt = 0.02\n{of_all}\n[model]\nkind = "RandomWalk"\nstd = 0.05\n'
        f"[sensors.speed]\nstd = 0.05\n{of_speed}\n[sensors.wheel]\nstd = 0.05\n"
    )
    rows = "".join(f"{a:.2f},{b},{c}\n" for a, b, c in zip(t, speed, wheel, strict=True))
    (folder / "drive.csv").write_text("t,speed,wheel\n" + rows)
    monitor = monitoring.load_monitor(folder / "model.toml")
    return monitor.run(monitor.read([folder / "drive.csv"]), compiled=False)


@pytest.mark.slow
def test_a_model_file_names_them_for_all_columns_or_for_one(tmp_path):
    for of_all, of_speed in (
        ("invalid = [-9999, 65535]", ""),
        ("invalid = 65535".replace("65535", "[65535]"), "invalid = [-9999]"),
    ):
        found = recording(tmp_path, of_all, of_speed)
        assert np.abs(found.recording.y[np.isfinite(found.recording.y)] - 10.0).max() < 2.0
        assert not found.events
    assert not np.isnan(recording(tmp_path).recording.y).any()
    with pytest.raises(cosim.errors.BayesFTCError, match="its values must be finite numbers"):
        recording(tmp_path, "invalid = [nan]")


def test_a_signal_leaves_them_out():
    signal = monitoring.Signal([0, 1, 2, 3], [1.0, -1.0, 65535.0, 2.0], invalid=[-1.0, 65535.0])
    assert signal.values.tolist() == [1.0, 2.0]
    with pytest.raises(RecordingError, match="has no samples"):
        monitoring.Signal([0, 1], [5.0, 5.0], invalid=[5.0])


def test_absurd_samples_do_not_hide_a_resolution():
    samples = np.round(10.0 + np.random.default_rng(2).normal(size=1000), 2)
    for value in (2147483647.0, 1e20, -1e300):
        samples[[5, 500]] = value
        assert controllers.find_resolution(samples) == pytest.approx(0.01)


def test_an_absurd_first_sample_of_a_recording_does_no_harm(tmp_path):
    t = np.arange(300) * 0.02
    y = 10.0 + 0.05 * np.random.default_rng(1).normal(size=(300, 2))
    y[0, 0], y[150] = 1e20, -1e20
    (tmp_path / "model.toml").write_text(
        'dt = 0.02\n[model]\nkind = "RandomWalk"\nstd = 0.05\n[sensors.a]\nstd = 0.05\n[sensors.b]\nstd = 0.05\n'
    )
    monitor = monitoring.load_monitor(tmp_path / "model.toml")
    signals = {name: monitoring.Signal(t, y[:, i]) for i, name in enumerate("ab")}
    found = monitor.run(monitoring.align(signals, {}, 0.02), compiled=False)
    assert np.abs(found.x_hat[:, 0] - 10.0).max() < 0.3
    assert found.fault_probability[0, 0] == 1.0
    assert (found.fault_probability[150] == 1.0).all()
    assert {round(event.start, 2) for event in found.events} == {0.0, 3.0}
