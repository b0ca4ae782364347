"""Algebraic loops: solved at each step where the coupling is iterated, and refused with the remedy where it is not."""

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.diagram.coupling import Coupling
from bayesftc.fmus._compiler import why_no_compiler
from bayesftc.fmus.build import build_fmu
from bayesftc.fmus.spec import Model, Variable

ENGINES = ("compiled", "interpreted")


def feedback(gain, **settings):
    """Return a loop y = gain * (r - y), which each step has to solve."""
    diagram = cosim.Diagram(0.1)
    source = diagram.add(cosim.Sine(amplitude=2.0, period=1.3, offset=1.0), "r")
    difference = diagram.add(cosim.Sum("+-"), "e")
    amplifier = diagram.add(cosim.Gain(gain), "y")
    diagram.connect([source["y"], amplifier["y"]], difference["u"])
    diagram.connect(difference["y"], amplifier["u"])
    return diagram.build("iterated", **settings)


@pytest.mark.parametrize("acceleration", ["anderson", "aitken"])
@pytest.mark.parametrize("gain", [0.5, -3.0, 50.0])
def test_a_loop_is_solved_at_each_step(gain, acceleration, run_both):
    run = run_both(feedback(gain, acceleration=acceleration), 2)
    np.testing.assert_allclose(run["y.y"], gain / (1 + gain) * run["r.y"], rtol=1e-7)


def test_a_loop_that_does_not_converge_says_by_how_much():
    for engine in ENGINES:
        with pytest.raises(cosim.SimulationError) as caught:
            feedback(50.0, acceleration=None, iterations=7).simulate(1, engine=engine)
        text = str(caught.value)
        assert text.startswith(
            "The run stopped at t = 0 s (step 0): the coupling of 'e' and 'y' did not converge in 7 iterations: "
        )
        assert "still changes by " in text
        assert "the tolerance is 1e-08. Use more iterations, or another acceleration, or a UnitDelay between" in text
        assert len(caught.value.result.time) == 0


def test_loops_are_refused_with_the_remedy_where_they_are_not_iterated():
    diagram = cosim.Diagram(0.1)
    one, two = diagram.add(cosim.Gain(0.5), "one"), diagram.add(cosim.Gain(0.5), "two")
    diagram.connect(one["y"], two["u"])
    diagram.connect(two["y"], one["u"])
    for way in (None, "jacobi", Coupling("gauss-seidel", step_error=1e-3)):
        with pytest.raises(
            cosim.AlgebraicLoopError, match=r"solve the loop at each step with build\(coupling='iterated'\)\.$"
        ):
            diagram.build(way)
    assert diagram.build("iterated").schedule.describe() == "at t_k     one and two  (guessing two.y)"


def test_a_block_with_a_memory_in_a_loop_makes_one_step(make_block, run_both):
    """What the output function writes into the state is put back before each sweep."""

    def lag(u, n, x, y):
        n[0] = n[0] + 1.0
        x[0] = 0.5 * x[0] + 0.5 * u[0]
        y[0] = -0.8 * x[0]

    block = make_block(inputs=(Port("u"),), outputs=(Port("y"),), output=lag, state={"n": 0.0, "x": 1.0})

    def count(n, y):
        y[0] = n[0]

    diagram = cosim.Diagram(1)
    node, back = diagram.add(block, "lag"), diagram.add(cosim.Gain(1.0), "back")
    diagram.connect(node["y"], back["u"])
    diagram.connect(back["y"], node["u"])
    run = run_both(diagram.build("iterated", tolerance=1e-14), 5)
    x, wanted = 1.0, []
    for _ in range(6):  # x = .5 x_before + .5 u with u = -.8 x
        x = 0.5 * x / 1.4
        wanted.append(-0.8 * x)
    np.testing.assert_allclose(run["lag.y"], wanted, rtol=1e-10)


SAMPLED = """
#include "model.h"

void model_initialize(double *x)
{
    x[X_HIDDEN] = 0.0;
    x[X_y] = 0.0;
}

int model_step(double *x, double h)
{
    if (x[X_u] > 1e6) {
        return 42;
    }
    x[X_HIDDEN] += h * x[X_u];
    x[X_y] = x[X_p] * x[X_u] + x[X_i] * x[X_HIDDEN];
    return 0;
}
"""


@pytest.fixture(scope="module")
def controller(tmp_path_factory):
    """Return an FMU of a sampled controller: u goes through to y, and is summed."""
    if reason := why_no_compiler():
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("controller")
    source = folder / "controller.c"
    source.write_text(SAMPLED)
    model = Model(
        name="Controller",
        description="A controller with feedthrough and an integral",
        source=source,
        variables=(
            Variable("u", "input", "Input", variability="discrete"),
            Variable("y", "output", "Output", variability="discrete", dependencies=("u", "p", "i")),
            Variable("p", "parameter", "Gain", start=2.0),
            Variable("i", "parameter", "Gain of the integral", start=1.0),
        ),
        step=0.1,
        hidden=1,
        timing="sampled",
    )
    return {fmi: build_fmu(model, folder, fmi=fmi) for fmi in ("2.0", "3.0")}


def sampled_loop(path, p=2.0, r=1.0):
    diagram = cosim.Diagram(0.1)
    source, error = diagram.add(cosim.Constant(r), "r"), diagram.add(cosim.Sum("+-"), "e")
    fmu = diagram.add(cosim.FMU(path, parameters={"p": p}), "c")
    diagram.connect([source["y"], fmu["y"]], error["u"])
    diagram.connect(error["y"], fmu["u"])
    return diagram


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_sampled_fmu_in_a_loop_is_put_back_before_each_sweep(fmi, controller, run_both):
    run = run_both(sampled_loop(controller[fmi]).build("iterated", tolerance=1e-13), 2)
    integral, wanted = 0.0, []
    for _ in range(21):  # y = 2 u + s + .1 u with u = 1 - y
        y = (2.1 + integral) / 3.1
        integral += 0.1 * (1 - y)
        wanted.append(y)
    np.testing.assert_allclose(run["c.y"], wanted, rtol=1e-10)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_fmu_that_fails_while_it_is_iterated_is_named(engine, controller):
    diagram = sampled_loop(controller["2.0"], r=2e6)
    with pytest.raises(
        cosim.SimulationError,
        match=r"at t = 0 s \(step 0\): block 'c' failed\. fmi2DoStep returned Error\.",
    ):
        diagram.build("iterated").simulate(1, engine=engine)
