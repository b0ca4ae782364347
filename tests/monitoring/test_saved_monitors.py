"""Monitors are written into model files, from which the same monitors come back."""

from dataclasses import fields, is_dataclass

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
    "switching": Monitor(0.1, RandomWalk(std=0.02), SENSORS, precision=controllers.SwitchingPrecision()),
    "own loss": Monitor(0.1, RandomWalk(std=0.02), SENSORS, precision=controllers.SwitchingPrecision(), own_loss=True),
    "gamma": Monitor(0.1, RandomWalk(std=0.02), SENSORS, precision=controllers.GammaPrecision(forgetting=0.9), joint=True),
}  # fmt: skip


def same(value, other):
    """Whether two settings are equal, lists and tuples and arrays alike."""
    if isinstance(value, list | tuple | np.ndarray):
        return len(value) == len(other) and all(map(same, value, other))
    if is_dataclass(value) and type(value) is type(other):
        return all(same(getattr(value, each.name), getattr(other, each.name)) for each in fields(value))
    if isinstance(value, dict):
        return list(value) == list(other) and all(same(value[name], other[name]) for name in value)
    return value == other


@pytest.mark.parametrize("name", MONITORS)
def test_the_same_monitor_comes_back(name, tmp_path):
    monitor = MONITORS[name]
    again = load_monitor(monitor.save(tmp_path / "model.toml"))
    assert again.model.step == monitor.model.step
    assert again.joint == (monitor.joint and monitor.precision is None)
    for each in fields(monitor):
        if each.name not in {"dt", "joint"}:
            value, other = getattr(monitor, each.name), getattr(again, each.name)
            assert same(value, other), (each.name, value, other)


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


class Settling(monitoring.PlantModel):
    """A model of one's own."""


class Walk(RandomWalk):
    """One that has the name of another."""


Walk.__name__ = "RandomWalk"


@pytest.mark.parametrize("plant", [Settling(), Walk(0.1)])
def test_a_class_of_ones_own_is_in_no_file(plant, tmp_path):
    with pytest.raises(
        ScenarioError, match=f"The class {type(plant).__name__} is your own, and a model file can name only"
    ):
        Monitor(0.1, plant, SENSORS).save(tmp_path / "model.toml")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere.*model[.]toml cannot be written: No such file"):
        MONITORS["plain"].save(tmp_path / "nowhere" / "model.toml")
