"""Systems of python-control as blocks, against python-control's own simulation."""

import pickle

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.errors import KernelError, ModelError, SimulationError, StepSizeError, UnknownNameError

ENGINES = ("compiled", "interpreted")


def stable(states, inputs, outputs, feedthrough=True, seed=0):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((states, states))
    a *= 0.9 / max(abs(np.linalg.eigvals(a)))
    d = rng.standard_normal((outputs, inputs)) * feedthrough
    return a, rng.standard_normal((states, inputs)), rng.standard_normal((outputs, states)), d


def driven(block, dt, sources):
    diagram = cosim.Diagram(dt=dt)
    plant = diagram.add(block, name="plant")
    for i, (port, source) in enumerate(sources.items()):
        node = diagram.add(source, name=f"source{i}")
        diagram.connect(node["y"], plant[port])
    return diagram


def waves(names):
    return {n: cosim.Sine(amplitude=1.0 + i, period=0.7 + 0.4 * i, offset=0.3 * i) for i, n in enumerate(names)}


def values(source, t):
    return source.offset + source.amplitude * np.sin(2 * np.pi / source.period * t)


@pytest.mark.parametrize("states", [1, 4])
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 3)])
@pytest.mark.parametrize("feedthrough", [True, False])
def test_discrete_linear(states, inputs, outputs, feedthrough):
    system = control.ss(*stable(states, inputs, outputs, feedthrough), 0.1)
    x0 = np.arange(1.0, states + 1)
    block = cosim.StateSpace(system, initial=x0)
    sources = waves([p.name for p in block.inputs])
    runs = {e: driven(block, 0.1, sources).simulate(5.0, engine=e) for e in ENGINES}
    t = runs["compiled"].time
    u = np.array([values(s, t) for s in sources.values()])
    expected = control.forced_response(system, t, u, x0, squeeze=False).outputs
    for i, port in enumerate(block.outputs):
        name = f"plant.{port.name}"
        assert np.allclose(runs["compiled"][name], expected[i], rtol=1e-12, atol=1e-12)
        assert np.array_equal(runs["compiled"][name], runs["interpreted"][name])


def test_continuous_linear_is_held_and_exact():
    system = control.ss([[0.0, 1.0], [-4.0, -0.6]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.5]], inputs=["f"], outputs=["x"])
    run = driven(cosim.StateSpace(system, initial=[1.0, -1.0]), "1/30", waves(["f"])).simulate("4")
    u = values(waves(["f"])["f"], run.time)
    sampled = control.sample_system(system, 1 / 30, method="zoh")
    expected = control.forced_response(sampled, np.arange(len(u)) / 30, u, [1.0, -1.0]).outputs
    assert np.allclose(run["plant.x"], expected, rtol=1e-12, atol=1e-12)
    assert run["plant.x"][0] == 1.0 + 0.5 * u[0]
    # An integrator of its own, one interval at a time, for the first steps.
    x = np.array([1.0, -1.0])
    for k in range(5):
        answer = control.forced_response(system, [0.0, 1 / 30], [u[k], u[k]], x, return_x=True)
        x = answer.states[:, -1]
    assert np.allclose(run["plant.x"][5], x[0] + 0.5 * u[5], rtol=1e-12)


def test_integrators_without_inverse():
    chain = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    run = driven(cosim.StateSpace(chain), 0.5, {"u": cosim.Constant(1.0)}).simulate(3.0)
    assert np.allclose(run["plant.y"], run.time**2 / 2, rtol=1e-15)


@pytest.mark.parametrize("dt", [0, 0.1, True])
def test_transfer_function(dt):
    system = control.tf([1.0, 2.0], [1.0, 0.5, 0.2], dt, inputs=["force"], outputs=["v"])
    block = cosim.StateSpace(system)
    run = driven(block, 0.1, waves(["force"])).simulate(3.0)
    u = values(waves(["force"])["force"], run.time)
    discrete = control.sample_system(system, 0.1, method="zoh") if dt == 0 else system
    expected = control.forced_response(discrete, U=u, T=run.time if dt is not True else None).outputs
    assert np.allclose(run["plant.v"], expected, rtol=1e-11, atol=1e-11)
    assert not block.inputs[0].feedthrough


