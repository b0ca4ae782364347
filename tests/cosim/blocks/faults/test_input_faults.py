"""Faults of actuators and of the process: they stand before the plant, and the controller knows nothing of them."""

import numpy as np
import pytest
from block_kinds import fault_of
from numpy.testing import assert_allclose, assert_array_equal

from bayesftc import controllers, cosim, fmus
from bayesftc.controllers.bayesian.validation import check_kalman
from bayesftc.cosim.blocks.faults.kinds import FAULTS
from bayesftc.cosim.errors import ConnectionError, ModelError, UnconnectedInputError, UnknownNameError
from bayesftc.cosim.judging.figures.loop_figure import plot_run
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.random import numbers

DT, A, B = 0.02, 0.999, 2e-4
MODEL = controllers.LinearModel([[A]], [[B]], [[1], [1]], process_covariance=0.001, sensor_covariance=1.0, dt=DT)
WINDOW = {"start": 0.4, "stop": 0.8}
DURATION = 1.2
NOISE = {"disturbance": cosim.Gaussian(std=0.03)}
RECORD = ["*", "plant.force", "plant.disturbance"]
INSIDE = slice(20, 40)


def fmu():
    return cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 20.0})


def python_control():
    import control

    system = control.ss([[A]], [[B, 1.0]], [[1.0]], [[0.0, 0.0]], DT, inputs=["force", "disturbance"], outputs=["v"])
    return cosim.StateSpace(system, initial=[20.0])


def car(plant=None, noise=NOISE, **options):
    """The car of the paper under a Kalman filter's control."""
    settings = {
        "controller": controllers.BayesianController(MODEL, precision=controllers.FixedPrecision(), initial_mean=20.0),
        "control": "force",
        "measured": "v",
        "noise": noise,
        "sensors": cosim.Sensors(count=2, std=1.0),
        "reference": cosim.Sine(amplitude=5.0, period=8.0, offset=20.0),
        **options,
    }
    return cosim.closed_loop(plant or fmu(), **settings)


def short(loop, **options):
    options = {"seed": 3, "engine": "interpreted", "record": RECORD, **options}
    return loop.simulate(options.pop("duration", DURATION), **options)


def examples():
    """Every kind of fault that can befall an input, by its name."""
    for kind in FAULTS:
        if kind is not cosim.Dropout:
            yield fault_of(kind, **WINDOW)


EXAMPLES = list(examples())


@pytest.mark.sampled(8)
@pytest.mark.parametrize("fault", EXAMPLES, ids=lambda fault: type(fault).__name__)
def test_every_kind_stands_between_controller_and_plant(fault):
    name = f"force_{fault.default_name}"
    result, healthy = short(car(input_faults={"force": fault})), short(car())
    assert_array_equal(result["plant.force"], result[f"{name}.y"][:, 0])
    present = result[f"{name}.active"] > 0.5
    absent = ~present
    assert_array_equal(result["plant.force"][absent], result["controller.u"][absent, 0])
    if not isinstance(fault, cosim.RandomFaults):
        assert_array_equal(np.flatnonzero(present), np.arange(20, 40))
    # What the plant makes of it, by its difference equation.
    v, noise = result["plant.v"], result["disturbance_noise.y"]
    assert_allclose(v[1:], A * v[:-1] + B * result["plant.force"][:-1] + noise[:-1], rtol=1e-12)
    # All else is as without it: before the onset to the last bit, and the noise throughout.
    first = int(np.argmax(present))
    assert_array_equal(result["controller.u"][: first + 1], healthy["controller.u"][: first + 1])
    assert_array_equal(noise, healthy["disturbance_noise.y"])
    assert_allclose(result["sensors.y"] - v[:, None], healthy["sensors.y"] - healthy["plant.v"][:, None], atol=1e-12)


@pytest.mark.parametrize(
    ("fault", "formula"),
    [
        (cosim.GainFault(factor=0.6, **WINDOW), lambda u, age: 0.6 * u[INSIDE]),
        (cosim.Freeze(**WINDOW), lambda u, age: np.full(20, u[19])),
        (cosim.Stuck(at=150.0, **WINDOW), lambda u, age: np.full(20, 150.0)),
        (cosim.Bias(magnitude=-80.0, **WINDOW), lambda u, age: u[INSIDE] - 80.0),
        (cosim.Drift(slope=40.0, **WINDOW), lambda u, age: u[INSIDE] + 40.0 * age),
    ],
    ids=["loss of effectiveness", "stuck where it was", "stuck at a value", "added", "growing"],
)
def test_faults_of_an_actuator_by_their_formulas(fault, formula):
    result = short(car(input_faults={"force": fault}))
    assert_allclose(
        result["plant.force"][INSIDE], formula(result["controller.u"][:, 0], DT * np.arange(20)), rtol=1e-12
    )


