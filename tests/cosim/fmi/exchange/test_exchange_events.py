"""Events and lies of model exchange FMUs: what each solver sees, against closed forms, scipy and fmpy, and how runs end."""

import logging
import math
from contextlib import suppress

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import FMUError, SimulationError
from bayesftc.cosim.fmi.fmu import FMU

FMI = ("1.0", "2.0", "3.0")
SOLVERS = ("cvode", "rk45", "scipy:RK45")
COMPILED = ("cvode", "rk45")


def alone(path, dt, **options):
    diagram = cosim.Diagram(dt=dt)
    diagram.add(FMU(path, **options), "p")
    return diagram


# --- event indicators ---------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("solver", SOLVERS)
def test_an_indicator_that_is_zero_at_the_start_or_at_a_communication_point(built, fmi, solver, run_both):
    # To FMI zero is not positive: where it rises from there is an event.
    for x, slope in ((0.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (0.0, -1.0), (-0.75, 2.0)):
        result = run_both(alone(built("edge", fmi), 0.25, solver=solver, parameters={"x": x, "u": slope}), 2)
        exact = x + slope * result.time
        np.testing.assert_allclose(result["p.x"], exact, atol=1e-12)
        sure = np.abs(exact) > 1e-9
        np.testing.assert_array_equal(result["p.n"][sure], exact[sure] > 0)


def stick_slip(times, belt=0.2, static=0.6, kinetic=0.4):
    """Return place and speed of the mass on a belt, from arc to arc, by scipy."""
    from scipy.integrate import solve_ivp

    def caught(t, x):
        return belt - x[1]

    caught.terminal, caught.direction = True, -1
    t, state, sticks, rows = 0.0, [0.0, 0.0], False, []
    for at in times:
        while t < at:
            if sticks:
                leaves = t + (static - state[0]) / belt
                end = min(at, leaves)
                t, state, sticks = end, [state[0] + belt * (end - t), belt], leaves > at
                continue
            arc = solve_ivp(
                lambda _, x: [x[1], kinetic - x[0]],
                (t, at),
                state,
                events=caught,
                rtol=1e-12,
                atol=1e-13,
                method="DOP853",
            )
            t, state = arc.t[-1], arc.y[:, -1].tolist()
            sticks = arc.status == 1
        rows.append(state)
    return np.array(rows)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("solver", SOLVERS)
def test_stick_and_slip(built, solver, run_both):
    result = run_both(alone(built("slide"), 0.125, solver=solver, rtol=1e-10), 20)
    expected = stick_slip(result.time)
    assert (expected[:, 1] == 0.2).sum() > 20  # it sticks for some of the time
    np.testing.assert_allclose(np.stack([result["p.x"], result["p.v"]], axis=1), expected, atol=1e-7)


def test_stick_and_slip_as_fmpy_has_it(built):
    import fmpy

    ours = alone(built("slide", "3.0"), 0.125, rtol=1e-9).simulate(20, engine="interpreted")["p.x"]
    theirs = fmpy.simulate_fmu(
        str(built("slide", "3.0")), fmi_type="ModelExchange", stop_time=20, output_interval=0.125, relative_tolerance=1e-9,
        output=["x"], record_events=False,
    )["x"]  # fmt: skip
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize("solver", COMPILED)
@pytest.mark.parametrize("how", [0, 1, 2])
def test_where_the_equations_do_not_hold_a_smaller_step_does(built, solver, how, run_both):
    for fmi in FMI:
        result = run_both(alone(built("wild", fmi), 2, solver=solver, parameters={"how": how}), 4)
        np.testing.assert_allclose(result["p.x"], [1.0, 0.1, 0.1], atol=1e-12)


def test_scipy_says_where_the_equations_do_not_hold(built):
    for how, sentence in ((0, "EventIndicators returned Discard"), (1, "Derivatives returned Discard"),
                          (2, "event indicator came out NaN")):  # fmt: skip
        with pytest.raises(SimulationError, match=sentence):
            alone(built("wild"), 2, solver="scipy:RK45", parameters={"how": how}).simulate(4, engine="interpreted")


@pytest.mark.sampled(1)
@pytest.mark.parametrize("solver", COMPILED)
def test_a_switch_that_is_too_fine_ends_in_a_sentence(built, solver):
    diagram = alone(built("fine"), 1, solver=solver)
    with pytest.raises(
        SimulationError, match=r"More than 100,000 events occurred within one step, .* t = 0\.0\d+ s: give"
    ):
        diagram.simulate(1, engine="compiled")


@pytest.mark.parametrize("solver", SOLVERS)
def test_indicators_of_time_alone_without_states(built, solver, run_both):
    result = run_both(alone(built("alarm", "3.0"), 0.5, solver=solver), 20)
    zeros = np.floor(result.time[1:] / np.pi)
    np.testing.assert_array_equal(result["p.n"][1:], 1 + zeros)
    np.testing.assert_allclose(result["p.when"][1:], np.pi * zeros, atol=1e-12)


# --- time events --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS)
def test_several_time_events_at_one_instant(built, solver, run_both):
    for dt, at in ((0.25, 0.5), (0.2, 0.5), (0.25, 0.0), (0.25, 1e-14)):
        result = run_both(alone(built("stack"), dt, solver=solver, parameters={"at": at}), 1)
        np.testing.assert_array_equal(result["p.n"][1:], 3.0 * (result.time[1:] >= at))
        np.testing.assert_allclose(result["p.x"], result.time, atol=1e-12)


# --- tolerances ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", COMPILED)
def test_nominal_values_that_change_at_an_event_change_the_tolerances(built, solver):
    errors = []
    for quiet in (0, 1):
        diagram = alone(built("scale"), 2.5, solver=solver, rtol=1e-4, parameters={"quiet": quiet})
        x = diagram.simulate(2.5, engine="interpreted")["p.x"]
        errors.append(abs(x[-1] / (1e-6 * math.exp(-2)) - 1))
    assert errors[0] < 1e-3 < errors[1], errors


@pytest.mark.slow
def test_a_stiff_oscillator_against_scipy(built, run_both):
    from scipy.integrate import solve_ivp

    def slope(t, x):
        return [x[1], 1000 * (1 - x[0] ** 2) * x[1] - x[0]]

    result = run_both(alone(built("pol"), 50, rtol=1e-8), 1000)
    expected = solve_ivp(slope, (0, 1000), [2, 0], t_eval=result.time, method="Radau", rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(result["p.x"], expected.y[0], atol=2e-4)


# --- ends and lies ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("fmi", FMI)
def test_an_fmu_may_end_the_simulation_after_a_step_or_at_once(built, fmi, solver):
    engine = "interpreted" if solver.startswith("scipy") else "compiled"
    ends = {"ends": r"\(terminateSimulation\)\. Its log: the tank is empty"}
    if fmi != "1.0":  # there a step of the integrator cannot end a simulation
        ends["quits"] = r"t = 0\.3 s .*terminateSimulation, after a step of the integrator"
    for model, words in ends.items():
        with pytest.warns(UserWarning, match="The run has ended .*" + words):
            result = alone(built(model, fmi), 0.1, solver=solver).simulate(1, engine=engine)
        assert len(result.time) == 4
    with pytest.raises(FMUError, match=r"could not be initialized as 'p': The FMU asks to end the simulation"):
        alone(built("quits", fmi), 0.1, solver=solver, parameters={"now": 1}).simulate(1, engine=engine)


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize(
    ("what", "missing"),
    [
        (1, "'x'"),
        (2, "the derivatives of the states"),
        (3, "the continuous states"),
        (4, "the event indicators"),
        (9, "'n'"),
    ],
)
def test_what_is_not_written_is_no_zero(built, fmi, what, missing):
    with pytest.raises(FMUError, match=rf"returns OK, but has not written {missing}.* of 'p': its binary"):
        alone(built("blank", fmi), 0.1, parameters={"what": what}).simulate(1, engine="interpreted")


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize(
    ("what", "which"),
    [(11, "'x'"), (12, "the derivatives of the states"), (13, "the continuous states"), (14, "the event indicators")],
)
def test_what_is_written_beyond_the_memory_for_it(built, fmi, what, which):
    with pytest.raises(FMUError, match=rf"'blank' writes beyond the memory for {which} of 'p'"):
        alone(built("blank", fmi), 0.1, parameters={"what": what}).simulate(1, engine="interpreted")


def test_a_binary_with_another_number_of_states(built):
    with pytest.raises(FMUError, match="Its binary has 2 continuous states, but its model description has 1"):
        alone(built("count", "3.0"), 0.1).simulate(1, engine="interpreted")


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("what", "error", "sentence"),
    [
        (5, FMUError, "state 'x' came out NaN or infinite at t = 0 s"),
        (6, FMUError, "t = NaN as the time of its next event"),
        (7, SimulationError, "is repeatedly not later"),
        (8, SimulationError, r"state 'x' came out NaN or infinite at t = 0\.5 s"),
    ],
)
def test_states_and_event_times_that_are_no_numbers(built, what, error, sentence, solver):
    for fmi in FMI:
        with pytest.raises(error, match=sentence):
            alone(built("blank", fmi), 0.1, solver=solver, parameters={"what": what}).simulate(1, engine="interpreted")


@pytest.mark.parametrize("solver", ["rk45", "scipy:RK45"])
@pytest.mark.parametrize(("model", "is_told"), [("ends", True), ("endless", True), ("fails", False), ("pulse", True)])
def test_an_fmu_is_told_that_the_run_is_over_unless_it_has_failed(built, model, is_told, solver, caplog):
    caplog.set_level(logging.DEBUG, "bayesftc.fmu")
    for fmi in FMI:
        caplog.clear()
        with suppress(SimulationError):
            alone(built(model, fmi), 0.1, solver=solver).simulate(1, engine="interpreted")
        assert ("terminated" in caplog.text) == is_told