def test_static_gain_has_no_state():
    block = cosim.StateSpace(control.ss([], [], [], [[2.0, -1.0]]))
    for engine in ENGINES:
        run = driven(block, 0.1, {"u0": cosim.Constant(3.0), "u1": cosim.Constant(1.0)}).simulate(0.2, engine=engine)
        assert run["plant.y"].tolist() == [5.0, 5.0, 5.0]


def test_names():
    a, b, c, d = stable(2, 2, 2)
    named = control.ss(a, b, c, d, 0.1, inputs=["force", "wind speed"], outputs=["speed v", "A"])
    block = cosim.StateSpace(named)
    assert [p.name for p in block.inputs] == ["force", "wind speed"]
    assert [p.name for p in block.outputs] == ["speed v", "A"]
    plain = cosim.StateSpace(control.ss(a, b, c, d, 0.1))
    assert [p.name for p in (*plain.inputs, *plain.outputs)] == ["u0", "u1", "y0", "y1"]
    run = driven(block, 0.1, waves(["force", "wind speed"])).simulate(0.5, record=["plant.A"])
    assert np.isfinite(run["plant.A"]).all()


def test_feedthrough_per_input():
    a, b, c, _ = stable(2, 2, 2)
    block = cosim.StateSpace(control.ss(a, b, c, [[0.0, 0.0], [0.0, 3.0]], 0.1))
    assert [p.feedthrough for p in block.inputs] == [False, True]
    # Closing the loop over the input that does not feed through is no algebraic loop.
    for engine in ENGINES:
        diagram = cosim.Diagram(dt=0.1)
        plant = diagram.add(block, name="plant")
        diagram.connect(plant["y0"], plant["u0"])
        one = diagram.add(cosim.Constant(1.0), name="one")
        diagram.connect(one["y"], plant["u1"])
        x, got = np.zeros(2), diagram.simulate(1.0, engine=engine)["plant.y1"]
        for k in range(11):
            assert np.isclose(got[k], c[1] @ x + 3.0, rtol=1e-12)
            x = a @ x + b @ [c[0] @ x, 1.0]


def pendulum(dt=0, **options):
    def dynamics(t, x, u, params):
        return [x[1], -params.get("g", 9.81) * np.sin(x[0]) - 0.2 * x[1] + u[0]]

    def discrete(t, x, u, params):
        derivative = dynamics(t, x, u, params)
        return [x[0] + 0.05 * derivative[0], x[1] + 0.05 * derivative[1] + 0.01 * np.cos(t)]

    def output(t, x, u, params):
        return [np.sin(x[0]), x[1] + 0.1 * u[0] * options.get("direct", 1.0)]

    function = dynamics if dt == 0 else discrete
    return control.nlsys(function, output, inputs=["torque"], outputs=["height", "rate"], states=2, dt=dt)


def test_nonlinear_continuous():
    block = cosim.StateSpace(pendulum(), initial=[1.0, 0.0], params={"g": 5.0})
    run = driven(block, 0.05, {"torque": cosim.Constant(0.7)}).simulate(4.0)
    oracle = control.input_output_response(
        pendulum(), run.time, np.full(len(run.time), 0.7), [1.0, 0.0], params={"g": 5.0},
        solve_ivp_method="DOP853", solve_ivp_kwargs={"rtol": 1e-12, "atol": 1e-13},
    )  # fmt: skip
    assert np.allclose(run["plant.height"], oracle.outputs[0], atol=1e-8)
    assert np.allclose(run["plant.rate"], oracle.outputs[1], atol=1e-8)
    assert run.metadata["engine"] == "interpreted"


def test_nonlinear_solver_settings_reach_the_solver():
    coarse = cosim.StateSpace(pendulum(), initial=[1.0, 0.0], method="RK23", rtol=1e-2, atol=1e-2)
    fine = cosim.StateSpace(pendulum(), initial=[1.0, 0.0])
    a, b = (driven(s, 0.5, {"torque": cosim.Constant(0.7)}).simulate(5.0)["plant.rate"] for s in (coarse, fine))
    assert 1e-6 < np.abs(a - b).max() < 0.5