@pytest.mark.parametrize("plant", [fmu, python_control])
def test_the_controller_believes_in_what_it_sent(plant, run_both):
    loop = car(
        plant(), input_faults={"force": [cosim.GainFault(factor=0.5, start=0.4), cosim.Bias(magnitude=90.0, start=1)]}
    )
    result = run_both(loop, 2.0, seed=3, record=RECORD)
    sent, received = result["controller.u"][:, 0], result["plant.force"]
    assert_array_equal(received[:20], sent[:20])
    assert_allclose(received[20:50], 0.5 * sent[20:50], rtol=1e-12)
    assert_allclose(received[50:], 0.5 * sent[50:] + 90.0, rtol=1e-12)
    # filterpy's filter, given what was sent, has the very belief of the controller.
    assert check_kalman(result, loop["controller"].block, y="sensors.y").mean_difference < 1e-9


def test_both_plants_give_the_same_run():
    faults = {"force": cosim.GainFault(factor=0.3, start=0.2), "disturbance": cosim.Drift(slope=0.1, start=0.6)}
    ours, theirs = (short(car(plant(), input_faults=faults))["plant.v"] for plant in (fmu, python_control))
    assert_allclose(ours, theirs, rtol=1e-12)


def test_one_of_several_actuators():
    A2, B2 = [[0.9, 0.1], [0.0, 0.8]], [[0.1, 0.0], [0.0, 0.2]]
    import control

    system = control.ss(A2, B2, np.eye(2), np.zeros((2, 2)), DT, inputs=["left", "right"], outputs=["a", "b"])
    model = controllers.LinearModel(A2, B2, np.eye(2), process_covariance=1e-3, sensor_covariance=1e-2, dt=DT)
    loop = cosim.closed_loop(
        cosim.StateSpace(system),
        controllers.BayesianController(model, precision=controllers.FixedPrecision()),
        control=["left", "right"],
        measured=["a", "b"],
        sensors=cosim.Sensors(count=2, std=0.1),
        reference=[1.0, 2.0],
        input_faults={"right": cosim.Stuck(at=-1.0, start=0.5)},
    )
    result = loop.simulate(1.0, engine="interpreted", record=["*", "plant.left", "plant.right"])
    assert_array_equal(result["plant.left"], result["controller.u"][:, 0])
    assert_array_equal(result["plant.right"][:25], result["controller.u"][:25, 1])
    assert_array_equal(result["plant.right"][25:], np.full(26, -1.0))
    (right,) = loop_signals(loop, result).inputs
    assert right.name == "right"


@pytest.mark.parametrize("noise", [NOISE, None], ids=["on top of the noise", "of an input at rest"])
def test_faults_of_the_process(noise):
    loop = car(noise=noise, input_faults={"disturbance": [cosim.Bias(magnitude=-0.04, **WINDOW)]})
    result = short(loop)
    rest = result["disturbance_noise.y"] if noise else np.zeros(61)
    expected = rest.copy()
    expected[INSIDE] -= 0.04
    assert_allclose(result["plant.disturbance"], expected, rtol=1e-12)
    assert "disturbance_start" in [n.name for n in loop.nodes] or noise


def test_random_faults_are_those_of_their_stream():
    kinds = (cosim.GainFault(factor=0.5), cosim.Freeze(), cosim.Bias(magnitude=100.0))
    fault = cosim.RandomFaults(kinds=kinds, mean_time_to_fault=0.4, mean_time_to_recovery=0.2)
    result = short(car(input_faults={"force": fault}), duration=8.0)
    steps = len(result.time)
    drawn = numbers(3, "force_random_faults_0.transition", steps, uniform=True)
    on, present = False, []
    for number in drawn:
        on = number >= DT / 0.2 if on else number < DT / 0.4
        present.append(on)
    assert_array_equal(result["force_random_faults_0.active"] > 0.5, present)
    kind, sent, received = result["force_random_faults_0.kind"], result["controller.u"][:, 0], result["plant.force"]
    assert set(np.unique(kind)) == {-1.0, 0.0, 1.0, 2.0}
    assert_array_equal(received[kind == -1], sent[kind == -1])
    assert_allclose(received[kind == 0], 0.5 * sent[kind == 0], rtol=1e-12)
    assert_allclose(received[kind == 2], sent[kind == 2] + 100.0, rtol=1e-12)
    held = np.flatnonzero(kind == 1)
    begins = held[~np.isin(held - 1, held)]
    assert_array_equal(received[begins], sent[begins - 1])


