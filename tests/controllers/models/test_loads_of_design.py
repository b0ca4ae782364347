"""Loads that last, at inputs of the plant: `design(loads=...)` makes each a state of the controller's model."""

import control
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.errors import ModelError, UnknownNameError

STD, TIME, DT = 3.0, 21600.0, 30.0
A = np.array([[-4.267e-4, 1.333e-4, 2.667e-4], [6.667e-6, -9.333e-6, 0.0], [0.01, 0.0, -0.01]])
B = np.array([[0.0, 2.667e-5], [0.0, 2.667e-6], [0.0025, 0.0]])
C = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def hall(measured_load=False):
    rows, direct = (np.vstack([C, np.zeros(3)]), np.zeros((3, 2))) if measured_load else (C, np.zeros((2, 2)))
    if measured_load:
        direct[2, 1] = 1.0
    outputs = ["room", "supply", "outside"][: len(rows)]
    return control.ss(A, B, rows, direct, inputs=["heat", "outdoor"], outputs=outputs)


def designed(plant=None, loads=None, **settings):
    loads = {"outdoor": (STD, TIME)} if loads is None else loads
    given = {"goal": "room", "noise": {}, "dt": DT, "acceptable_error": 0.5, "acceptable_control": 10.0}
    return controllers.design(plant or hall(), loads=loads, **{**given, **settings})


def test_the_load_has_the_stated_size_and_time_constant():
    model = designed().model
    assert model.state_names[-1] == "outdoor"
    transition, Q = model.matrix("A"), model.matrix("process_covariance")
    assert np.isclose(transition[3, 3], np.exp(-DT / TIME), rtol=1e-12)
    assert np.isclose(solve_discrete_lyapunov(transition[3:, 3:], Q[3:, 3:])[0, 0], STD**2, rtol=1e-9)
    assert not Q[:3].any()
    assert not model.matrix("B")[3].any()


def test_it_moves_the_plant_as_its_input_does():
    model, held = designed().model, np.zeros(4)
    held[3] = 2.0
    of_model = model.matrix("A")[:3] @ held
    whole = expm(DT * np.block([[A, B[:, 1:]], [np.zeros((1, 4))]]))  # the input held for a sample
    np.testing.assert_allclose(of_model, whole[:3] @ held, rtol=1e-10)


def test_a_load_that_is_measured_is_fed_forward():
    controller = designed(hall(measured_load=True), sensors=[2, 1, 2], sensor_std=0.2)
    assert controller.model.matrix("C")[-1].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert controller.regulator.gain[0, 3] > 0.1  # less heat where it is warmer outside


def test_it_is_followed_and_taken_up_and_no_healthy_sensor_is_blamed():
    stds, swing = [0.2] * 3 + [0.3] * 2, {"outdoor": cosim.Sine(amplitude=4.0, period=86400.0)}
    blamed, errors = [], []
    for settings in ({}, {"loads": {}, "noise": {"outdoor": STD}}):
        controller = designed(sensors=[3, 2], sensor_std=stds, **settings)
        loop = cosim.closed_loop(
            hall(), controller, control="heat", measured=["room", "supply"], sensors=cosim.Sensors([3, 2], stds),
            noise=swing, reference=0.0,
        )  # fmt: skip
        results = [loop.simulate(86400.0, seed=seed) for seed in range(3)]
        blamed.append(np.mean([result["controller.fault_probability"] > 0.5 for result in results]))
        errors.append(np.sqrt(np.mean([result["plant.room"] ** 2 for result in results])))
        if not settings:
            load = results[0]["controller.x_hat"][1440:, 3]
            assert np.corrcoef(load, 4.0 * np.sin(2 * np.pi * results[0].time[1440:] / 86400.0))[0, 1] > 0.9
    assert errors[0] < 0.7 * errors[1]
    assert blamed[0] < blamed[1]


@pytest.mark.parametrize("acceptable", [0.1, 2.0])
def test_a_load_that_lasts_leaves_no_steady_error(acceptable):
    """The control that counteracts it has no cost: with one, the error is the larger, the larger the acceptable error."""
    controller = designed(
        sensors=[3, 2], sensor_std=0.05, loads={"outdoor": (STD, 1e7)}, acceptable_error=acceptable,
        precision=controllers.FixedPrecision(), initial_spread=1e3,
    )  # fmt: skip
    loop = cosim.closed_loop(
        hall(), controller, control="heat", measured=["room", "supply"], sensors=cosim.Sensors([3, 2], 0.05),
        noise={"outdoor": cosim.Constant(-10.0)}, reference=0.0,
    )  # fmt: skip
    result = loop.simulate(6 * 86400.0, seed=1)
    assert abs(result["plant.room"][-2880:].mean()) < 0.01
    assert result["controller.u"][-2880:].mean() > 0.5


def test_of_an_fmu_about_its_operating_point():
    turbine = fmus.path("HydroTurbine")
    controller = controllers.design(
        turbine, measured="power", actuated="command", loads={"head": (0.05, 60.0)}, dt=0.05, noise={}, sensors=3,
        acceptable_error=0.02, acceptable_control=0.5,
    )  # fmt: skip
    assert controller.model.state_names[-2:] == ("head", "constant")
    loop = cosim.closed_loop(
        cosim.FMU(turbine), controller, control="command", measured="power", sensors=cosim.Sensors(3, 0.01),
        noise={"head": cosim.Constant(0.95)}, reference=0.7,
    )  # fmt: skip
    result = loop.simulate(60.0, seed=1)
    assert abs(result["plant.power"][-500:].mean() - 0.7) < 0.003
    assert -0.1 < result["controller.x_hat"][-1, -2] < -0.025  # a deviation; the plant is not linear


def test_each_element_of_a_vector_has_its_own_load():
    plant = control.ss([[-1.0]], [[1.0, 0.5, 0.25]], [[1.0]], 0, inputs=["u", "w[0]", "w[1]"], outputs=["y"])
    model = controllers.design(plant, loads={"w": (0.1, 10.0)}, dt=0.1).model
    assert model.states == 3
    assert model.controls == 1  # what is a load is no control


@pytest.mark.parametrize(
    ("loads", "sentence"),
    [
        (3.0, "give two numbers for each input by name, as loads={'load': (0.02, 5.0)}"),
        ({"outdoor": 3.0}, "loads has outdoor = 3.0; give two numbers, its standard deviation and its time constant"),
        ({"outdoor": (0.0, 1e4)}, "must be a finite number above 0"),
        ({"outdoor": (3.0, float("inf"))}, "must be a finite number above 0"),
        ({"outdoor": (3.0, 10.0)}, "the sample time is 30 s. What changes faster than the samples is white noise"),
    ],
)
def test_what_is_no_load(loads, sentence):
    with pytest.raises(ModelError) as caught:
        designed(loads=loads)
    assert sentence in str(caught.value)


def test_wrong_names_and_models_without_inputs():
    with pytest.raises(UnknownNameError, match="did you mean 'outdoor'"):
        designed(loads={"outdor": (1.0, 1e4)})
    model = controllers.LinearModel([[0.9]], [[1.0]], [[1.0]], 0.1, 0.1, dt=1.0)
    with pytest.raises(ModelError, match="already determines loads"):
        controllers.design(model, loads={"w": (1.0, 10.0)})


def test_a_direct_effect_of_what_is_no_load_is_still_refused():
    with pytest.raises(ModelError, match="name it in loads="):
        designed(hall(measured_load=True), loads={}, noise={"outdoor": 1.0})