def test_nonlinear_discrete():
    block = cosim.StateSpace(pendulum(dt=0.05), initial=[1.0, 0.0])
    run = driven(block, 0.05, waves(["torque"])).simulate(4.0)
    u = values(waves(["torque"])["torque"], run.time)
    oracle = control.input_output_response(pendulum(dt=0.05), run.time, u, [1.0, 0.0])
    assert np.allclose(run["plant.height"], oracle.outputs[0], rtol=1e-12, atol=1e-12)
    assert np.allclose(run["plant.rate"], oracle.outputs[1], rtol=1e-12, atol=1e-12)


def test_interconnected_systems():
    plant = control.ss([[0.9]], [[0.1]], [[1.0]], [[0.0]], 0.1, inputs=["u"], outputs=["y"], name="p")
    lag = control.ss([[0.5]], [[0.5]], [[1.0]], [[0.0]], 0.1, inputs=["r"], outputs=["u"], name="lag")
    whole = control.interconnect([plant, lag], inplist=["lag.r"], outlist=["p.y"], inputs=["r"], outputs=["y"])
    run = driven(cosim.StateSpace(whole), 0.1, waves(["r"])).simulate(3.0)
    u = values(waves(["r"])["r"], run.time)
    assert np.allclose(run["plant.y"], control.forced_response(whole, run.time, u).outputs, rtol=1e-12, atol=1e-12)
    assert run.metadata["engine"] == "compiled"
    square = control.nlsys(None, lambda t, x, u, params: u * u, inputs=["r2"], outputs=["u"], name="sq", dt=0.1)
    mixed = control.interconnect([plant, square], inplist=["sq.r2"], outlist=["p.y"], inputs=["r"], outputs=["y"])
    run = driven(cosim.StateSpace(mixed), 0.1, waves(["r"])).simulate(3.0)
    assert np.allclose(
        run["plant.y"], control.input_output_response(mixed, run.time, u).outputs, rtol=1e-12, atol=1e-12
    )
    assert run.metadata["engine"] == "interpreted"


def test_nonlinear_feedthrough_is_found_by_trials_and_checked_at_each_step():
    assert [p.feedthrough for p in cosim.StateSpace(pendulum()).inputs] == [True]
    assert [p.feedthrough for p in cosim.StateSpace(pendulum(direct=0.0)).inputs] == [True]  # 0 times a NaN is none

    def system(output, inputs=("a", "b")):
        return control.nlsys(
            lambda t, x, u, params: np.ones(1), output, inputs=list(inputs), outputs=["y"], states=["x"]
        )

    def fed(output):
        return [p.feedthrough for p in cosim.StateSpace(system(output)).inputs]

    assert fed(lambda t, x, u, params: x) == [False, False]
    assert fed(lambda t, x, u, params: x + u[1]) == [False, True]
    assert fed(lambda t, x, u, params: x * u[0]) == [True, False]  # 0 at the initial state, whatever the input is
    assert fed(lambda t, x, u, params: x + np.sign(u[:1])) == [True, False]
    assert fed(lambda t, x, u, params: [x[0] if u[0] < 1e5 else 1.0]) == [True, False]
    assert fed(lambda t, x, u, params: [x[0] / int(u[0] + 1)]) == [True, True]  # it raises: not known
    hidden = system(lambda t, x, u, params: x + (u if x[0] > 0.5 else 0.0), inputs=["torque"])
    with pytest.raises(ModelError, match=r"not at its initial state.*feedthrough=True"):
        driven(cosim.StateSpace(hidden), 0.05, waves(["torque"])).simulate(1.0)
    run = driven(cosim.StateSpace(hidden, feedthrough=True), 0.05, waves(["torque"])).simulate(1.0)
    u = values(waves(["torque"])["torque"], run.time)
    assert np.allclose(run["plant.y"], run.time + np.where(run.time > 0.5, u, 0.0), atol=1e-9)


def test_nonlinear_feedthrough_is_the_users_word_and_is_checked():
    honest = cosim.StateSpace(pendulum(direct=0.0), feedthrough=())
    assert [p.feedthrough for p in honest.inputs] == [False]
    diagram = cosim.Diagram(dt=0.05)
    plant, gain = diagram.add(honest, name="plant"), diagram.add(cosim.Gain(-1.0))
    diagram.connect(plant["rate"], gain["u"])
    diagram.connect(gain["y"], plant["torque"])
    assert np.isfinite(diagram.simulate(1.0)["plant.rate"]).all()
    with pytest.raises(ModelError, match="lacks inputs on which the outputs depend"):
        driven(cosim.StateSpace(pendulum(), feedthrough=False), 0.05, waves(["torque"])).simulate(1.0)
    with pytest.raises(UnknownNameError, match="did you mean 'torque'"):
        cosim.StateSpace(pendulum(), feedthrough=["torqe"])
    with pytest.raises(KernelError, match="cannot be compiled"):
        driven(honest, 0.05, {}).simulate(1.0, engine="compiled")


