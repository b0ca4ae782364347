"""Blocks, diagrams and FMUs as systems of python-control, against our own engines and closed forms."""

import gc
import pickle
import zipfile
from copy import deepcopy

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.errors import (
    FMUError,
    ModelError,
    SimulationError,
    StepSizeError,
    UnconnectedInputError,
    UnknownNameError,
)

DT, DRAG, MASS = 0.02, 5.0, 100.0
A, B = 1 - DRAG / MASS * DT, DT / MASS
T = np.arange(101) / 50
MODEL = controllers.LinearModel([[A]], [[B]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=DT)
FMI = ("2.0", "3.0")


def linear_car():
    return control.ss([[A]], [[B, 1.0]], [[1.0]], 0, DT, name="car", inputs=["force", "disturbance"], outputs=["v"])


def car(fmi="2.0", path=None, **options):
    return cosim.FMU(path or fmus.path("CruiseControl", fmi=fmi), parameters={"v0": 20.0}, **options)


def brain(precision=None, **options):
    precision = controllers.GammaPrecision(forgetting=0.95) if precision is None else precision
    return controllers.BayesianController(MODEL, precision=precision, initial_mean=20.0, **options)


def loop(plant, precision=None, **options):
    return cosim.closed_loop(
        plant=plant,
        controller=brain(precision),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=0.001**0.5)},
        sensors=cosim.Sensors(count=2, std=1.0),
        reference=cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
        **{"faults": [cosim.Freeze(sensor=0, start=0.5, stop=1.5)], **options},
    )


def response(system, inputs=0.0, X0=None, times=T, **options):
    start = cosim.initial_state(system) if X0 is None else X0
    return control.input_output_response(system, times, inputs, X0=start, squeeze=False, **options)


# --- every block --------------------------------------------------------------------------------------------------------------

FAULTS = [
    cosim.Freeze(sensor=1, start=0.3, stop=0.9, channels=2),
    cosim.Drift(sensor=0, slope=2.0, start=0.3, channels=2),
    cosim.Spikes(sensor=0, magnitude=3.0, start=0.1, channels=2),
    cosim.RandomFaults(channels=2, mean_time_to_fault=0.3, mean_time_to_recovery=0.2),
]
BLOCKS = {
    "gain": cosim.Gain([[1.0, -2.0], [0.5, 3.0]]),
    "sum": cosim.Sum("+-+"),
    "delay": cosim.UnitDelay(size=2, initial=3.0),
    "saturation": cosim.Saturation(-1.0, 1.5, size=2),
    "sensors": cosim.Sensors(count=3, signals=2, std=0.3, bias=0.1, resolution=0.05, matrix=[[1, 0], [0, 1], [1, 1]]),
    "source": cosim.Sine(amplitude=1.0, period=0.7),
    "noise": cosim.Gaussian(std=2.0, mean=1.0),
    "noisy system": cosim.StateSpace(
        control.ss([[0.5, 0.2], [0.0, 0.9]], np.eye(2), [[1.0, 1.0]], 0, DT), process_noise=np.eye(2)
    ),
    "feedthrough": cosim.StateSpace(control.ss([[-1.0]], [[1.0, 0.5]], [[1.0], [2.0]], [[0, 0], [0, 3.0]]), initial=[2.0]),
    "static": cosim.StateSpace(control.ss([], [], [], [[2.0, 1.0]])),
    "nonlinear": cosim.StateSpace(
        control.nlsys(
            lambda t, x, u, p: [x[1], -np.sin(x[0]) + u[0]], lambda t, x, u, p: [x[0] * x[1]], inputs=1, outputs=1, states=2
        ),
        initial=[1.0, 0.5],
    ),
    **{type(fault).__name__: fault for fault in FAULTS},
}  # fmt: skip


def sources(block):
    rng = np.random.default_rng(1)
    ports = [port for port in block.inputs if port.draw is None]
    return {port.name: rng.normal(size=(port.size, len(T))) for port in ports}


@pytest.mark.parametrize("block", BLOCKS.values(), ids=BLOCKS)
def test_every_block_gives_the_same_numbers(block, fed):
    values = sources(block)
    run = fed(block, values).simulate(2.0, seed=5, engine="interpreted")
    system = block.to_control(DT, seed=5, engine="interpreted", name="block")
    assert isinstance(system, control.NonlinearIOSystem)
    assert system.name == "block"
    assert system.dt == DT
    got = response(system, np.vstack([np.zeros((0, len(T))), *values.values()]))
    expected = np.vstack([run[f"block.{port.name}"].reshape(len(T), -1).T for port in block.outputs])
    np.testing.assert_array_equal(got.outputs, expected)


