"""Names of signals that go with a linear model to python-control and back."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import LinearModel
from bayesftc.cosim.errors import ModelError, UnknownNameError

SYSTEM = control.ss(
    [[0.9, 0.1], [0.0, 0.8]], [[0.0], [0.1]], [[1.0, 0.0], [0.0, 1.0]], 0, 0.1,
    inputs=["force"], outputs=["v", "current"], states=["speed", "motor"],
)  # fmt: skip
NOISE = {"process_covariance": 1e-3, "sensor_covariance": 0.1}


def labels(system):
    return system.input_labels, system.output_labels, system.state_labels


def test_names_survive_both_ways():
    model = LinearModel.from_control(SYSTEM, **NOISE)
    back = model.to_control()
    assert labels(back) == labels(SYSTEM)
    assert back.dt == 0.1
    for name in "ABC":
        np.testing.assert_array_equal(getattr(back, name), getattr(SYSTEM, name))
    assert not back.D.any()
    again = LinearModel.from_control(back, **NOISE)
    assert again.names == model.names


def test_a_continuous_system_keeps_its_names():
    slow = control.ss([[-1.0]], [[1.0]], [[1.0]], 0, inputs=["heat"], outputs=["T"], states=["energy"])
    assert labels(LinearModel.from_control(slow, dt=0.1, **NOISE).to_control()) == (["heat"], ["T"], ["energy"])


def test_redundant_sensors_get_numbers_and_disturbances_names():
    model = LinearModel.from_control(SYSTEM, sensors=4, **NOISE).with_disturbance().with_sensor_errors(0.1, 10.0, [0])
    system = model.about([1.0, 2.0], [0.5], [1.0, 2.0, 1.0, 2.0]).to_control()
    assert system.output_labels == ["v[0]", "current[0]", "v[1]", "current[1]"]
    assert system.state_labels == ["speed", "motor", "disturbance[0]", "sensor_error[0]"]
    twice = model.with_sensor_errors(0.2, 100.0)
    errors = ["sensor_error[0]", "sensor_error[0]_2", "sensor_error[1]", "sensor_error[2]", "sensor_error[3]"]
    assert list(twice.state_names[3:]) == errors


def test_a_model_without_names_has_those_of_python_control():
    system = LinearModel([[0.5]], [[1.0]], [[1.0], [1.0]], 1e-3, 0.1, dt=0.1).to_control()
    assert labels(system) == (["u[0]"], ["y[0]", "y[1]"], ["x[0]"])


def test_an_fmu_and_a_design_give_the_names_of_their_variables():
    servo = fmus.path("PositionServo")
    model = LinearModel.from_fmu(servo, measured="angle", actuated="voltage", sensors=2)
    assert labels(model.to_control())[:2] == (["voltage"], ["angle[0]", "angle[1]"])


def test_wrong_names_are_refused():
    model = LinearModel.from_control(SYSTEM, **NOISE)
    with pytest.raises(ModelError, match="names for 1 sensors, but it has 2 sensors"):
        replace(model, names=controllers.SignalNames(["force"], ["v"], ["speed", "motor"]))


def test_a_model_may_stand_for_the_plant_of_a_loop():
    system = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1, inputs=["force"], outputs=["v"])
    model = LinearModel.from_control(system, sensors=2, process_covariance=1e-3, sensor_covariance=0.1)
    controller = controllers.LQGController(model, goal_covariance=0.01)
    loop = cosim.closed_loop(
        cosim.StateSpace(system),
        controller,
        control="force",
        measured="v",
        sensors=cosim.Sensors(2, 0.3),
        reference=1.0,
    )
    np.testing.assert_allclose(loop.linear(plant=model.to_control()).poles(), loop.poles(), atol=1e-12)


def test_from_control_names_what_it_needs():
    for given in ({}, {"process_covariance": 1e-3}, {"sensor_covariance": 0.1}):
        with pytest.raises(ModelError, match=r"needs process_covariance= and sensor_covariance="):
            LinearModel.from_control(SYSTEM, **given)
    with pytest.raises(ModelError, match=r"LinearModel\.from_control\(system, process"):
        LinearModel(SYSTEM, [[1.0]], [[1.0]], 1e-3, 0.1, dt=0.1)


@pytest.mark.parametrize("poles", [[-2.0], [-0.5], [-0.5, -0.1], [0.0, -0.2], [-0.1 + 2j, -0.1 - 2j], [3.0, -3.1, 0.0]])
def test_matrices_of_continuous_time_are_warned_of_at_the_line_of_the_user(poles):
    n = len(poles)
    A = np.vstack([np.eye(n)[1:], -np.poly(poles)[:0:-1].real])
    B, C = np.eye(n)[:, -1:], np.eye(n)[:1]
    with pytest.warns(
        UserWarning, match=r"of one step.*LinearModel\.from_control\(control\.ss\(A, B, C, 0\)"
    ) as warned:
        model = LinearModel(A, B, C, 1e-3, 0.1, dt=0.02)
    assert warned[0].filename == __file__
    with warnings.catch_warnings():  # once
        warnings.simplefilter("error")
        replace(model, sensor_covariance=0.2)
        model.with_disturbance()
        model.with_delays(1)
    for dt in (0.001, 0.02, 0.5):  # sampled, the same plant has a right model
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            right = LinearModel.from_control(control.ss(A, B, C, 0), dt=dt, **NOISE)
            LinearModel(right.A, right.B, right.C, 1e-3, 0.1, dt=dt)


@pytest.mark.parametrize("A", [[[0.0, 1.0], [0.0, 0.0]], [[0.0]], [[0.9, 0.0], [0.0, -0.2]], [[0.0, -0.9], [0.9, 0.0]]])
def test_discrete_models_with_dead_times_and_ringing_are_not_warned_of(A):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LinearModel(A, np.eye(len(A))[:, -1:], np.eye(len(A))[:1], 1e-3, 0.1, dt=0.02)


def tanks(inputs=2):
    return control.ss([[-0.1, 0.0], [0.1, -0.1]], np.eye(2)[:, :inputs], np.eye(2)[1:], 0)


@pytest.mark.parametrize(("inputs", "plain"), [(1, ["u"]), (2, ["u0", "u1"])])
def test_default_labels_of_python_control_name_signals(inputs, plain):
    """A user of python-control knows the signals of a system without names as u[0] and y[0]."""
    system, settings = tanks(inputs), {"sensors": 2, "sensor_std": 0.01, "dt": 0.5}
    theirs = controllers.design(system, measured="y[0]", actuated=system.input_labels, goal="y[0]", **settings)
    ours = controllers.design(system, measured="y", actuated=plain, **settings)
    assert theirs.model.names == ours.model.names
    np.testing.assert_array_equal(theirs.model.B, ours.model.B)
    loop = cosim.closed_loop(
        plant=system, controller=theirs, control=system.input_labels, measured="y[0]", reference=1.0,
        sensors=cosim.Sensors(count=2, std=0.01),
    )  # fmt: skip
    assert np.isfinite(loop.simulate(1.0, engine="interpreted")["plant.y"]).all()
    with pytest.raises(UnknownNameError, match=r"no output 'y\[1\]'"):
        controllers.design(system, measured="y[1]", actuated=plain, **settings)
    with pytest.raises(UnknownNameError, match=r"no port 'u\[7\]'"):
        cosim.closed_loop(plant=system, controller=theirs, control="u[7]", measured="y[0]", reference=1.0)


def test_brackets_are_elements_where_there_is_a_vector():
    assert controllers.models.names.places_of(["u[1]"], ["u1", "u[0]", "u[1]"], "input") == [2]


def test_a_design_keeps_the_names_of_the_plants_states():
    settings = {"measured": "v", "actuated": "force", "dt": 0.1}
    given = controllers.design(SYSTEM, disturbance=0.1, **settings)
    assert given.model.names.states == ("speed", "motor")
    assert given.model.state_names == ("speed", "motor", "disturbance[0]")
    as_block = controllers.design(cosim.StateSpace(SYSTEM), disturbance=0.1, **settings)
    assert as_block.model.state_names == given.model.state_names

    def dynamics(t, x, u, params):
        return np.array([x[1], u[0] - x[1]])

    nonlinear = control.nlsys(
        dynamics, lambda t, x, u, params: x, inputs=["force"], outputs=["p", "v"], states=["position", "speed"]
    )
    assert controllers.design(nonlinear, goal="p", **{**settings, "measured": ["p", "v"]}).model.names.states == (
        "position",
        "speed",
    )
    # The outputs do not see the position, so that the model does not have it.
    assert controllers.design(nonlinear, **settings).model.names.states == ("speed",)


def test_states_without_names_are_numbered():
    assert controllers.design(control.tf([1], [1, 1, 1]), measured="y", actuated="u", dt=0.1).model.names.states == (
        "x[0]",
        "x[1]",
    )


def test_an_output_with_several_sensors_is_named_once():
    twice = {"measured": ["current", "v", "current", "current"], "actuated": "force"}
    with pytest.raises(
        ModelError, match=r"each once, .*: measured=\['current', 'v'\], sensors=\[3, 1\] \(in a scenario: co"
    ):
        controllers.design(SYSTEM, **twice)
    with pytest.raises(
        ModelError, match=r"actuated=\['force', 'force'\]; give the name of at least one .* each once\.$"
    ):
        controllers.design(SYSTEM, measured="v", actuated=["force", "force"])