@pytest.mark.slow
def test_what_is_known_of_a_run(tmp_path):
    """Input faults are among the phases of the errors, but are no faults of a sensor."""
    loop = car(
        faults=[cosim.Freeze(sensor=0, start=0.2, stop=0.3)],
        input_faults={
            "force": [cosim.GainFault(factor=0.5, **WINDOW), cosim.Freeze(start=1.0, stop=1.1, name="jam")],
            "disturbance": cosim.Bias(magnitude=0.1, start=0.9, stop=1.0),
        },
    )
    result = short(loop)
    signals = loop_signals(loop, result)
    assert {name: sensor for name, (sensor, _) in signals.faults.items()} == {"freeze_0": 0}
    force, disturbance = signals.inputs
    assert (force.name, force.unit, disturbance.name) == ("force", "N", "disturbance")
    assert list(force.faults) == ["force_gain_fault_0", "jam"]
    assert_array_equal(force.sent, result["controller.u"][:, 0])
    assert_array_equal(force.received, result["plant.force"])
    assert_array_equal(disturbance.sent, result["disturbance_noise.y"])
    assert_array_equal(np.flatnonzero(signals.sensors[0].faulty), np.arange(10, 15))
    assert not signals.sensors[1].faulty.any()
    assert_array_equal(np.flatnonzero(signals.faulty), [*range(10, 15), *range(20, 40), *range(45, 55)])
    found = figures(signals)
    of_force, of_disturbance = found.inputs
    assert (of_force.faults, of_force.fault_share) == (2, pytest.approx(25 / 61))
    difference = (force.received - force.sent)[[*range(20, 40), *range(50, 55)]]
    assert of_force.deviation == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert of_disturbance.deviation == pytest.approx(0.1)
    error = result["plant.v"] - result["reference.y"]
    assert found.tracking["v"].during == pytest.approx(np.sqrt(np.mean(error[signals.faulty] ** 2)))
    figure = plot_run(signals)
    labels = {axis.get_ylabel(): {line.get_label() for line in axis.lines} for axis in figure.axes}
    panels = {panel: {label for label in names if label[0] != "_"} for panel, names in labels.items()}  # without marks
    assert panels["force (N)"] == {"control", "received by force"}
    assert panels["disturbance (m/s)"] == {"sent", "received"}
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["sensor 0: freeze", "force: gain fault", "disturbance: bias", "force: jam"]
    figure.savefig(tmp_path / "run.png", dpi=50)


def test_what_was_not_recorded_is_not_made_up():
    loop = car(input_faults={"force": cosim.GainFault(factor=0.5, **WINDOW)})
    signals = loop_signals(loop, short(loop, record=["plant.v", "reference.y"]))
    (force,) = signals.inputs
    assert force.sent is force.received is force.faulty is signals.faulty is None
    (found,) = figures(signals).inputs
    assert np.isnan([found.fault_share, found.faults, found.deviation]).all()
    plot_run(signals)


@pytest.mark.parametrize(
    ("changes", "error", "sentence"),
    [
        (
            {"input_faults": {"froce": cosim.Freeze()}},
            UnknownNameError,
            r"names 'froce', which is no input of the plant; did you mean 'force'",
        ),
        ({"input_faults": {"v": cosim.Freeze()}}, ConnectionError, r"plant\.v, which is an output; name an input"),
        ({"input_faults": {"force": "freeze"}}, ModelError, r"faults must contain only faults, such as Freeze"),
        ({"input_faults": {"force": ["freeze"]}}, ModelError, r"not 'freeze'"),
        (
            {"input_faults": {"force": cosim.Freeze(sensor=1)}},
            ModelError,
            r"sensor=1 for 'force', which has 1 element,",
        ),
        ({"input_faults": {"force": cosim.Dropout()}}, ModelError, r"use Stuck\(at=0\.0\)"),
        (
            {"input_faults": {"force": cosim.RandomFaults(kinds=(cosim.Freeze(), cosim.Dropout()))}},
            ModelError,
            r"has a Dropout for 'force'",
        ),
        (
            {"input_faults": {"force": [cosim.Freeze(name="shut")] * 2}},
            ModelError,
            r"already has a block 'shut'; give this Freeze",
        ),
        ({"input_faults": [cosim.Freeze()]}, ModelError, r"input_faults=\{'force': "),
    ],
)
def test_what_does_not_fit(changes, error, sentence):
    plant = changes.pop("plant", fmu)()
    with pytest.raises(error, match=sentence):
        car(plant, **changes)


def test_names_of_ones_own():
    loop = car(input_faults={"force": [cosim.Freeze(start=1.0, stop=2.0), cosim.Freeze(start=3.0, name="again")]})
    assert {"force_freeze_0", "again"} <= {n.name for n in loop.nodes}


def test_an_input_without_a_value_cannot_be_at_rest(make_block):
    def still(v):
        v[0] = 20.0

    ports = (cosim.Port("force", feedthrough=False), cosim.Port("disturbance", feedthrough=False))
    plant = make_block(inputs=ports, outputs=(cosim.Port("v"),), output=still, name="plant")
    words = r"plant\.disturbance, which has no control, no noise and no start value; give it a source, such as closed_loop\("
    with pytest.raises(UnconnectedInputError, match=words):
        car(plant, noise=None, input_faults={"disturbance": cosim.Freeze()})
    sources = {"disturbance": cosim.Constant(0.0)}
    assert car(plant, noise=sources, input_faults={"disturbance": cosim.Freeze()}).build()
