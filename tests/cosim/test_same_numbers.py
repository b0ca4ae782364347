"""One diagram, one set of numbers: compiled, interpreted, isolated, iterated, of either FMI, and in python-control's own loop.

A car follows a sine under a controller that learns how precise its two sensors are; one of them freezes meanwhile. Engines,
processes and couplings that make no difference must agree to the last bit, and python-control, which adds up in an order of its
own, to 1e-12.
"""

import os

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus

DT, DRAG, MASS, START = 0.02, 5.0, 100.0, 20.0
A, B = 1.0 - DRAG / MASS * DT, DT / MASS
STEPS, SEED = 150, 3
MODEL = controllers.LinearModel([[A]], [[B]], [[1.0], [1.0]], process_covariance=1e-3, sensor_covariance=1.0, dt=DT)
FREEZE = cosim.Freeze(sensor=0, start=0.5, stop=2.0, channels=2)
PUSH = cosim.Gaussian(std=1e-3**0.5)
GOAL = cosim.Sine(amplitude=5.0, period=8.0, offset=20.0)
SENSORS = cosim.Sensors(count=2, std=1.0)
SIGNALS = ("plant.v", "controller.u", "controller.x_hat", "controller.precision", "controller.beta", "freeze.y")


def brain():
    return controllers.BayesianController(
        MODEL, precision=controllers.GammaPrecision(forgetting=0.9), initial_mean=START
    )


def car(fmi="2.0", **options):
    return cosim.FMU(fmus.path("CruiseControl", fmi=fmi), parameters={"v0": START}, **options)


def matrices():
    return control.ss([[A]], [[B, 1.0]], [[1.0]], 0, DT, name="plant", inputs=["force", "disturbance"], outputs=["v"])


def loop(plant, coupling="gauss-seidel"):
    """Return the loop, in which the speed also comes back to the force with a gain of zero: iterated, or held at t_k."""
    diagram = cosim.Diagram(DT)
    node = diagram.add(plant, "plant")
    sensors, freeze = diagram.add(SENSORS, "sensors"), diagram.add(FREEZE, "freeze")
    controller, goal, push = diagram.add(brain(), "controller"), diagram.add(GOAL, "goal"), diagram.add(PUSH, "push")
    nothing, force = diagram.add(cosim.Gain(0.0), "nothing"), diagram.add(cosim.Sum("++"), "force")
    for source, target in (
        (node["v"], sensors["u"]),
        (sensors["y"], freeze["u"]),
        (freeze["y"], controller["y"]),
        (goal["y"], controller["goal"]),
        (node["v"], nothing["u"]),
        ([controller["u"], nothing["y"]], force["u"]),
        (force["y"], node["force"]),
        (push["y"], node["disturbance"]),
    ):
        diagram.connect(source, target)
    return diagram.build(coupling)


@pytest.fixture(scope="module")
def reference():
    run = loop(car()).simulate(STEPS * DT, seed=SEED, engine="compiled")
    # What is compared is worth comparing: the sensor freezes, which the learner finds out, and the controller acts.
    assert np.ptp(run["freeze.y"][30:100, 0]) == 0.0
    assert run["controller.precision"][90, 0] < 0.5 * run["controller.precision"][90, 1]
    assert np.ptp(run["controller.u"]) > 1e3
    return run


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
@pytest.mark.parametrize("coupling", ["gauss-seidel", "jacobi", "iterated"])
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_engines_couplings_and_versions_of_fmi_agree_to_the_bit(fmi, coupling, engine, reference, same_bits):
    diagram = loop(car(fmi), coupling)
    assert ("guessing" in diagram.schedule.describe()) == (coupling == "iterated")
    run = diagram.simulate(STEPS * DT, seed=SEED, engine=engine)
    for name in reference:
        same_bits(run[name], reference[name], name)


@pytest.mark.sampled(1)
@pytest.mark.skipif(os.name != "posix", reason="isolation needs a POSIX system")
@pytest.mark.parametrize(("engine", "coupling"), [("compiled", "iterated"), ("interpreted", "gauss-seidel")])
def test_an_isolated_plant_agrees_to_the_bit(engine, coupling, reference, same_bits):
    run = loop(car(isolate=True), coupling).simulate(STEPS * DT, seed=SEED, engine=engine)
    for name in reference:
        same_bits(run[name], reference[name], name)


def test_the_matrices_of_the_plant_as_a_block_agree(reference):
    run = loop(cosim.StateSpace(matrices(), initial=[START])).simulate(STEPS * DT, seed=SEED, engine="interpreted")
    for name in SIGNALS:
        agree(run[name], reference[name], name)


def agree(found, wanted, name):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max(), err_msg=name)


PLANTS = {
    "python-control's own": matrices,
    "FMU": lambda: car().to_control(DT, engine="interpreted", name="plant"),
    "isolated FMU": lambda: car(isolate=True).to_control(DT, engine="interpreted", name="plant"),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_python_controls_own_loop_agrees(plant, reference):
    def system(block, name, inputs, outputs):
        return block.to_control(DT, inputs=inputs, outputs=outputs, seed=SEED, engine="interpreted", name=name)

    seen = {"u[0]": "force", "x_hat": "x_hat", "precision": "precision", "beta": "beta"}
    whole = control.interconnect(
        [
            plant(),
            system(SENSORS, "sensors", {"u": "v"}, {"y": "reading"}),
            system(FREEZE, "freeze", {"u": "reading"}, {"y": "samples"}),
            system(brain(), "controller", {"y": "samples", "goal": "goal"}, seen),
            system(GOAL, "goal", None, {"y": "goal[0]"}),
            system(PUSH, "push", None, {"y": "disturbance"}),
        ],
        inputs=[],
        outputs=[
            "v",
            "force",
            "x_hat[0]",
            "precision[0]",
            "precision[1]",
            "beta[0]",
            "beta[1]",
            "samples[0]",
            "samples[1]",
        ],
        check_unused=False,
    )
    start = cosim.initial_state(whole)
    if whole.state_labels[0] == "plant_x[0]":
        start[0] = START  # of its own system python-control knows no beginning
    times = np.arange(STEPS + 1) * DT
    got = control.input_output_response(whole, times, 0.0, X0=start).outputs
    wanted = np.hstack([reference[name].reshape(STEPS + 1, -1) for name in SIGNALS])
    assert got.shape == wanted.T.shape
    for row, column, label in zip(got, wanted.T, whole.output_labels, strict=True):
        agree(row, column, label)


def test_the_whole_diagram_as_one_system_of_python_control_agrees(reference):
    system = loop(car(), "iterated").to_control(outputs=list(SIGNALS), seed=SEED, engine="interpreted")
    got = control.input_output_response(system, np.arange(STEPS + 1) * DT, 0.0, X0=system.initial_state).outputs
    wanted = np.hstack([reference[name].reshape(STEPS + 1, -1) for name in SIGNALS])
    for row, column, label in zip(got, wanted.T, system.output_labels, strict=True):
        agree(row, column, label)
