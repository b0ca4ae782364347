"""Models of, and controllers for, FMUs with arrays."""

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.scenario import load_scenario


def test_a_model_of_elements_of_arrays(mixer):
    plant = mixer()
    mix = np.array(plant.start_value("K"))
    whole = controllers.LinearModel.from_fmu(plant, measured="y", actuated="u", dt=0.1)
    np.testing.assert_allclose(whole.matrix("C") @ whole.matrix("B"), 0.1 * mix, atol=1e-9)
    some = controllers.LinearModel.from_fmu(plant, measured=["y[2]", "total"], actuated=["u[2]", "u[0]"], dt=0.1)
    expected = 0.1 * np.array([mix[2], mix.sum(axis=0)])[:, [2, 0]]
    np.testing.assert_allclose(some.matrix("C") @ some.matrix("B"), expected, atol=1e-9)
    assert some.states == 2  # what moves the other elements alone is not in it
    # Inputs that are not actuated are held where they are said to be; of a vector by one number, or by one for each element.
    for at in ({"u": [0.0, 0.0, 0.0]}, {"u": 0.0}, {"u[1]": 0.0}):
        found = controllers.LinearModel.from_fmu(plant, measured="y", actuated="u[0]", dt=0.1, at=at, noise={"u": 0.1})
        C, Q = found.matrix("C"), found.matrix("process_covariance")
        np.testing.assert_allclose(C @ Q @ C.T, 1e-4 * mix @ mix.T, atol=1e-9)
    for settings, words, error in (
        ({"measured": "y[3]"}, r"no output 'y\[3\]'; did you mean 'y\[\d\]'", UnknownNameError),
        ({"measured": "total[0]"}, r"no output 'total\[0\]'; did you mean 'total'", UnknownNameError),
        ({"measured": "z[0]"}, "has no output 'z'", UnknownNameError),
        ({"measured": ["y", "y[1]"]}, r"'y\[1\]' repeats an element", ModelError),
        ({"actuated": ["u[1]", "u"]}, "'u' repeats an element", ModelError),
        ({"at": {"u": [0.0, 0.0]}}, "The operating point of u has the shape", ModelError),
        ({"noise": {"u[1]": -1.0}}, r"The noise has u\[1\]=-1", ModelError),
    ):
        with pytest.raises(error, match=words):
            controllers.LinearModel.from_fmu(plant, **{"measured": "y", "actuated": "u", "dt": 0.1} | settings)


@pytest.mark.slow
@pytest.mark.parametrize("names", [("y", "u"), (["y[0]", "y[1]", "y[2]"], ["u[0]", "u[1]", "u[2]"])])
def test_a_designed_controller_keeps_a_goal_while_a_sensor_of_an_element_fails(mixer, names):
    """Three coupled tanks in one array, each with two sensors; one sensor of the second is offset."""
    plant, (measured, actuated) = mixer(), names
    goals = [1.0, -0.5, 2.0]
    errors = {}
    for precision in (None, controllers.FixedPrecision()):
        controller = controllers.design(
            plant, measured=measured, actuated=actuated, dt=0.05, sensors=6, precision=precision, u_min=-5.0, u_max=5.0
        )
        loop = cosim.closed_loop(
            plant, controller, control=actuated, measured=measured, sensors=cosim.Sensors(count=6, std=0.01),
            faults=[cosim.Injection(sensor=1, start=2.0, magnitude=0.5)], reference=goals,
        )  # fmt: skip
        result = loop.simulate(5.0, seed=1, engine="interpreted")
        errors[precision] = np.sqrt(np.mean((result["plant.y"][60:] - goals) ** 2, axis=0))
        if precision is None:
            assert result["controller.fault_probability"][60:, 1].min() > 0.9
            assert result["controller.fault_probability"][60:, [0, 2, 3, 4, 5]].max() < 0.1
    assert errors[None].max() < 0.02
    assert errors[controllers.FixedPrecision()][1] > 0.1


