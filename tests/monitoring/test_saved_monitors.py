"""Monitors are written into model files, from which the same monitors come back."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from bayesftc import controllers, monitoring
from bayesftc.cosim.errors import RecordingError, ScenarioError
from bayesftc.monitoring import Alarm, Input, Monitor, RandomWalk, Sensor, SensorErrors, load_monitor

SENSORS = {
    "a": Sensor(std=0.1, unit="m", invalid=[-9999.0, "Bad Input"], resolution=0.01),
    "outlet 2 [°C]": Sensor(std=0.2, bias=0.5, gain=1.02, column="b", file="b.csv", held=True),
}
MONITORS = {
    "plain": Monitor(0.1, RandomWalk(std=0.02), SENSORS, joint=True),
    "thirds": Monitor("1/3", RandomWalk(std=0.02), SENSORS, time="t_ms", invalid=[-1.0], initial_mean=3.0, initial_std=2.0),
    "integrator": Monitor(
        0.02,
        monitoring.Integrator(std=0.05),
        SENSORS,
        {"acceleration": Input(bias=0.02, error_std=0.1, error_walk=0.01)},
        [SensorErrors(std=0.3, time_constant=600.0, sensors=["a"]), SensorErrors(0.1, 60.0, common=True)],
        alarm=Alarm(threshold=0.8),
    ),
    "matrices": Monitor(
        0.5,
        monitoring.Matrices(A=[[1.0, 0.5], [0.0, 0.9]], B=[[0.0], [0.5]], process_covariance=[1e-4, 1e-3]),
        {"a": Sensor(std=0.1, reads=(1.0, 0.0)), "b": Sensor(std=0.1, reads=(0.0, 1.0))},
        {"u": Input()},
        initial_mean=np.array([1.0, 0.0]),
        initial_std=(0.5, 0.1),
    ),
    "modes": Monitor(
        0.1,
        RandomWalk(std=0.02),
        SENSORS,
        precision=controllers.SwitchingPrecision((controllers.Frozen(resolution=0.01), controllers.Offset(jump=2.0)), loss=0.5),
    ),
    "gamma": Monitor(0.1, RandomWalk(std=0.02), SENSORS, precision=controllers.GammaPrecision(forgetting=0.9), joint=True),
}  # fmt: skip


@pytest.mark.parametrize("name", MONITORS)
def test_the_same_monitor_comes_back(name, tmp_path):
    monitor = MONITORS[name]
    again = load_monitor(monitor.save(tmp_path / "model.toml"))
    text = (tmp_path / "model.toml").read_text(encoding="utf-8")
    assert again.model.step == monitor.model.step
    for matrix in ("A", "B", "C", "process_covariance", "sensor_covariance"):
        np.testing.assert_array_equal(again.model.matrix(matrix), monitor.model.matrix(matrix))
    assert (again.joint, again.own_loss) == (monitor.joint and monitor.precision is None, monitor.own_loss)
    assert again.precision == monitor.precision
    assert again.alarm == monitor.alarm
    assert list(again.sensors) == list(monitor.sensors)
    again.save(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text(encoding="utf-8") == text


def test_a_fitted_monitor_judges_as_before_from_its_file(tmp_path):
    rng, t = np.random.default_rng(0), 0.1 * np.arange(400)
    level = 20.0 + np.cumsum(0.05 * rng.standard_normal(400))
    y = level[:, None] + 0.1 * rng.standard_normal((400, 3)) + [0.0, 0.0, 2.0]
    y[300:, 1] += 1.5
    table = pd.DataFrame(y, columns=["a", "b", "c"], index=t)
    monitor, _ = Monitor.fit(table)
    again = load_monitor(monitor.save(tmp_path / "model.toml"))
    one, other = monitor.run(table), again.run(table)
    np.testing.assert_array_equal(one.fault_probability, other.fault_probability)
    assert [event.sensor for event in other.events] == ["b"]


def test_a_class_of_ones_own_is_in_no_file(tmp_path):
    @dataclass(frozen=True)
    class Settling(monitoring.PlantModel):
        std: float

        def matrices(self, dt):
            return np.array([[0.9]]), None, np.array([[self.std]])

    with pytest.raises(ScenarioError, match=r"'model[.]kind' is 'Settling', which is no valid kind here"):
        Monitor(0.1, Settling(0.1), SENSORS).save(tmp_path / "model.toml")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere.*model[.]toml cannot be written: No such file"):
        MONITORS["plain"].save(tmp_path / "nowhere" / "model.toml")