LEARNERS = [learner() for learner in controllers.LEARNERS]
STATEFUL = {**BLOCKS, **{type(learner).__name__: brain(learner) for learner in LEARNERS}}


@pytest.mark.sampled(9)
@pytest.mark.parametrize("block", STATEFUL.values(), ids=STATEFUL)
def test_scratch_space_is_no_state_and_no_order_of_calls_matters(block):
    """Whatever stands in memory besides the state, and whatever was asked before: the same question has the same answer."""
    system = block.to_control(DT, engine="interpreted")
    memory, machine = system._machine._run.memory, system._machine
    begin, rng = machine._schedule.slots[0].start, np.random.default_rng(2)
    states = np.arange(begin["state"], begin["parameters"])
    before = memory.copy()
    memory[states] = mark = 12345.678
    with np.errstate(all="ignore"):
        system.dynamics(0.0, np.full(system.nstates, mark), np.zeros(system.ninputs))
    scratch = np.setdiff1d(states[memory[states] != mark], machine._carried)  # the rest is read only
    memory[:] = before
    outputs = begin["outputs"]
    u = 20.0 + rng.normal(size=(6, system.ninputs))
    x, steps = system.initial_state, []
    for k in range(6):
        y = system.output(k * DT, x, u[k])
        steps.append((k, x, u[k], y, system.dynamics(k * DT, x, u[k])))
        x = steps[-1][-1]
    for k, x, v, y, after in reversed(steps):
        for fill in (np.nan, 7.0):
            memory[scratch], memory[outputs : outputs + system.noutputs] = fill, fill
            machine._evaluated = machine._stepped = None
            np.testing.assert_array_equal(system.dynamics(k * DT, x, v), after)
            np.testing.assert_array_equal(system.output(k * DT, x, v), y)


def test_the_state_is_what_is_carried_on_and_nothing_else():
    assert cosim.StateSpace(control.ss(-np.eye(3), np.eye(3), np.eye(3), 0)).to_control(
        DT, engine="interpreted"
    ).state_labels == [f"system_x[{i}]" for i in range(3)]
    fixed = brain(controllers.FixedPrecision()).to_control(engine="interpreted")
    doubts = [f"doubts[{row},{sensor}]" for row in range(4) for sensor in range(2)]  # of absurd samples
    own = [
        k for k, label in enumerate(fixed.state_labels) if not label.startswith("seer_")
    ]  # of the check of the model
    assert [fixed.state_labels[k] for k in own] == ["mean", "covariance", "applied", *doubts, "widening"]
    assert fixed.initial_state[own].tolist() == [20.0, 1.0, 0.0, *[0.0] * 8, 1.0]
    assert cosim.Gain(2.0).to_control(DT, engine="interpreted").nstates == 0
    assert cosim.Gain(2.0).to_control(DT, engine="interpreted")(3.0) == 6.0
    freeze = FAULTS[0].to_control(DT, engine="interpreted")
    assert freeze.nstates < sum(np.size(v) for v in FAULTS[0].define(MODEL.step).state.values()) + 1


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_noise_is_that_of_the_diagram_or_an_input_or_none(engine):
    block = cosim.Gaussian(std=2.0, mean=1.0)
    drawn = response(block.to_control(DT, seed=7, name="n", engine=engine)).outputs[0]
    np.testing.assert_array_equal(drawn, 1.0 + 2.0 * cosim.random.numbers(7, "n.noise", len(T)))
    later = block.to_control(DT, seed=7, name="n", engine=engine)
    np.testing.assert_array_equal(response(later, times=T[70:]).outputs[0], drawn[70:])
    given = block.to_control(DT, inputs=["noise"], engine=engine)
    np.testing.assert_array_equal(response(given, T).outputs[0], 1.0 + 2.0 * T)
    np.testing.assert_array_equal(response(block.to_control(DT, seed=None, engine=engine)).outputs[0], np.ones(len(T)))


# --- diagrams and interconnections --------------------------------------------------------------------------------------------