@pytest.mark.parametrize("rank", [2, 1])
def test_process_noise_has_the_covariance_asked_for(rank):
    factor = np.array([[1.0, 0.0], [0.7, 0.4]])[:, :rank]
    q = factor @ factor.T
    system = control.ss(np.zeros((2, 2)), np.zeros((2, 1)), np.eye(2), np.zeros((2, 1)), 1.0)
    runs = {e: driven(cosim.StateSpace(system, process_noise=q), 1.0, {}) for e in ENGINES}
    run = runs["compiled"].simulate(20_000.0, seed=3)
    w = np.array([run["plant.y0"], run["plant.y1"]])[:, 1:]  # with A = 0 the state is the last noise
    assert np.allclose(np.cov(w), q, atol=0.03)
    assert abs(np.corrcoef(w[0, 1:], w[0, :-1])[0, 1]) < 0.03
    short = {e: d.simulate(50.0, seed=3)["plant.y1"] for e, d in runs.items()}
    assert np.array_equal(short["compiled"], short["interpreted"])
    assert np.array_equal(short["compiled"], run["plant.y1"][:51])


def test_process_noise_may_have_states_of_any_units():
    """Five states that one input moves, from micrometres to newtons: the covariance of a design was refused by its rounding."""
    moved = np.array([2e-7, 0.3, -4e-7, 95.0, -2e-3])
    covariance = np.outer(moved, moved) * (1.0 + 1e-16)
    block = cosim.StateSpace(control.ss(0.5 * np.eye(5), np.zeros((5, 1)), np.eye(5), 0, 0.1), process_noise=covariance)
    y = driven(block, 0.1, {}).simulate(200.0, seed=1, record=["plant.y*"])
    states = np.column_stack([y[name] for name in sorted(y) if name.startswith("plant.y")]) / moved
    np.testing.assert_allclose(states, states[:, :1].repeat(5, axis=1), rtol=1e-6, atol=1e-7)
    assert states[:, 0].std() == pytest.approx((1.0 / 0.75) ** 0.5, rel=0.1)


def test_process_noise_of_nonlinear_systems():
    block = cosim.StateSpace(pendulum(dt=0.05), process_noise=np.diag([0.0, 0.01]))
    quiet = driven(cosim.StateSpace(pendulum(dt=0.05)), 0.05, {}).simulate(0.1, record=["plant.rate"])
    noisy = driven(block, 0.05, {}).simulate(0.1, record=["plant.rate", "plant.process_noise"])
    first = noisy["plant.process_noise"][0]
    assert noisy["plant.rate"][1] == pytest.approx(quiet["plant.rate"][1] + 0.1 * first[1], rel=1e-12)


def test_divergence_stops_the_run_and_keeps_the_result():
    block = cosim.StateSpace(control.ss([[1e100]], [[0.0]], [[1.0]], [[0.0]], 0.1), initial=[1.0])
    for engine in ENGINES:
        with pytest.raises(SimulationError, match=r"step 4.*plant\.y came out infinite") as caught:
            driven(block, 0.1, {}).simulate(2.0, engine=engine)
        assert caught.value.result["plant.y"].tolist() == pytest.approx([1.0, 1e100, 1e200, 1e300])


def test_a_solver_that_gives_up_stops_the_run(caplog):
    caplog.set_level("WARNING", "bayesftc.state_space")
    explosive = control.nlsys(lambda t, x, u, p: x * x, None, inputs=1, outputs=1, states=1, dt=0)
    diagram = driven(cosim.StateSpace(explosive, initial=[1.0], feedthrough=False), 0.25, {})
    with pytest.raises(SimulationError, match=r"plant\.y came out NaN") as caught:
        diagram.simulate(4.0)
    assert len(caught.value.result["plant.y"]) == 4  # x = 1 / (1 - t) has no value at t = 1
    assert "The solver failed between t = 0.75 s and 1 s" in caplog.text