@pytest.mark.slow
def test_a_goal_on_one_element_with_one_element_driven(mixer):
    plant = mixer()
    controller = controllers.design(
        plant, measured=["y[0]", "y[2]"], actuated="u[2]", goal="y[2]", dt=0.05, sensors=4, noise={"u[2]": 0.1}
    )
    assert controller.goal_matrix.shape == (1, controller.model.states)
    loop = cosim.closed_loop(
        plant, controller, control="u[2]", measured=["y[0]", "y[2]"], sensors=cosim.Sensors(count=4, std=0.01),
        input_faults={"u[2]": cosim.GainFault(factor=0.5, start=2.0), "u[1]": cosim.Freeze(start=1.0)},
        noise={"u[0]": cosim.Constant(0.0)}, reference=1.0,
    )  # fmt: skip
    assert [node.name for node in loop.nodes if "u_" in node.name] == [
        "u_2_gain_fault_0", "u_0_noise", "u_1_start", "u_1_freeze_0"
    ]  # fmt: skip
    result = loop.simulate(4.0, seed=1, engine="interpreted")
    assert np.abs(result["plant.y"][60:, 2] - 1.0).max() < 0.1
    assert [q.name for q in loop_signals(loop, result).quantities] == ["y[0]", "y[2]"]


def test_ports_of_arrays_are_named_by_element(mixer):
    diagram = cosim.Diagram(dt=0.1)
    node = diagram.add(mixer(), "plant")
    assert node["y[2]"] == node["y"][2]
    assert node["y[2]"].name == "plant.y[2]"
    with pytest.raises(UnknownNameError, match=r"has no port 'y\[3\]'"):
        node["y[3]"]


def test_goals_of_an_identified_model_by_array_or_element(mixer):
    diagram = cosim.Diagram(dt=0.1)
    plant = diagram.add(mixer(), "plant")
    moves = [diagram.add(cosim.Gaussian(std=1.0), f"move_{i}") for i in range(3)]
    sensors = diagram.add(cosim.Sensors(count=3, signals=3, std=0.01), "sensors")
    diagram.connect([move["y"] for move in moves], plant["u"])
    diagram.connect(plant["y"], sensors["u"])
    found = controllers.LinearModel.identify(
        diagram.simulate(100.0, seed=1, record=["plant.u", "sensors.y"], engine="interpreted"),
        inputs=["plant.u"], outputs=["sensors.y[0]", "sensors.y[2]"], order=2,
    )  # fmt: skip
    assert found.inputs == ("plant.u[0]", "plant.u[1]", "plant.u[2]")
    controller = controllers.design(found, goal="sensors.y")
    np.testing.assert_array_equal(controller.goal_matrix, controllers.design(found, goal=[0, 1]).goal_matrix)
    with pytest.raises(UnknownNameError, match=r"no output 'sensors\.y\[1\]'"):
        controllers.design(found, goal="sensors.y[1]")


def test_a_scenario_measures_and_drives_arrays(breadth, tmp_path):
    matrices = f"A = [[1, 0], [0, 1]]\nB = [[0.1, 0], [0, 0.1]]\nC = {np.tile(np.eye(2), (2, 1)).tolist()}"
    (tmp_path / "arrays.toml").write_text(
        f"""
[simulation]
duration = 3.0
[plant]
fmu = "{breadth("3")}"
control = "u"
measured = ["y", "total"]
[sensors]
count = 4
matrix = [[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0]]
std = 0.01
[[reference]]
kind = "Constant"
value = 1.0
[[reference]]
kind = "Constant"
value = -1.0
[model]
{matrices}
process_covariance = 1e-4
sensor_covariance = 1e-4
dt = 0.1
[controller]
kind = "BayesianController"
goal_on = [[1, 0], [0, 1]]
control_covariance = 100.0
"""
    )
    y = load_scenario(tmp_path / "arrays.toml").simulate(engine="interpreted")["plant.y"]
    np.testing.assert_allclose(y[-1], [1.0, -1.0], atol=0.05)
