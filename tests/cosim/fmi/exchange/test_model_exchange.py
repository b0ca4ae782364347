"""Model exchange FMUs as blocks: against closed forms, scipy and fmpy; events of all kinds; saved states; what goes wrong."""

import math
import pickle
import subprocess
import sys
import zipfile
from fractions import Fraction

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import design
from bayesftc.controllers.models.linearization import linearize
from bayesftc.cosim.errors import FMUError, FMUVersionError, ModelError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU

FMI = ("1.0", "2.0", "3.0")


def alone(path, dt, **options):
    diagram = cosim.Diagram(dt=dt)
    diagram.add(FMU(path, **options), "p")
    return diagram


# --- against closed forms, scipy and fmpy ---------------------------------------------------------------------------------------


def ball_height(times, g=9.81, e=0.7, vmin=0.1):
    """Return the height of a ball dropped from 1 m, from bounce to bounce."""
    start, v, h0, heights = 0.0, 0.0, 1.0, []
    for t in times:
        while True:
            if h0 is None:
                heights.append(0.0)
                break
            end = start + (v + math.sqrt(v * v + 2 * g * h0)) / g
            if t < end:
                s = t - start
                heights.append(h0 + v * s - g * s * s / 2)
                break
            v, h0, start = e * (g * (end - start) - v), 0.0, end
            h0 = None if v < vmin else h0
    return np.array(heights)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("solver", ["cvode", "rk45", "scipy:RK45"])
def test_a_bouncing_ball_to_its_rest(built, fmi, solver, run_both):
    result = run_both(alone(built("ball", fmi), "1/50", solver=solver, rtol=1e-9), 4)
    np.testing.assert_allclose(result["p.h"], ball_height(result.time), atol=3e-6)
    assert result["p.h"][-1] == 0.0


@pytest.mark.parametrize("fmi", FMI)
def test_a_switched_heater_with_an_input_and_feedthrough(built, fmi, run_both):
    diagram = cosim.Diagram(dt=0.25)
    heater = diagram.add(FMU(built("heater", fmi), rtol=1e-9), "p")
    outside = diagram.add(cosim.Step(time=10, before=10.0, after=5.0), "outside")
    diagram.connect(outside["y"], heater["Ta"])
    result = run_both(diagram, 40)
    T, on, temperatures, states = 15.0, 1.0, [15.0], [1.0]
    for k in range(160):
        Ta, left = (10.0 if k * 0.25 < 10 else 5.0), 0.25
        while True:
            limit, goal = Ta + 20.0 * on, 21.0 if on else 19.0
            ratio = (goal - limit) / (T - limit)
            time = -5.0 * math.log(ratio) if 0 < ratio < 1 else math.inf
            if time >= left:
                T = limit + (T - limit) * math.exp(-left / 5.0)
                break
            T, on, left = goal, 1.0 - on, left - time
        temperatures.append(T)
        states.append(on)
    assert 6 < np.abs(np.diff(states)).sum() < 40
    np.testing.assert_allclose(
        result["p.y"] - result["outside.y"], temperatures, atol=2e-5
    )  # the input of the same instant
    np.testing.assert_array_equal(result["p.on"], states)


def test_time_events_as_running_sums_on_and_off_the_grid(built, run_both):
    for dt in ("0.1", "0.03"):  # 0.1 + 0.1 + 0.1 is not 0.3: an event just after a communication point
        result = run_both(alone(built("pulse"), dt, parameters={"period": 0.1}, rtol=1e-9), 3)
        phase = np.mod(result.time + 1e-9, 0.2) - 1e-9
        np.testing.assert_allclose(result["p.x"], np.where(phase < 0.1, phase, 0.2 - phase), atol=1e-8)


@pytest.mark.parametrize("fmi", FMI)
def test_step_events_and_a_model_without_states(built, fmi, run_both):
    result = run_both(alone(built("counter", fmi), 0.25), 10)
    np.testing.assert_allclose(result["p.x"] + result["p.n"], result.time, atol=1e-9)
    assert result["p.n"][-1] in {9.0, 10.0}
    ticks = run_both(alone(built("clock", fmi), 0.5), 5)
    np.testing.assert_array_equal(ticks["p.n"], np.floor(ticks.time))


