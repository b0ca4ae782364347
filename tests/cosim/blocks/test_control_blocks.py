"""Systems of python-control as blocks: every kind, against python-control's own simulation."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus

DT = 0.02
T = np.arange(101) / 50


def _mimo(dt):
    rng = np.random.default_rng(4)
    a = rng.normal(size=(4, 4))
    a = a * 0.8 / max(abs(np.linalg.eigvals(a))) - (0 if dt else 2.0 * np.eye(4))
    return control.ss(a, rng.normal(size=(4, 2)), rng.normal(size=(3, 4)), rng.normal(size=(3, 2)), dt)


def _tank(t, x, u, params):
    return [params["inflow"] * u[0] - params["outflow"] * np.sqrt(np.abs(x[0])), -x[1] + x[0]]


def _tank_in_steps(t, x, u, params):
    return x + DT * np.array(_tank(t, x, u, params)) + 0.01 * np.sin(t)


def _tank_of(dt, dynamics, **options):
    return control.nlsys(
        dynamics,
        inputs=["valve"],
        states=["level", "smoothed"],
        params={"inflow": 1.0, "outflow": 0.5},
        dt=dt,
        **options,
    )


def _in_a_loop():
    """Return a nonlinear interconnection with names, one of whose parts has parameters of its own."""
    tank = _tank_of(DT, _tank_in_steps, outputs=["level", "smoothed"], name="tank")
    control_law = control.ss([[0.9]], [[0.1]], [[2.0]], [[1.0]], DT, inputs=["error"], outputs=["valve"], name="law")
    error = control.summing_junction(["wanted", "-level"], "error", dt=DT, name="error")
    return control.interconnect(
        [tank, control_law, error], inputs=["wanted"], outputs=["level", "valve"], name="loop", check_unused=False
    )


def _with_its_estimator():
    plant = control.ss(
        [[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], 0, DT, inputs=["u"], outputs=["y"], name="plant"
    )
    return control.create_estimator_iosystem(plant, [[0.1]], [[0.2]], G=[[0.0], [1.0]])


def _car():
    return control.ss(
        [[0.999]], [[2e-4, 1.0]], [[1.0]], 0, DT, name="car", inputs=["force", "disturbance"], outputs=["v"]
    )


def _brain(outputs, inputs=None):
    model = controllers.LinearModel(
        [[0.999]], [[2e-4]], [[1], [1]], process_covariance=1e-3, sensor_covariance=1.0, dt=DT
    )
    controller = controllers.BayesianController(model, precision=controllers.GammaPrecision(), initial_mean=20.0)
    return controller.to_control(inputs=inputs, outputs=outputs, engine="interpreted", name="controller")


def _a_loop_of_blocks():
    """Return an interconnection of an FMU, noisy sensors and a controller."""
    plant = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0}).to_control(
        DT, engine="interpreted", name="plant"
    )
    sensors = cosim.Sensors(count=2, std=1.0).to_control(
        DT, inputs={"u": "v"}, outputs={"y": "read"}, seed=3, engine="interpreted", name="sensors"
    )
    controller = _brain({"u[0]": "force", "x_hat": "estimate"}, {"y": "read", "goal": "goal"})
    return control.interconnect(
        [plant, sensors, controller], inputs=["goal[0]"], outputs=["v", "force", "estimate[0]"], check_unused=False
    )


DISCRETE = {
    "state space, MIMO": lambda: _mimo(DT),
    "any sample time": lambda: _mimo(True),
    "transfer function": lambda: control.tf([1.0, 0.3], [1.0, -0.4, 0.1], DT),
    "zeros, poles, gain": lambda: control.zpk([0.5], [0.2, -0.7], 3.0, DT),
    "delay of five steps": lambda: control.tf([1.0], [1.0, 0, 0, 0, 0, 0], DT),
    "MIMO transfer function": lambda: control.tf(
        [[[1.0], [0.5, 0.1]], [[2.0], [1.0]]], [[[1.0, -0.5], [1.0, 0.2]], [[1.0, 0.0, 0.0], [1.0, -0.9]]], DT
    ),
    "static gain": lambda: control.ss([], [], [], [[2.0, -1.0], [0.5, 3.0]]),
    "static transfer function": lambda: control.tf([3.0], [1.0]),
    "feedback": lambda: control.feedback(_mimo(DT)[0, 0], control.tf([0.05], [1.0, -0.5], DT)),
    "series and parallel": lambda: _mimo(DT)[0, 0] * control.tf([1.0], [1.0, 0.0], DT) + 2.0,
    "side by side": lambda: control.append(_mimo(DT), control.tf([1.0], [1.0, -0.5], DT)),
    "linear interconnection": lambda: control.interconnect(
        [_car(), control.ss([[0.5]], [[1.0]], [[1.0]], 0, DT, inputs=["v"], outputs=["force"], name="pedal")],
        inputs=["disturbance"], outputs=["v", "force"],
    ),
    "nonlinear": lambda: _tank_of(DT, _tank_in_steps, outputs=["level", "smoothed"]),
    "states as outputs": lambda: _tank_of(DT, _tank_in_steps),
    "static nonlinear": lambda: control.nlsys(None, lambda t, x, u, p: [u[0] * u[1], np.tanh(u[0])], inputs=2, outputs=2, dt=DT),
    "nonlinear interconnection": _in_a_loop,
    "nonlinear in series": lambda: _tank_of(DT, _tank_in_steps, outfcn=lambda t, x, u, p: [x[1]], outputs=["y"])
    * control.tf([1.0], [1.0, -0.5], DT),
    "estimator": _with_its_estimator,
    "a block and back": lambda: _brain(["u", "x_hat"]),
    "a loop and back": lambda: _a_loop_of_blocks(),
}  # fmt: skip


@pytest.mark.sampled(10)
@pytest.mark.parametrize("make", DISCRETE.values(), ids=DISCRETE)
def test_every_discrete_system_is_a_block(make, fed):
    system = make()
    rows = 1.0 + 0.3 * np.random.default_rng(3).normal(size=(system.ninputs, len(T)))
    if isinstance(system, control.TransferFunction):
        block = cosim.StateSpace(system)
        expected = [
            sum(control.forced_response(system[i, j], T, rows[j]).outputs for j in range(system.ninputs))
            for i in range(system.noutputs)
        ]
    else:
        x0 = cosim.initial_state(system)
        start = x0 if x0.any() else np.linspace(0.5, 1.0, len(x0))
        block = cosim.StateSpace(system, initial=start)
        if system.dt is True:
            system = control.ss(system.A, system.B, system.C, system.D, DT)
        expected = control.input_output_response(system, T, rows, X0=start, squeeze=False).outputs
    diagram = fed(block, {port.name: row[None] for port, row in zip(block.inputs, rows, strict=True)})
    run = diagram.simulate(2.0, engine="interpreted")
    linear = isinstance(system, control.StateSpace | control.TransferFunction)
    assert diagram.schedule.compiled == linear
    for port, row in zip(block.outputs, expected, strict=True):
        np.testing.assert_allclose(run[f"block.{port.name}"], row, rtol=1e-12, atol=1e-12)


CONTINUOUS = {
    "state space, MIMO": (lambda: _mimo(0), True),
    "transfer function": (lambda: control.tf([1.0, 2.0], [1.0, 0.5, 4.0]), True),
    "static": (lambda: control.tf([3.0], [1.0]), True),
    "delay by Pade": (lambda: control.tf(*control.pade(0.3, 3)) * control.tf([1.0], [0.5, 1.0]), True),
    "nonlinear with parameters": (lambda: _tank_of(0, _tank, outputs=["level", "smoothed"]), False),
    "nonlinear interconnection": (
        lambda: control.interconnect(
            [_tank_of(0, _tank, outputs=["level", "smoothed"], name="tank"),
             control.ss([[-1.0]], [[1.0]], [[1.0]], 0, inputs=["tap"], outputs=["valve"], name="actuator")],
            inputs=["tap"], outputs=["smoothed"], check_unused=False,
        ),
        False,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("make", "linear"), CONTINUOUS.values(), ids=CONTINUOUS)
def test_every_continuous_system_is_a_block(make, linear, fed):
    system = make()
    n = (control.ss(system) if linear else system).nstates
    start = np.linspace(0.5, 1.0, n)
    block = cosim.StateSpace(system, initial=start)
    rows = np.linspace(0.5, 1.5, len(block.inputs))[:, None] * np.ones(
        len(T)
    )  # constant: it holds what python-control joins
    diagram = fed(block, {port.name: row[None] for port, row in zip(block.inputs, rows, strict=True)})
    run = diagram.simulate(2.0, engine="interpreted")
    if linear:
        expected = control.forced_response(
            control.sample_system(control.ss(system), DT, "zoh"), T, rows, start, squeeze=False
        )
    else:
        settings = {"solve_ivp_method": "DOP853", "solve_ivp_kwargs": {"rtol": 1e-12, "atol": 1e-12}}
        expected = control.input_output_response(system, T, rows, start, squeeze=False, **settings)
    assert diagram.schedule.compiled == linear
    for port, row in zip(block.outputs, expected.outputs, strict=True):
        np.testing.assert_allclose(run[f"block.{port.name}"], row, rtol=1e-7, atol=1e-7)


def test_parameters_of_systems_can_be_given(fed):
    block = cosim.StateSpace(_tank_of(DT, _tank_in_steps), initial=[1.0, 0.0], params={"outflow": 0.1})
    run = fed(block, {"valve": np.ones((1, len(T)))}).simulate(2.0, engine="interpreted")
    expected = control.input_output_response(
        _tank_of(DT, _tank_in_steps), T, np.ones(len(T)), [1.0, 0.0], params={"outflow": 0.1}
    )
    np.testing.assert_allclose(run["block.level"], expected.outputs[0], rtol=1e-12)