def test_wrong_step():
    block = cosim.StateSpace(control.ss(*stable(2, 1, 1), 0.1))
    with pytest.raises(StepSizeError, match=r"0\.1 s.*0\.2 s"):
        driven(block, 0.2, {}).simulate(1.0)
    with pytest.raises(StepSizeError, match=r"sample time of 0\.1 s and cannot run every 1/3 s"):
        block.define(cosim.Diagram(dt="1/3").step)
    third = cosim.StateSpace(control.ss(*stable(2, 1, 1), 1 / 3))
    assert np.isfinite(driven(third, "1/3", {}).simulate("5/3")["plant.y"]).all()


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: cosim.StateSpace("car"), "not a str"),
        (lambda: cosim.StateSpace(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], None)), "has dt=None"),
        (lambda: cosim.StateSpace(control.tf([1, 0, 0], [1, 1])), "cannot be converted"),
        (lambda: cosim.StateSpace(control.ss([[np.inf]], [[1]], [[1]], [[0]])), "must be finite"),
        (lambda: cosim.StateSpace(control.ss([[0.5]], [[1]], [[1]], [[0]]), initial=[1.0, 2.0]), "1 finite numbers"),
        (lambda: cosim.StateSpace(control.ss([[0.5]], [[1]], [[1]], [[0]]), process_noise=np.eye(2)), "1 x 1 finite"),
        (
            lambda: cosim.StateSpace(control.ss([[0.5]], [[1]], [[1]], [[0]]), process_noise=[[-1.0]]),
            "not a covariance",
        ),
        (
            lambda: cosim.StateSpace(control.ss([[0.5]], [[1]], [[1]], [[0]]), feedthrough=False),
            "D determines the feedthrough",
        ),
        (lambda: cosim.StateSpace(pendulum(), rtol=0.0), "must be positive"),
    ],
)
def test_refusals_are_sentences(build, sentence):
    with pytest.raises(ModelError, match=sentence) as caught:
        build()
    assert str(caught.value).endswith((".", "?"))


def test_blocks_of_linear_systems_are_plain_values():
    block = cosim.StateSpace(control.ss(*stable(2, 1, 1), 0.1), process_noise=np.eye(2))
    copy = pickle.loads(pickle.dumps(block))
    assert copy == block
    assert hash(copy) == hash(block)
    runs = [driven(b, 0.1, waves(["u"])).simulate(1.0, seed=5)["plant.y"] for b in (block, copy)]
    assert np.array_equal(*runs)


def test_signals_have_the_units_that_are_given(tmp_path):
    """python-control has none. They reach the control, the results and another tool."""
    system = control.ss([[-1.0]], [[2.0]], [[1.0]], 0, inputs=["voltage"], outputs=["speed"])
    motor = cosim.StateSpace(system, units={"voltage": "V", "speed": "rad/s"})
    controller = controllers.design(motor, measured="speed", actuated="voltage", sensors=2, sensor_std=0.1, dt=0.05)
    parts = {"control": "voltage", "measured": "speed", "sensors": cosim.Sensors(2, 0.1), "reference": 1.0}
    loop = cosim.closed_loop(motor, controller, **parts)
    found = loop.simulate(0.5).to_xarray()
    assert [found[name].attrs["units"] for name in ("plant.speed", "sensors.y", "controller.u")] == [
        "rad/s",
        "rad/s",
        "V",
    ]
    cosim.export_fmu(motor, tmp_path / "motor.fmu", dt=0.05)
    assert [port.unit for port in cosim.FMU(tmp_path / "motor.fmu").inputs] == ["V"]
    with pytest.raises(UnknownNameError, match="units of 'volt', which is no input or output; did you mean 'voltage'"):
        cosim.StateSpace(system, units={"volt": "V"})
    with pytest.raises(ModelError, match=r"units=\['V'\]; they must be texts by the names of signals"):
        cosim.StateSpace(system, units=["V"])


def test_params_that_are_no_names_are_refused():
    """As the values of a factor "plant.params" would be."""
    system = control.nlsys(
        lambda t, x, u, p: [-x[0] + u[0]], lambda t, x, u, p: [x[0]], inputs=["u"], outputs=["y"], states=1
    )
    with pytest.raises(ModelError, match=r'params=0.02; it must be values by name.*"plant.params.m"'):
        cosim.StateSpace(system, params=0.02, feedthrough=False)