def in_pieces(plant, seed):
    """Return the closed loop put together by python-control, a system for each block."""
    blocks = [
        (cosim.Sensors(count=2, std=1.0), "sensors", {"u": "v"}, {"y": "read"}),
        (cosim.Freeze(sensor=0, start=0.5, stop=1.5, channels=2), "freeze_0", {"u": "read"}, {"y": "samples"}),
        (cosim.Sine(amplitude=5.0, period=8.0, offset=20.0), "reference", None, {"y": "goal[0]"}),
        (cosim.Gaussian(std=0.001**0.5), "disturbance_noise", None, {"y": "disturbance"}),
        (brain(), "controller", {"y": "samples", "goal": "goal"}, {"u[0]": "force", "x_hat": "estimate"}),
    ]
    parts = [
        block.to_control(DT, inputs=inputs, outputs=outputs, seed=seed, engine="interpreted", name=name)
        for block, name, inputs, outputs in blocks
    ]
    return control.interconnect([plant, *parts], inputs=[], outputs=["v", "force", "estimate[0]"], check_unused=False)


PLANTS = {
    "python-control's own": lambda: linear_car(),
    "block": lambda: cosim.StateSpace(linear_car(), initial=[20.0]).to_control(engine="interpreted", name="plant"),
    "FMU": lambda: car().to_control(DT, engine="interpreted", name="plant"),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_a_loop_put_together_by_python_control_gives_our_numbers(plant):
    ours = loop(cosim.StateSpace(linear_car(), initial=[20.0])).simulate(2.0, seed=3, engine="interpreted")
    system = in_pieces(plant(), seed=3)
    start = cosim.initial_state(system)
    start[0] = 20.0  # the car's, of which python-control's own system knows nothing
    got = response(system, X0=start)
    assert np.ptp(got.outputs[1]) > 100.0
    for row, name in zip(got.outputs, ["plant.v", "controller.u", "controller.x_hat"], strict=True):
        np.testing.assert_allclose(row, ours[name].ravel(), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("plant", [cosim.StateSpace(linear_car(), initial=[20.0]), car()], ids=["block", "FMU"])
def test_a_whole_loop_as_one_system_gives_our_numbers(plant, engine):
    diagram = loop(plant)
    ours = diagram.simulate(2.0, seed=3)
    system = diagram.to_control(outputs=["plant.v", "controller.precision"], seed=3, engine=engine, name="loop")
    assert (system.ninputs, system.output_labels[:2]) == (0, ["plant_v", "controller_precision[0]"])
    got = response(system)
    np.testing.assert_array_equal(got.outputs[0], ours["plant.v"])
    np.testing.assert_array_equal(got.outputs[1:].T, ours["controller.precision"])


def test_a_signal_from_outside_takes_the_place_of_one_inside():
    diagram = loop(cosim.StateSpace(linear_car(), initial=[20.0]), faults=())
    ours = diagram.simulate(2.0, seed=3, engine="interpreted")
    given = {"reference.y": "goal", "plant.disturbance": "push"}
    system = diagram.to_control(inputs=given, outputs={"plant.v": "v"}, seed=3, engine="interpreted")
    assert (system.input_labels, system.output_labels) == (["goal", "push"], ["v"])
    push = ours["disturbance_noise.y"]
    np.testing.assert_array_equal(response(system, np.vstack([ours["reference.y"], push])).outputs[0], ours["plant.v"])
    # The loop opened at the control: what the car does is then up to the force alone.
    opened = diagram.to_control(inputs=["controller.u"], outputs=["plant.v"], seed=None, engine="interpreted")
    expected = control.forced_response(linear_car(), T, np.vstack([300.0 * T, 0 * T]), 20.0).outputs
    np.testing.assert_allclose(response(opened, 300.0 * T).outputs[0], np.ravel(expected), rtol=1e-12)
    assert diagram.schedule is diagram.schedule  # the diagram itself stays as it was
    np.testing.assert_array_equal(diagram.simulate(2.0, seed=3, engine="interpreted")["plant.v"], ours["plant.v"])


def test_a_diagram_that_is_not_closed_has_what_it_lacks_as_inputs():
    diagram = cosim.Diagram(DT)
    first, second = diagram.add(cosim.Sum("+-"), "first"), diagram.add(cosim.UnitDelay(), "second")
    diagram.connect(first["y"], second["u"])
    diagram.connect(second["y"], first["u"][1])
    system = diagram.to_control(outputs=["first.y"], engine="interpreted")
    assert system.input_labels == ["first_u[0]"]
    np.testing.assert_array_equal(response(system, np.ones(len(T))).outputs[0], 1.0 - np.arange(len(T)) % 2)
    diagram.add(cosim.Gain(1.0), "third")  # it is not frozen
    assert diagram.to_control(outputs=["first.y"], engine="interpreted").input_labels == ["first_u[0]", "third_u"]


def test_blocks_of_several_rates():
    diagram = cosim.Diagram(DT)
    source, slow = diagram.add(cosim.Sine(1.0, period=0.5), "source"), diagram.add(cosim.UnitDelay(), "slow", every=3)
    last, plant = diagram.add(cosim.Gain(2.0), "last"), diagram.add(car(), "plant", every=2)
    diagram.connect(source["y"], slow["u"])
    diagram.connect(slow["y"], last["u"])
    diagram.connect(last["y"], plant["force"])
    ours = diagram.simulate(2.0, engine="interpreted")
    system = diagram.to_control(outputs=["last.y", "plant.v"], engine="interpreted")
    assert {"slow_held", "slow_y_held", "plant_v", "plant_v_held"} == set(system.state_labels)
    for row, name in zip(response(system).outputs, ["last.y", "plant.v"], strict=True):
        np.testing.assert_array_equal(row, ours[name])


def test_a_system_that_stands_twice_has_an_fmu_of_its_own():
    system = car().to_control(DT, name="one")
    parts = [system, system.copy("two")]
    both = control.interconnect(
        parts, connections=False, inplist=["one.force", "two.force"], outlist=["one.v", "two.v"], check_unused=False
    )
    force = np.vstack([1000.0 + 0 * T, -1000.0 + 0 * T])
    got = response(both, force).outputs
    for row, push in zip(got, force, strict=True):
        np.testing.assert_allclose(
            row, np.ravel(control.forced_response(linear_car(), T, np.vstack([push, 0 * T]), 20.0).outputs)
        )
    assert deepcopy(system)._machine is not system._machine
    copied = pickle.loads(pickle.dumps(system))
    np.testing.assert_array_equal(response(copied, np.vstack([force[0], 0 * T])).outputs[0], got[0])


# --- linearization and operating points ---------------------------------------------------------------------------------------


def test_linear_systems_come_back():
    rng = np.random.default_rng(0)
    a, b, c, d = (
        0.3 * rng.normal(size=(3, 3)),
        rng.normal(size=(3, 2)),
        rng.normal(size=(2, 3)),
        rng.normal(size=(2, 2)),
    )
    block = cosim.StateSpace(control.ss(a, b, c, d, DT))
    found = control.linearize(block.to_control(engine="interpreted"), np.ones(3), [0.3, -0.2])
    for matrix, expected in zip((found.A, found.B, found.C, found.D), (a, b, c, d), strict=True):
        np.testing.assert_allclose(matrix, expected, atol=1e-8)
    held = control.sample_system(control.ss(a, b, c, d), DT, "zoh")
    found = cosim.StateSpace(control.ss(a, b, c, d)).to_control(DT, engine="interpreted").linearize(np.zeros(3), 0)
    np.testing.assert_allclose(found.A, held.A, atol=1e-8)
    np.testing.assert_allclose(found.B, held.B, atol=1e-8)


def test_the_poles_of_a_closed_loop_are_those_of_plant_and_filter():
    """With fixed precision and a control prior it is a Kalman filter under a linear law: certainty equivalence separates them."""
    fixed = brain(controllers.FixedPrecision(), control_covariance=1e7)
    diagram = cosim.closed_loop(
        plant=cosim.StateSpace(linear_car()), controller=fixed, control="force", measured="v",
        sensors=cosim.Sensors(count=2, std=1.0), reference=20.0,
    )  # fmt: skip
    system = diagram.to_control(inputs=["reference.y"], outputs=["plant.v"], seed=None, engine="interpreted")
    start = system.initial_state
    found = control.find_operating_point(system, start, [20.0])
    poles = np.sort(np.abs(np.linalg.eigvals(control.linearize(system, found.states, [20.0]).A)))
    P = control.dare([[A]], [[1.0, 1.0]], [[0.001]], np.eye(2))[0][0, 0]  # of the prediction, at rest
    gain = P / (P + 0.5)  # of the mean of both sensors
    spread = A**2 * (1 - gain) * P + 0.001 + 1.0  # of the next state, and of the goal
    law = A * (B / spread) / (B**2 / spread + 1e-7)
    assert A - B * law < 0.9
    for pole in (A - B * law, A * (1 - gain), (A * (1 - gain)) ** 2):
        assert np.min(np.abs(poles - pole)) < 1e-5, (pole, poles)  # python-control takes differences
    assert max(poles) < 1.0


@pytest.mark.parametrize("fmi", FMI)
def test_our_fmus_have_their_numbers_as_state(fmi):
    system = car(fmi).to_control(DT)
    assert system.state_labels == ["v"]
    assert system.initial_state.tolist() == [20.0]
    found = control.linearize(system, [20.0], [0.0, 0.0])
    np.testing.assert_allclose(found.A, [[A]], atol=1e-8)
    np.testing.assert_allclose(found.B, [[B, 1.0]], atol=1e-8)
    point = control.find_operating_point(system, [10.0], [0.0, 0.0], y0=[25.0], iu=[1], iy=[0])
    np.testing.assert_allclose([*point.states, *point.inputs], [25.0, 125.0, 0.0], rtol=1e-9, atol=1e-9)
    force = 500.0 * np.sin(3 * T)
    got = response(system, np.vstack([force, 0 * T]), X0=[12.0])  # any state can be set
    exact = control.forced_response(linear_car(), T, np.vstack([force, 0 * T]), 12.0)
    np.testing.assert_allclose(got.outputs[0], np.ravel(exact.outputs), rtol=1e-13)
    np.testing.assert_array_equal(got.states[0], got.outputs[0])


def test_an_arm_as_an_fmu_is_held_up_by_the_torques_of_its_weight():
    arm = cosim.FMU(fmus.path("TwoLinkArm"))
    system = arm.to_control(0.01, outputs=["q1", "q2"])
    assert system.state_labels == ["q1", "q2", "dq1", "dq2", "x", "y"]
    point = control.find_operating_point(system, system.initial_state, [0.0, 0.0], y0=[-1.0, 0.3])
    m1, m2, L1, g1, g2, g = (arm.start_value(name) for name in ("m1", "m2", "L1", "Lg1", "Lg2", "g"))
    second = g * m2 * g2 * np.cos(-0.7)
    np.testing.assert_allclose(point.inputs, [g * (m1 * g1 + m2 * L1) * np.cos(-1.0) + second, second], rtol=1e-6)
    np.testing.assert_allclose(point.states[:4], [-1.0, 0.3, 0.0, 0.0], atol=1e-7)
    poles = np.linalg.eigvals(control.linearize(system, system.initial_state, [0.0, 0.0]).A)
    assert np.sort(np.abs(poles))[2:].max() < 1.0  # it hangs at rest, with friction


# --- FMUs of others -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def foreign(tmp_path):
    """Return cars as another tool would have made them: their state is known to themselves alone."""

    def make(fmi="2.0", saves=True, **options):
        path = tmp_path / f"{fmi}{saves}.fmu"
        with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                content = old.read(name)
                if name == "modelDescription.xml":
                    assert b"<bayesftc timing" in content
                    content = content.replace(b"<bayesftc timing", b"<other timing")
                    for word in (b"state", b"State"):
                        if not saves:
                            content = content.replace(
                                b'canGetAndSetFMU%s="true"' % word, b'canGetAndSetFMU%s="false"' % word
                            )
                            content = content.replace(
                                b'canSerializeFMU%s="true"' % word, b'canSerializeFMU%s="false"' % word
                            )
                new.writestr(name, content)
        return car(path=path, **options)

    return make


@pytest.mark.sampled(3)
@pytest.mark.parametrize("coupling", ["jacobi", "gauss-seidel", "iterated"])
@pytest.mark.parametrize("own", [True, False])
def test_coupled_fmus_give_the_numbers_of_their_coupling(foreign, coupling, own):
    diagram = cosim.Diagram(DT)
    first, second = (diagram.add(car() if own else foreign(), name) for name in ("first", "second"))
    gain = diagram.add(cosim.Gain(-0.1))
    diagram.connect(first["v"], second["disturbance"])
    diagram.connect(second["v"], gain["u"])
    diagram.connect(gain["y"], first["disturbance"])
    ours = diagram.build(coupling).simulate(2.0, engine="interpreted")
    system = diagram.to_control(outputs=["first.v", "second.v"], engine="interpreted")
    for row, name in zip(response(system).outputs, ["first.v", "second.v"], strict=True):
        np.testing.assert_array_equal(row, ours[name])


@pytest.mark.slow
def test_an_isolated_fmu_is_one_like_any_other():
    system = car(isolate=True).to_control(DT, inputs=["force"], engine="interpreted")
    twin = car().to_control(DT, inputs=["force"], engine="interpreted")
    force = 500.0 * np.sin(T)
    np.testing.assert_array_equal(response(system, force).outputs, response(twin, force).outputs)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("saves", [True, False])
@pytest.mark.parametrize("fmi", FMI)
def test_any_fmu_stands_in_a_loop_of_python_control(foreign, fmi, saves):
    ours = loop(cosim.StateSpace(linear_car(), initial=[20.0])).simulate(2.0, seed=3, engine="interpreted")
    plant = foreign(fmi, saves).to_control(DT, name="plant")
    assert plant.state_labels == ["snapshot" if saves else "step"]
    system = in_pieces(plant, seed=3)
    for _ in range(2):  # the second time it begins anew
        got = response(system)
        np.testing.assert_allclose(got.outputs[0], ours["plant.v"], rtol=1e-12)
    with pytest.raises(ModelError, match=r"'plant' is hidden.*LinearModel\.from_fmu"):
        control.linearize(plant, 0.0, [0.0, 0.0])
    for refused in (plant, system):
        with pytest.raises(ModelError, match=r"'plant' is hidden.*LinearModel\.from_fmu"):
            control.find_operating_point(refused, cosim.initial_state(refused), np.zeros(refused.ninputs))
    with pytest.raises(ModelError, match=r"LinearModel\.from_fmu"):
        control.linearize(system, cosim.initial_state(system))


def test_saved_states_are_asked_in_any_order(foreign):
    system = foreign().to_control(DT)
    x = [np.zeros(1)]
    pushes = np.random.default_rng(1).normal(size=(20, 2))
    for k, u in enumerate(pushes):
        x.append(system.dynamics(k * DT, x[-1], u))
    v = [20.0]
    for u in pushes:
        v.append(A * v[-1] + B * u[0] + u[1])
    for k in (20, 3, 11, 0):
        assert system.output(k * DT, x[k], [0.0, 0.0]) == pytest.approx(v[k], rel=1e-13)
    assert system.dynamics(3 * DT, x[3], pushes[3]) == x[4]  # the same step leads to the same state
    other = system.dynamics(3 * DT, x[3], pushes[4])
    assert other not in x
    assert system.output(4 * DT, other, [0, 0]) == pytest.approx(A * v[3] + B * pushes[4, 0] + pushes[4, 1], rel=1e-13)
    with pytest.raises(
        ModelError, match=r"cannot be evaluated at t = 0\.1 s in its saved state number 3, which is of t = 0\.06 s"
    ):
        system.output(5 * DT, x[3], [0.0, 0.0])
    for nonsense in (0.5, -1.0, 1000.0, np.nan):
        with pytest.raises(ModelError, match="is the number of a saved state, and"):
            system.output(0.0, [nonsense], [0.0, 0.0])


def test_only_the_latest_saved_states_are_kept(foreign, monkeypatch):
    monkeypatch.setattr("bayesftc.cosim.control.externals.SNAPSHOTS", 5)
    system = foreign().to_control(DT)
    got = response(system, np.zeros((2, len(T))))
    (external,) = system._machine._externals
    assert len(external._saved) == 6
    assert len(external._origins) == len(external._reached) == len(external._steps) - 1 == 5
    np.testing.assert_allclose(got.outputs[0], 20.0 * A ** np.arange(len(T)), rtol=1e-12)
    assert system.output(T[-1], got.states[:, -1], [0.0, 0.0]) == got.outputs[0, -1]
    with pytest.raises(ModelError, match="saved state number 10, because only the first and the latest 5 are kept"):
        system.output(T[10], got.states[:, 10], [0.0, 0.0])


def test_an_fmu_that_cannot_save_is_stepped_in_order(foreign):
    system = foreign(saves=False).to_control(DT)
    x = system.dynamics(0.0, [0.0], [100.0, 0.0])
    assert system.dynamics(0.0, [0.0], [100.0, 0.0]) == x == [1.0]  # what was asked last may be asked again
    assert system.output(DT, x, [0.0, 0.0]) == A * 20.0 + B * 100.0
    system.dynamics(DT, x, [0.0, 0.0])
    with pytest.raises(
        ModelError,
        match="cannot be set to its state after 1 steps, because it is in that after 2 steps and cannot save",
    ):
        system.dynamics(DT, [1.0], [1.0, 0.0])
    assert system.output(0.0, [0.0], [0.0, 0.0]) == 20.0  # begins anew
    with pytest.raises(FMUError, match="has timing='sampled' and cannot save its state"):
        foreign(saves=False, timing="sampled").to_control(DT)


@pytest.mark.parametrize("make", [lambda foreign: foreign(timing="sampled"), lambda foreign: car(timing="sampled")])
def test_a_sampled_fmu_shows_its_inputs_at_once(foreign, make, fed):
    block = make(foreign)
    force = 1000.0 * np.sin(5 * T)
    ours = fed(block, {"force": force[None]}).simulate(2.0, engine="interpreted")["block.v"]
    system = block.to_control(DT, inputs=["force"], engine="interpreted")
    got = response(system, force)
    np.testing.assert_array_equal(got.outputs[0], ours)
    x = got.states[:, 7]
    assert system.output(T[7], x, [5.0]) != system.output(T[7], x, [6.0])
    assert system.output(T[7], x, [force[7]]) == ours[7]


def test_failures_are_sentences_and_leave_the_system_as_it_was(foreign):
    for system in (
        car().to_control(DT),
        foreign().to_control(DT),
        cosim.StateSpace(linear_car()).to_control(engine="interpreted"),
    ):
        start = system.initial_state
        with pytest.raises(
            SimulationError, match=r"at t = 0\.04 s \(step 2\): \w+\.v came out infinite\. Check .* of 0\.02 s\.$"
        ):
            response(system, np.full((2, len(T)), 1.7e308), X0=start)
        assert np.isfinite(response(system, np.zeros((2, len(T))), X0=start).outputs).all()


def test_instances_are_freed_with_their_system():
    from bayesftc.cosim.fmi.binaries.loading import load_library

    block = car()
    library, systems = load_library(*block._read()), []
    gc.collect()
    before = library.alive
    for _ in range(3):
        systems.append(block.to_control(DT))
        response(systems[-1], np.zeros((2, len(T))))
    assert library.alive == before + 3
    systems.clear()
    gc.collect()
    assert library.alive == before


def test_an_interrupted_step_leaves_nothing_behind(foreign, monkeypatch):
    for system in (car().to_control(DT, engine="interpreted"), foreign().to_control(DT, engine="interpreted")):
        x, machine = system.initial_state, system._machine
        first = system.dynamics(0.0, x, [100.0, 0.0])
        step = machine._engine.step

        def stopped(k, step=step):
            step(k)
            raise KeyboardInterrupt

        monkeypatch.setattr(machine._engine, "step", stopped)
        with pytest.raises(KeyboardInterrupt):
            system.dynamics(DT, first, [100.0, 0.0])
        monkeypatch.undo()
        assert system.output(DT, first, [0.0, 0.0]) == A * 20.0 + B * 100.0
        again = system.dynamics(DT, first, [100.0, 0.0])
        assert system.output(2 * DT, again, [0.0, 0.0]) == A * (A * 20.0 + B * 100.0) + B * 100.0


# --- where it begins, times, names --------------------------------------------------------------------------------------------


def test_a_beginning_at_zeros_is_told_once():
    system = brain().to_control(outputs=["u"], engine="interpreted")
    given = np.full((3, len(T)), 20.0)
    with pytest.warns(
        UserWarning, match=r"starts a system at zeros, here with controller.mean = 0.*X0=cosim\.initial_state"
    ):
        control.input_output_response(system, T, given)
    again = brain().to_control(outputs=["u"], engine="interpreted")
    assert response(again, given).outputs[0, 0] == pytest.approx(20.0 * (1 - A) / B, rel=1e-12)
    assert cosim.initial_state(linear_car()).tolist() == [0.0]


def test_a_beginning_at_zeros_is_told_in_continuous_time_too(casadi_fmu):
    system = cosim.FMU(casadi_fmu("begins", lambda q, u: q)).to_control()  # at q = 0.5
    with pytest.warns(UserWarning, match=r"starts a system at zeros, here with q = 0.*X0=cosim\.initial_state"):
        control.input_output_response(system, T, 0.0)
    response(system)


def test_params_that_reach_nothing_are_told_once():
    """The plant line is changed for an FMU, and the script goes on to give the mass where python-control takes it."""
    system = car().to_control(DT, engine="interpreted")
    with pytest.warns(
        UserWarning, match=r"params=\{'m': \.\.\.\} of python-control does not reach the FMU 'cruisecontrol'"
    ):
        response(system, np.zeros((2, len(T))), params={"k": 1.0, "m": 200.0})
    response(system, np.zeros((2, len(T))), params={"m": 200.0})
    response(car().to_control(DT, engine="interpreted"), np.zeros((2, len(T))), params={"k": 1.0})  # of another system
    tank = control.nlsys(
        lambda t, x, u, params: [u[0] - params["k"] * x[0]], None, inputs=1, states=1, params={"k": 0.5}
    )
    whole = cosim.StateSpace(tank, feedthrough=False).to_control(DT)
    with pytest.warns(
        UserWarning, match=r"does not reach the system within the block.*cosim\.StateSpace\(\.\.\., params="
    ):
        response(whole, params={"k": 1.0})


def test_times_are_multiples_of_the_step():
    system = cosim.UnitDelay().to_control("1/30", engine="interpreted")
    assert response(system, np.arange(301), times=np.arange(301) * (1 / 30)).outputs[0].tolist() == [0, *range(300)]
    for t in (0.01, -1.0, np.inf):
        with pytest.raises(StepSizeError, match=r"has a sample time of 1/30 s and begins at 0"):
            system.output(t, [0.0], [0.0])


def test_a_missing_sample_passes_through_a_system_of_its_own():
    diagram = loop(
        cosim.StateSpace(linear_car(), initial=[20.0]), faults=[cosim.Dropout(sensor=0, start=0.5, stop=1.0)]
    )
    ours = diagram.simulate(2.0, seed=1, engine="interpreted")
    system = diagram.to_control(outputs=["plant.v", "sensors.y"], seed=1, engine="interpreted")
    np.testing.assert_array_equal(response(system).outputs[0], ours["plant.v"])


@pytest.mark.parametrize(
    ("make", "error", "sentence"),
    [
        (
            lambda: cosim.Gain(1.0).to_control(),
            ModelError,
            r"Gain has no sample time; give to_control\(dt=\.\.\.\)",
        ),
        (lambda: brain().to_control(0.1), StepSizeError, r"every 0\.02 s.*every 0\.1 s"),
        (
            lambda: cosim.Gain(1.0).to_control(DT, inputs=["v"]),
            UnknownNameError,
            "There is no input 'v'; did you mean|known",
        ),
        (
            lambda: brain().to_control(outputs=["precison"]),
            UnknownNameError,
            "no output 'precison'; did you mean 'precision'",
        ),
        (
            lambda: brain().to_control(inputs=["y"]),
            UnconnectedInputError,
            r"controller\.goal\[0\] of BayesianController .* add it",
        ),
        (lambda: brain().to_control(outputs=["u[3]"]), UnknownNameError, r"no output 'u\[3\]'"),
        (lambda: brain().to_control(outputs=["u", "u"]), ModelError, "one of its outputs twice"),
        (lambda: brain().to_control(outputs=["u", "u[0]"]), ModelError, r"two outputs 'u\[0\]', or one of them twice"),
        (lambda: brain().to_control(outputs={"u": "a", "beta": "a"}), ModelError, r"two outputs 'a\[0\]'"),
        (lambda: loop(car()).to_control(inputs=["plant.forse"]), UnknownNameError, "did you mean 'plant.force'"),
        (lambda: car().to_control(DT, seed=-1), ModelError, "The seed is -1"),
        (lambda: car().to_control(DT, engine="fast"), ModelError, "engine is 'fast'"),
    ],
)
def test_refusals_are_sentences(make, error, sentence):
    with pytest.raises(error, match=sentence) as caught:
        make()
    assert str(caught.value).endswith((".", "?"))


# --- results ------------------------------------------------------------------------------------------------------------------


def test_results_are_responses_that_plot():
    runs = [
        loop(cosim.StateSpace(linear_car(), initial=[20.0])).simulate(2.0, seed=s, engine="interpreted") for s in (1, 2)
    ]
    one = runs[0].to_control(["plant.v", "sensors.y"])
    assert one.output_labels == ["plant.v", "sensors.y[0]", "sensors.y[1]"]
    shown = one.plot()
    assert [axes.get_ylabel() for axes in shown.axes[:, 0]] == one.output_labels
    np.testing.assert_array_equal(shown.lines[0, 0][0].get_ydata(), runs[0]["plant.v"])
    driven = runs[0].to_control("plant.v", inputs=["reference.y", "controller.u"])
    assert driven.input_labels == ["reference.y", "controller.u[0]"]
    np.testing.assert_array_equal(driven.inputs, [runs[0]["reference.y"], runs[0]["controller.u"][:, 0]])
    assert [len(driven.plot(plot_inputs=shown).axes) for shown in (None, True)] == [1, 3]
    several = control.combine_time_responses([run.to_control("plant.v") for run in runs], trace_labels=["a", "b"])
    lines = several.plot(overlay_traces=True).lines[0, 0]
    assert several.ntraces == len(lines) == 2
    np.testing.assert_array_equal(lines[1].get_ydata(), runs[1]["plant.v"])