def test_discrete_inputs_change_in_event_mode_and_only_where_inputs_change(built, run_both):
    diagram = cosim.Diagram(dt=1)
    gate = diagram.add(FMU(built("gate"), timing="direct"), "p")
    diagram.connect(diagram.add(cosim.Step(time=3, after=2.0), "u")["y"], gate["u"])
    diagram.connect(diagram.add(cosim.Step(time=5, after=7.0), "d")["y"], gate["d"])
    result = run_both(diagram, 8)
    np.testing.assert_array_equal(result["p.y"], 2 * result["d.y"] + result["u.y"])
    np.testing.assert_array_equal(result["p.n"], 1.0 + (result.time >= 3) + (result.time >= 5))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("solver", "bound"), [("cvode", 1e-6), ("rk45", 1e-7), ("scipy:RK45", 1e-7), ("scipy:LSODA", 3e-5)]
)
def test_a_pendulum_of_casadi_against_scipy(pendulum, solver, bound, run_both):
    from scipy.integrate import solve_ivp

    def swing(t, x, u):
        return [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1] + u]

    diagram = cosim.Diagram(dt=0.05)
    plant = diagram.add(FMU(pendulum, solver=solver, rtol=1e-8), "p")
    push = diagram.add(cosim.Sine(amplitude=2.0, period=3.0), "u")
    diagram.connect(push["y"], plant["u"])
    result = run_both(diagram, 5)
    x, held, expected = np.array([0.5, 0.0]), result["u.y"], []
    for k, u in enumerate(held):
        expected.append(x[0] + 0.5 * u)
        if k < len(held) - 1:
            x = solve_ivp(swing, (0, 0.05), x, args=(u,), rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(result["p.y"], expected, atol=bound)


@pytest.mark.parametrize("model", ["ball", "heater", "pulse"])
@pytest.mark.parametrize("fmi", FMI)
def test_the_same_as_fmpy(built, model, fmi):
    import fmpy

    name = {"ball": "h", "heater": "y", "pulse": "x"}[model]
    dt, end = {"ball": ("0.01", 1.5), "heater": ("0.25", 20), "pulse": ("1/32", 2)}[model]
    start = {"ball": {}, "heater": {"Ta": 10.0}, "pulse": {"period": 0.125}}[model]  # with 0.1, CVODE in fmpy gives up
    ours = alone(built(model, fmi), dt, rtol=1e-9, parameters=start).simulate(end, engine="interpreted")[f"p.{name}"]
    theirs = fmpy.simulate_fmu(
        str(built(model, fmi)), fmi_type="ModelExchange", stop_time=end, output_interval=float(Fraction(dt)),
        relative_tolerance=1e-9, output=[name], start_values=start, record_events=False,
    )[name]  # fmt: skip
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


# --- equations ------------------------------------------------------------------------------------------------------------------


def test_the_states_of_fmi_1_are_those_that_the_binary_names(built):
    with ModelEquations(built("pol", "1.0")) as model:
        assert model.state_names == ("x", "v")
        assert not model.has_directional_derivatives
        np.testing.assert_allclose(model.jacobians([0.5, 0.1], []).A, [[0, 1], [-101.0, 750.0]], rtol=1e-6)
    for silent in ("stack", "pulse"):
        with ModelEquations(built(silent, "1.0")) as model:
            assert model.state_names == ("x[0]",)
            assert model.derivatives([0.0], []).tolist() == [1.0]


def test_equations_and_jacobians(pendulum, built):
    x, u = np.array([0.3, 0.1]), np.array([2.0])
    A = [[0.0, 1.0], [-9.81 * math.cos(0.3), -0.1]]
    with ModelEquations(pendulum) as model:
        assert (model.state_names, model.input_names, model.output_names) == (("q", "w"), ("u",), ("y",))
        np.testing.assert_array_equal(model.x0, [0.5, 0.0])
        for equations in (model, pickle.loads(pickle.dumps(model))):
            np.testing.assert_allclose(equations.derivatives(x, u), [0.1, -9.81 * math.sin(0.3) - 0.01 + 2], rtol=1e-15)
            np.testing.assert_allclose(equations.outputs(x, u), [1.3])
        assert model.has_directional_derivatives
        for exact in (True, False):
            model.has_directional_derivatives = exact
            for found, known in zip(model.jacobians(x, u), (A, [[0.0], [1.0]], [[1.0, 0.0]], [[0.5]]), strict=True):
                np.testing.assert_allclose(found, known, atol=1e-14 if exact else 1e-9)
        with pytest.raises(ModelError, match="x has the shape \\(3,\\), but the FMU 'pendulum' needs 2 numbers: q, w"):
            model.derivatives([1, 2, 3], u)
    with pytest.raises(FMUError, match="are closed"):
        model.outputs(x, u)
    with ModelEquations(FMU(built("heater"), parameters={"P": 30.0})) as heater:
        assert heater.derivatives([15.0], [10.0]) == [5.0]
        assert heater.derivatives([25.0], [10.0]) == [3.0]  # no event has happened: it is on
        assert heater.settle([25.0], [10.0]) == [25.0]
        assert heater.derivatives([25.0], [10.0]) == [-3.0]
        np.testing.assert_allclose(heater.jacobians([25.0], [10.0]).A, [[-0.2]], rtol=1e-9)
    with ModelEquations(built("gate")) as gate:
        assert gate.outputs([], [1.0, 3.0])[1] == 7.0
    with (
        ModelEquations(built("fails")) as fails,
        pytest.raises(FMUError, match=r"fmi2GetDerivatives returned Error.*valve is stuck"),
    ):
        fails.derivatives([0.0], [], 0.5)


def lags(path):
    diagram = cosim.Diagram(dt=0.25)
    a, b = (diagram.add(FMU(path, name=name, parameters={"x": x})) for name, x in (("a", [1, 2, 3]), ("b", [0, 0, -1])))
    diagram.connect(a["y"], b["u"])
    diagram.connect(b["y"], a["u"])
    return diagram


def test_arrays_are_vector_ports(built, run_both):
    diagram = cosim.Diagram(dt=0.25)
    diagram.add(FMU(built("lag", "3.0"), rtol=1e-9, parameters={"x": [1, 2, 3], "u": [0, 2, 5]}), "p")
    result = run_both(diagram, 3)
    expected = [0, 2, 5] + np.exp(-result.time)[:, None] * [1, 0, -2]
    np.testing.assert_allclose(result["p.y"], expected, atol=1e-8)
    with ModelEquations(FMU(built("lag", "3.0"))) as model:
        assert model.state_names == ("x[0]", "x[1]", "x[2]")
        np.testing.assert_array_equal(model.derivatives([1, 2, 3], [0, 2, 5]), [-1, 0, 2])
        known = -np.eye(3), np.eye(3), np.eye(3), np.zeros((3, 3))
        np.testing.assert_allclose(model.jacobians([1, 2, 3], [0, 2, 5]), known, atol=1e-9)


def test_nominal_values_that_are_none_count_as_one(built):
    """They are 0, 1e-4 and NaN, as those of tools that say nothing; the plant must be brought to rest first."""
    with ModelEquations(FMU(built("lag", "3.0"))) as model:
        np.testing.assert_array_equal(model.nominals, [1.0, 1e-4, 1.0])
    lag = FMU(built("lag", "3.0"), parameters={"u": [0.5, -1.0, 2.0]})
    linear = linearize(lag, measured="y", actuated="u", dt=0.1)
    np.testing.assert_allclose(linear.x, [0.5, -1.0, 2.0], atol=1e-9)
    np.testing.assert_allclose(linear.A, math.exp(-0.1) * np.eye(3), rtol=1e-7, atol=1e-12)
    controller = design(lag, measured="y", actuated="u", dt=0.1)
    assert np.abs(controller.closed_loop_poles()).max() < math.exp(-0.1)


@pytest.mark.parametrize("fmi", FMI)
def test_a_binary_of_another_name_is_used_if_it_is_the_only_one(built, fmi, tmp_path, caplog):
    paths = {count: tmp_path / f"renamed{count}.fmu" for count in (1, 2)}
    for count, path in paths.items():
        with zipfile.ZipFile(built("ball", fmi)) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                stem, _, suffix = name.rpartition("/models.")
                for i in range(count) if stem else ():
                    new.writestr(f"{stem}/other{i}.{suffix}", old.read(name))
                if not stem:
                    new.writestr(name, old.read(name))
    expected = alone(built("ball", fmi), "1/50").simulate(0.2)["p.h"]
    np.testing.assert_array_equal(alone(paths[1], "1/50").simulate(0.2)["p.h"], expected)
    assert "is the only one, and is used" in caplog.text
    with pytest.raises(
        FMUError, match=r"no binary models\..* for this platform, .* \(but other0\..* and other1\..* there\)"
    ):
        alone(paths[2], "1/50").simulate(0.2)


def test_coupled_with_iteration_and_with_steps_of_any_size(built, run_both):
    # (x + z)' = 0 and (x - z)' = -2 (x - z)
    sums, differences = np.array([1, 2, 2]), np.array([1, 2, 4])
    for settings, bound in (({"coupling": "jacobi"}, 0.4), ({"coupling": "iterated", "hold": "mean"}, 0.02),
                            ({"coupling": "iterated", "hold": "mean", "step_error": 1e-6}, 1e-4)):  # fmt: skip
        result = run_both(lags(built("lag", "3.0")).build(**settings), 3)
        exact = (sums + differences * np.exp(-2 * result.time)[:, None]) / 2
        assert np.abs(result["a.y"] - exact).max() < bound, settings


# --- saved states ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["ball", "heater", "pulse", "counter", "clock", "gate", "pendulum"])
@pytest.mark.parametrize("solver", ["cvode", "rk45", "scipy:RK45"])
def test_a_run_that_was_saved_and_restored_has_the_same_bits(model, solver, built, pendulum, same_bits):
    block = FMU(pendulum if model == "pendulum" else built(model, "3.0"), solver=solver)
    u = np.array([p.default for p in block.inputs])

    def steps(instance, begin, end):
        rows = []
        for k in range(begin, end):
            y = np.zeros(len(block.outputs))
            assert instance.output(u + 0.1 * k, y, k / 10) == 0
            assert instance.update(u + 0.1 * k, y, k / 10) == 0
            rows.append(y)
        return rows

    one, other = (block.instantiate(Fraction(1, 10), name) for name in ("one", "other"))
    whole = steps(one, 0, 20)
    same_bits(steps(other, 0, 9), whole[:9])
    assert other.can_save
    saved = other.save()
    for _ in range(2):
        same_bits(steps(other, 9, 20), whole[9:])
        other.restore(saved)
    copy = pickle.loads(pickle.dumps(saved))
    one.restore(copy)  # of another instance, by bytes
    same_bits(steps(one, 9, 20), whole[9:])
    with pytest.raises(FMUError, match="no saved state of the FMU"):
        one.restore("rubbish")
    other.forget(saved)
    for instance in (one, other):
        instance.close()


@pytest.mark.parametrize("solver", ["rk45", "scipy:RK45"])
def test_states_by_name_can_be_set(built, solver):
    instance = FMU(built("heater"), solver=solver, outputs=["on"]).instantiate(Fraction(1, 10), "heater")
    assert instance.states == {"T": 15.0}
    instance.set_states({"T": 25.0})
    on, Ta = np.ones(1), np.array([10.0])
    instance.output(Ta, on, 0.0)
    assert on == 0.0  # the event that belongs to the new temperature has happened
    instance.update(Ta, on, 0.0)
    np.testing.assert_allclose(instance.states["T"], 10 + 15 * math.exp(-0.02), rtol=1e-9)
    with pytest.raises(cosim.errors.UnknownNameError, match="'heater' has no continuous state 't'"):
        instance.set_states({"t": 1.0})
    instance.close()


def test_an_fmu_with_discrete_states_that_cannot_save(built):
    instance = FMU(built("ball", save="false")).instantiate(Fraction(1, 10), "ball")
    assert not instance.can_save
    with pytest.raises(FMUError, match="cannot save its state"):
        instance.save()
    instance.close()


# --- what goes wrong ------------------------------------------------------------------------------------------------------------


@pytest.mark.sampled(20)
@pytest.mark.parametrize("solver", ["cvode", "rk45", "scipy:RK45"])
@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize(
    ("model", "sentence", "kept"),
    [
        ("endless", r"Its event iteration does not end: after 1000 passes at t = 0\.5 s", 5),
        ("nan", r"(The derivative 'der\(x\)'|A derivative) came out NaN or infinite at t = 0\.3", 4),
        ("fails", r"(Derivatives|StateDerivatives) returned Error.* Its log: the valve is stuck", 4),
        ("past", r"Its events do not end at t = 0\.2 s: the time of the next event .* t = 0\.2 s\. ", 2),
        ("relay", r"Its events do not end at t = 0\.25.* s: 100 occurred one after the other.*hysteresis", 3),
    ],
)
def test_runs_that_cannot_go_on_say_why_and_keep_what_was(model, sentence, kept, solver, fmi, built):
    engine = "interpreted" if solver.startswith("scipy") else "compiled"
    diagram = alone(built(model, fmi), 0.1, solver=solver)
    with pytest.raises(cosim.SimulationError, match=r"(?s)The run stopped at t = 0\.\d s.*" + sentence) as caught:
        diagram.simulate(1, engine=engine)
    assert len(caught.value.result.time) == kept


@pytest.mark.parametrize("solver", ["cvode", "rk45", "scipy:RK45"])
@pytest.mark.parametrize("fmi", FMI)
def test_a_status_that_fmi_does_not_know_is_called_so(solver, fmi, built):
    for status in (77.0, -3.0):
        diagram = alone(built("fails", fmi), 0.1, solver=solver, parameters={"status": status})
        said = rf"(Derivatives|StateDerivatives) returned {status:.0f}, which is no status of FMI"
        with pytest.raises(cosim.SimulationError, match=said):
            diagram.simulate(1, engine="interpreted")


def test_a_solver_that_gives_up_says_so(built, monkeypatch):
    from bayesftc.cosim.fmi.exchange.integrators import (
        cvode as _model_exchange_cvode,
        instance as _model_exchange_instance,
        scipy_methods as _model_exchange_scipy,
    )

    for module in (_model_exchange_cvode, _model_exchange_instance, _model_exchange_scipy):
        monkeypatch.setattr(module, "INTERNAL_STEPS", 3)
    for solver, called in (("cvode", "CVODE"), ("rk45", "Runge-Kutta"), ("scipy:RK23", "RK23 of scipy")):
        with pytest.raises(
            cosim.SimulationError, match=rf"{called} gives up at t = .*more than .* internal steps; give larger"
        ):
            alone(built("heater"), 5, solver=solver, rtol=1e-10).simulate(5, engine="interpreted")


def test_ctrl_c_and_errors_of_python_come_through_compiled_code(pendulum, monkeypatch):
    from bayesftc.cosim.fmi.exchange.integrators.scipy_methods import ScipySolver

    for error in (KeyboardInterrupt, ZeroDivisionError):
        monkeypatch.setattr(ScipySolver, "_derivatives", lambda *_, error=error: (_ for _ in ()).throw(error))
        with pytest.raises(error):
            alone(pendulum, 0.1, solver="scipy:RK45").simulate(1, engine="compiled")


LIVES = """
import sys
import zipfile
from fractions import Fraction
import numpy as np
from bayesftc.bench.measures.memory import resident
from bayesftc.cosim.fmi.fmu import FMU

block, y, u = FMU(sys.argv[1]), np.zeros(2), np.array([10.0])

def use(times):
    for _ in range(times):
        instance = block.instantiate(Fraction(1, 10), "p")
        assert instance.update(u, y, 0.0) == instance.output(u, y, 0.1) == 0
        instance.close()

use(300)
before = resident()
use(1500)
print(resident() - before)
"""


@pytest.mark.slow
def test_thousands_of_instances_leave_nothing(built):
    """In a process of its own, where no other test's memory comes and goes."""
    done = subprocess.run(
        [sys.executable, "-c", LIVES, str(built("heater"))], capture_output=True, text=True, check=True, timeout=300
    )
    assert int(done.stdout) < 500_000


def test_without_cvode_it_says_so_and_another_solver_works(built, monkeypatch):
    from bayesftc.cosim.fmi.exchange.integrators import cvode as _model_exchange_cvode

    _model_exchange_cvode._sundials.cache_clear()
    monkeypatch.setitem(sys.modules, "fmpy.sundials", None)
    with pytest.raises(FMUError, match=r"CVODE cannot be loaded.*SUNDIALS 7.*'rk45'"):
        alone(built("ball"), 0.1).simulate(1, engine="interpreted")
    alone(built("ball"), 0.1, solver="rk45").simulate(1, engine="interpreted")
    monkeypatch.undo()
    _model_exchange_cvode._sundials.cache_clear()


def test_settings(built):
    path = built("pulse")
    block = FMU(path)
    assert (block.kind, block.solver, block.rtol, block.atol, block.timing) == (
        "model exchange",
        "cvode",
        1e-6,
        None,
        "plant",
    )
    assert FMU(built("heater")).timing == "direct"
    assert [p.feedthrough for p in FMU(built("heater"), outputs=["on"]).inputs] == [False]
    assert [p.feedthrough for p in FMU(built("heater"), timing="plant").inputs] == [False]
    assert pickle.loads(pickle.dumps(block)) == block
    for settings, sentence in (
        ({"solver": "euler"}, "must be one of cvode, rk45, scipy:RK23"),
        ({"rtol": 0.0}, "a positive number"),
        ({"rtol": 2.0}, "must be below 1"),
        ({"atol": math.nan}, "a positive number"),
    ):
        with pytest.raises(ModelError, match=sentence):
            FMU(path, **settings)
    with pytest.raises(FMUVersionError, match="cannot be used for co-simulation"):
        FMU(path, kind="co-simulation")


def test_direct_feedthrough_in_a_loop_is_an_algebraic_loop(built):
    def loop(**options):
        diagram = cosim.Diagram(dt=1)
        plant, gain = diagram.add(FMU(built("heater"), **options), "p"), diagram.add(cosim.Gain(-0.5), "k")
        diagram.connect(plant["y"], gain["u"])
        diagram.connect(gain["y"], plant["Ta"])
        return diagram

    with pytest.raises(
        cosim.AlgebraicLoopError, match=r"(?s)p feeds it through.*'p' with timing='plant' has outputs for the inputs of"
    ):
        loop().build()
    assert len(loop(timing="plant").simulate(3, engine="interpreted").time) == 4


# --- in python-control --------------------------------------------------------------------------------------------------------


def test_in_python_control_it_is_a_system_in_continuous_time(pendulum):
    import control

    system = FMU(pendulum).to_control(name="pendulum")
    twin = control.nlsys(
        lambda t, x, u, p: [x[1], -9.81 * np.sin(x[0]) - 0.1 * x[1] + u[0]], lambda t, x, u, p: [x[0] + 0.5 * u[0]],
        inputs=["u"], outputs=["y"], states=2, name="twin",
    )  # fmt: skip
    assert (system.dt, system.state_labels, system.input_labels, system.output_labels) == (0, ["q", "w"], ["u"], ["y"])
    assert cosim.initial_state(system).tolist() == [0.5, 0.0]
    times = np.linspace(0.0, 4.0, 81)
    filtered = control.ss([[-2.0]], [[2.0]], [[-3.0]], [[0.0]], inputs=["y"], outputs=["u"], name="filter")
    runs = []
    for plant in (system, twin):
        loop = control.interconnect([plant, filtered], inputs=[], outputs=["y"])
        settings = {"rtol": 1e-10, "atol": 1e-12}
        runs.append(control.input_output_response(loop, times, X0=[0.5, 0.0, 0.0], solve_ivp_kwargs=settings).outputs)
    np.testing.assert_allclose(*runs, rtol=1e-9, atol=1e-9)
    point = control.find_operating_point(system, [0.1, 0.0], [0.0], y0=[1.0])
    q = point.states[0]
    assert [q + 0.5 * point.inputs[0], point.inputs[0]] == pytest.approx([1.0, 9.81 * math.sin(q)], rel=1e-9)
    linear = control.linearize(system, point.states, point.inputs)
    np.testing.assert_allclose(linear.A, [[0.0, 1.0], [-9.81 * math.cos(q), -0.1]], atol=1e-5)
    assert (linear.B.tolist(), linear.D.tolist()) == ([[0.0], [pytest.approx(1.0)]], [[pytest.approx(0.5)]])


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_with_a_sample_time_events_happen_in_python_control_too(built, pendulum, engine):
    import control

    for path, name in ((built("heater"), "heater"), (built("ball", "3.0"), "ball"), (pendulum, "pendulum")):
        diagram = alone(path, 0.05)
        run = diagram.simulate(10.0, engine="interpreted")
        system = FMU(path).to_control(0.05, inputs=[], engine=engine, name=name)
        response = control.input_output_response(system, run.time, 0.0, squeeze=False)
        for row, port in zip(response.outputs, diagram["p"].block.outputs, strict=True):
            np.testing.assert_array_equal(row, run[f"p.{port.name}"])
        with pytest.raises(ModelError, match=r"LinearModel\.from_fmu"):
            control.linearize(system, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "solver"), [("heater", "cvode"), ("ball", "scipy:RK45"), ("ball", "rk45")])
@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_the_same_bits_in_a_process_of_its_own(model, solver, engine, built, same_bits):
    runs = []
    for isolate in (False, True):
        diagram = cosim.Diagram(dt=0.25)
        node = diagram.add(FMU(built(model, "3.0"), solver=solver, rtol=1e-9, isolate=isolate), "p")
        if model == "heater":
            diagram.connect(diagram.add(cosim.Step(time=10, before=10.0, after=5.0), "outside")["y"], node["Ta"])
        runs.append(diagram.simulate(10, engine=engine))
    for name in runs[0]:
        same_bits(runs[1][name], runs[0][name], name)
