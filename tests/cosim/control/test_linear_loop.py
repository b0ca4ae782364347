"""Control engineers' figures of a closed loop, against loops that NumPy, SciPy and python-control put together by hand."""

import control
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import bayesftc
from bayesftc import controllers, cosim, fmus
from bayesftc.controllers import FixedPrecision
from bayesftc.cosim.control.loop_figures import bode_figure, root_locus_figure
from bayesftc.cosim.control.margins import margins_of
from bayesftc.cosim.diagram.roles import find_roles
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.judging.figures.panels import bare_figure

DT = 0.1
A, B, H = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
C = np.vstack([H, H])
Q, R = np.diag([1e-4, 2e-4]), np.diag([0.04, 0.09])
MODEL = controllers.LinearModel(A, B, C, Q, R, dt=DT)


def plant(a=A, b=B, c=H):
    return cosim.StateSpace(control.ss(a, b, c, 0, DT, inputs=["force"], outputs=["position"]))


def loop_of(controller, block=None, **options):
    settings = {"control": "force", "measured": "position", "sensors": cosim.Sensors(2, (0.2, 0.3)), "reference": 1.0}
    return cosim.closed_loop(block or plant(), controller, **settings | options)


def lqg(**options):
    return controllers.LQGController(MODEL, **{"goal_covariance": 0.01, "control_covariance": 4.0} | options)


def by_hand():
    """Return the broken loop and the loop from goal to position, from the two Riccati equations."""
    P = solve_discrete_are(A.T, C.T, Q, R)
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    cost = solve_discrete_are(A, B, H.T @ H / 0.01, [[0.25]])
    L = np.linalg.solve(0.25 + B.T @ cost @ B, B.T @ cost @ A)
    steady = np.linalg.solve(np.block([[np.eye(2) - A, -B], [H, 0]]), [[0.0], [0.0], [1.0]])
    M = steady[2:] + L @ steady[:2]
    seen, move = np.eye(2) - K @ C, A - B @ L
    law = control.ss(move @ seen, np.hstack([move @ K, B @ M]), -L @ seen, np.hstack([-L @ K, M]), DT)
    moving = control.ss(A, B, C, 0, DT)
    broken = -law[:, :2] * moving
    both = np.block([[A - B @ L @ K @ C, -B @ L @ seen], [move @ K @ C, move @ seen]])
    closed = control.ss(both, np.vstack([B @ M, B @ M]), np.hstack([H, 0 * H]), 0, DT)
    return broken, closed


def test_an_lqg_loop_is_the_one_made_by_hand():
    loop, (broken, closed) = loop_of(lqg()), by_hand()
    for z in np.exp(1j * DT * np.logspace(-2, np.log10(0.99 * np.pi / DT), 30)):
        np.testing.assert_allclose(loop.linear().open()(z), broken(z), rtol=1e-8)
        np.testing.assert_allclose(loop.linear().closed[0, 0](z), closed(z), rtol=1e-8)
    poles, expected = loop.poles(), np.linalg.eigvals(closed.A)
    assert len(poles) == 4
    for pole in expected:
        assert np.abs(poles - pole).min() < 1e-8
    zeros = control.zeros(closed)
    for zero in loop.zeros():
        assert np.abs(zeros - zero).min() < 1e-6 * max(1.0, abs(zero))
    found, info = loop.step_info(), control.step_info(closed)
    assert found == pytest.approx(info, rel=1e-8, nan_ok=True)
    assert 0 < found["RiseTime"] < found["SettlingTime"]
    assert found["SteadyStateValue"] == pytest.approx(1.0)


def test_the_step_response_of_a_slow_loop_is_simulated_until_it_rests():
    """A hundred and more seconds at ten samples a second; python-control alone ends before it has settled."""
    loop = loop_of(lqg(control_covariance=1e-6))
    slowest = np.log(np.abs(loop.poles()).max()) / DT
    info = loop.step_info(SettlingTimeThreshold=0.001)
    assert slowest > -0.2
    assert info["SettlingTime"] == pytest.approx(np.log(0.001) / slowest, rel=0.25)
    with pytest.raises(ModelError, match="does not come near its final value within the simulated time"):
        loop.step_info(T=np.arange(20) * DT)


def test_margins_need_a_loop_that_is_stable():
    strong = control.ss(MODEL.matrix("A"), 40.0 * MODEL.matrix("B"), MODEL.matrix("C")[:1], 0.0, DT)
    loop = loop_of(lqg()).linear(plant=strong)
    assert np.abs(loop.poles()).max() > 1.0
    with pytest.raises(ModelError, match=r"not stable: its largest poles are .*has no margins"):
        loop.margins()
    assert "not stable" in loop.bode().axes[0].get_title()
    assert "dotted" not in loop.bode().axes[1].get_xlabel()


@pytest.mark.filterwarnings("ignore:stability_margins")
def test_margins_are_those_of_the_loop_made_by_hand():
    broken, _ = by_hand()
    found = loop_of(lqg()).margins()
    gain, phase, phase_crossover, gain_crossover = control.margin(control.ss2tf(broken))
    assert found.gain == pytest.approx(gain, rel=1e-5)
    assert found.phase == pytest.approx(phase, rel=1e-5)
    assert found.gain_crossover == pytest.approx(gain_crossover, rel=1e-5)
    assert found.phase_crossover == pytest.approx(phase_crossover, rel=1e-5)
    at = broken(np.exp(1j * found.gain_crossover * DT))
    assert abs(at) == pytest.approx(1.0, abs=1e-6)
    assert found.delay == pytest.approx(np.deg2rad(found.phase) / found.gain_crossover, rel=1e-4)  # of many samples
    grid = np.linspace(1e-3, np.pi / DT, 20_000)
    assert found.modulus == pytest.approx(np.abs(1 + broken(np.exp(1j * grid * DT))).min(), rel=1e-5)
    # At the gain margin the loop is on the edge of stability.
    assert np.abs(control.feedback(found.gain * broken, 1).poles()).max() == pytest.approx(1.0, abs=1e-6)


def test_a_gain_may_have_two_limits():
    """The pole 1.1 - 0.4 f of an unstable plant is inside the unit circle for f from 0.25 to 5.25."""
    unstable = control.ss([[1.1]], [[1.0]], [[0.4]], 0, DT)
    found = margins_of(unstable)
    assert (found.lowest_gain, found.highest_gain) == pytest.approx((0.25, 5.25))
    assert found.gain == pytest.approx(0.25)
    title = bode_figure(unstable, found, "a title", bare_figure()).axes[0].get_title()
    assert "gain margin 0.25 = -12 dB, the lower limit (at 0 rad/s)" in title
    assert title.endswith("\nstable while the gain is 0.25 to 5.25 times the designed one")
    stable = control.ss([[0.9]], [[1.0]], [[0.4]], 0, DT)  # 0.9 - 0.4 f
    found = margins_of(stable)
    assert (found.gain, found.lowest_gain, found.highest_gain) == pytest.approx((4.75, 0.0, 4.75))
    title = bode_figure(stable, found, "a title", bare_figure()).axes[0].get_title()
    assert title.endswith("\nstable while the gain is less than 4.75 times the designed one")
    quiet = control.ss([[0.9]], [[1.0]], [[0.0]], 0, DT)
    assert margins_of(quiet)[-2:] == (0.0, np.inf)


@pytest.mark.parametrize("precision", [FixedPrecision(), controllers.GammaPrecision()])
def test_a_run_from_rest_is_the_step_response(precision):
    """Without noise the belief is right at all times, however its covariance moves."""
    loop = loop_of(lqg(precision=precision), reference=cosim.Step(time=0.5, after=1.0), sensors=cosim.Sensors(2))
    run = loop.simulate(5.0, engine="interpreted")["plant.position"]
    expected = control.step_response(loop.linear().closed[0, 0], DT * np.arange(46)).outputs
    np.testing.assert_allclose(run[5:], expected, atol=1e-9)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("belief", ["filtered", "joint"])
def test_the_law_of_a_bayesian_controller_is_its_step_function_linearized(belief):
    def bayesian(**options):
        settings = {"goal_covariance": 0.001, "control_covariance": 50.0, "belief": belief}
        return controllers.BayesianController(
            MODEL, precision=FixedPrecision(), goal_on="outputs", **settings, **options
        )

    first = bayesian()
    P = first.initial_covariance
    online = first.online(compiled=False)
    for _ in range(300):
        P = online(y=[0.0, 0.0], goal=[0.0]).P
    if belief == "joint":  # P is what the sensors say; the goal takes its part of it afterwards
        system = first.to_control(inputs=["y", "goal"], outputs=["u"], seed=None, engine="interpreted")
        x = system.initial_state
        for k in range(300):
            x = system.dynamics(DT * k, x, np.zeros(3))
        start = np.reshape(
            [x[system.state_labels.index(f"covariance[{i},{j}]")] for i in (0, 1) for j in (0, 1)], (2, 2)
        )
    else:
        start = A @ P @ A.T + Q
    steady = bayesian(initial_covariance=(start + start.T) / 2)
    system = steady.to_control(inputs=["y", "goal"], outputs=["u"], seed=None, engine="interpreted")
    found = system.linearize(system.initial_state, 0.0)
    law = control.ss(*steady.linear_law(), DT)
    z = np.exp(1j * DT * np.logspace(-1, 1.4, 9))
    for point in z:
        np.testing.assert_allclose(found(point), law(point), atol=1e-6 * np.abs(law(point)).max())
    poles = loop_of(steady).poles()
    np.testing.assert_allclose(np.sort(np.abs(poles)), np.sort(np.abs(steady.closed_loop_poles())), atol=1e-9)


def test_with_several_controls_the_loop_is_broken_at_one_and_the_other_stays_closed():
    a, b = (
        np.array([[0.9, 0.2, 0.0], [0.0, 0.8, 0.1], [0.1, 0.0, 0.95]]),
        np.array([[0.0, 1.0], [0.5, 0.0], [0.2, 0.3]]),
    )
    c = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    model = controllers.LinearModel(a, b, c, 1e-3, 1e-2, dt=DT)
    block = cosim.StateSpace(control.ss(a, b, c, 0, DT, inputs=["valve", "heater"], outputs=["level", "heat"]))
    controller = controllers.LQGController(model, goal_covariance=0.01, control_covariance=1.0)
    loop = cosim.closed_loop(
        block, controller, control=["valve", "heater"], measured=["level", "heat"], reference=[1.0, 2.0]
    )
    poles = loop.poles()
    for name in ("valve", "heater"):
        again = control.feedback(loop.linear().open(name), 1).poles()
        for pole in poles:
            assert np.abs(again - pole).min() < 1e-6
    assert loop.margins("valve") != loop.margins("heater")
    title = "broken at the plant's input heater; the loop of valve stays closed"
    assert loop.bode("heater").get_suptitle() == f"Loop transfer function, {title}"
    assert loop.root_locus("heater").get_suptitle() == f"Root locus, {title}"
    assert loop.step_info("heat")["SteadyStateValue"] == pytest.approx(1.0)
    assert loop.step_info("heat", "level")["SteadyStateValue"] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ModelError, match=r"2 controls: valve, heater\. Name one of them: at='valve'"):
        loop.margins()
    with pytest.raises(UnknownNameError, match="no control 'valv'; did you mean"):
        loop.bode("valv")
    with pytest.raises(ModelError, match="2 tracked signals"):
        loop.step_info()


def active():
    law = controllers.ProportionalDerivative(gain=[[3.0]], derivative_gain=[[2.0]])
    return controllers.UnbiasedActiveInference(
        model=MODEL, law=law, state_prior="kalman", control="law", state_precision=10.0, belief_rate=0.5
    )


def nonlinear():
    return controllers.NonlinearBayesianController(
        MODEL, precision=FixedPrecision(), goal_on=H, goal_covariance=0.001, control_covariance=50.0, iterations=1
    )


@pytest.mark.sampled(1)
@pytest.mark.parametrize("make", [active, nonlinear])
def test_other_controllers_are_linearized_at_their_beginning(make):
    """The poles are among those of the whole loop, which python-control linearizes with all that the controller keeps."""
    loop = loop_of(make(), reference=0.0)
    system = loop.to_control(seed=None, engine="interpreted")
    whole = np.linalg.eigvals(system.linearize(system.initial_state).A)
    poles = loop.poles()
    assert 3 <= len(poles) <= 6
    for pole in poles:
        assert np.abs(whole - pole).min() < 1e-5
    assert loop.margins().gain > 0


def test_a_controller_that_runs_at_every_second_step_sees_two_steps_of_the_plant():
    twice = controllers.LinearModel(A @ A, A @ B + B, C, 2 * Q, R, dt=2 * DT)
    controller = controllers.LQGController(twice, goal_covariance=0.01, control_covariance=4.0)
    loop = loop_of(controller, dt=DT)
    assert loop.linear().dt == 2 * DT
    np.testing.assert_allclose(
        np.sort(np.abs(loop.poles())), np.sort(np.abs(controller.closed_loop_poles())), atol=1e-9
    )


def test_an_fmu_is_linearized_where_it_stands():
    car = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": 0.0})
    controller = controllers.design(car, measured="v", actuated="force", sensors=2, sensor_std=1.0)
    loop = cosim.closed_loop(
        car, controller, control="force", measured="v", sensors=cosim.Sensors(2, 1.0), reference=20.0,
        faults=[cosim.Freeze(sensor=0, start=1.0)], input_faults={"force": cosim.GainFault(factor=0.5, start=2.0)},
        noise={"disturbance": cosim.Gaussian(std=0.03)},
    )  # fmt: skip
    parts = loop.linear().parts
    np.testing.assert_allclose(parts.plant.A, controller.model.moving.A, atol=1e-8)
    np.testing.assert_allclose(
        np.sort(np.abs(loop.poles())), np.sort(np.abs(controller.closed_loop_poles())), atol=1e-6
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("gain", "lag"), [(1.0, 0), (-1.0, 0), (1.0, 3), (-1.0, 40)])
def test_the_phase_margin_can_be_read_off_at_the_labelled_line(gain, lag):
    """Python-control begins at -360 degrees for some loops; the line at -180 degrees is then far from the phase."""
    late = control.ss(np.eye(lag, k=-1), np.eye(lag)[:, :1], np.eye(lag)[-1:], 0.0, DT) if lag else 1.0
    loop = control.ss([[0.9, 1.0], [0.0, 0.8]], [[0.0], [0.1 * gain]], [[1.0, 0.0]], 0.0, DT) * late
    margins = margins_of(loop)
    _, axis = bode_figure(loop, margins, "", bare_figure()).axes
    frequency, phase = axis.lines[0].get_data()
    at = np.interp(margins.gain_crossover, frequency, phase)
    assert at == pytest.approx(-180.0 + margins.phase, abs=0.5)
    assert -360.0 < at <= 0.0
    assert {"-180\ndegrees": -180.0}.items() <= {text.get_text(): text.xy[1] for text in axis.texts}.items()
    low, high = axis.get_ylim()
    assert low < phase.min() <= phase.max() < high
    assert -180.0 in axis.get_yticks()


def test_a_loop_without_a_crossover_has_its_phase_near_the_line_as_well():
    loop = control.ss([[0.9]], [[0.01]], [[-1.0]], 0.0, DT)  # the gain is below 1
    _, axis = bode_figure(loop, margins_of(loop), "", bare_figure()).axes
    phase = axis.lines[0].get_ydata()
    assert -360.0 < phase[0] <= 0.0
    assert axis.get_ylim()[0] < -180.0 < axis.get_ylim()[1]


def test_a_notebook_shows_a_linear_loop_as_a_table():
    shown = loop_of(lqg()).linear()._repr_html_()
    assert "<td" in shown
    for text in ("LinearLoop", f"{DT:g} s", ">yes<", f"{loop_of(lqg()).poles()[0]:.4g}", "bode()"):
        assert text in shown
    strong = control.ss(MODEL.matrix("A"), 40.0 * MODEL.matrix("B"), MODEL.matrix("C")[:1], 0.0, DT)
    assert ">no<" in loop_of(lqg()).linear(plant=strong)._repr_html_()


def test_figures_show_loop_and_margins():
    loop = loop_of(lqg())
    bode, locus, margins = loop.bode(), loop.root_locus(), loop.margins()
    assert [axis.get_ylabel() for axis in bode.axes] == ["gain (dB)", "phase (degrees)"]
    assert bode.axes[0].get_yscale() == "linear"
    assert bode.axes[1].get_xlabel().endswith("dotted: where the margin is read")
    crossing = np.interp(margins.phase_crossover, *bode.axes[0].lines[0].get_data())
    assert crossing == pytest.approx(-20.0 * np.log10(margins.gain), abs=0.2)
    assert f"gain margin {margins.gain:.3g}" in bode.axes[0].get_title()
    axis, _ = locus.axes
    (now,) = [line for line in axis.lines if line.get_marker() == "s"]
    (branches,) = [line for line in axis.lines if line.get_marker() == "."]
    places = branches.get_xdata() + 1j * branches.get_ydata()
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    seen = places[(left < places.real) & (places.real < right) & (bottom < places.imag) & (places.imag < top)]
    assert np.abs(seen).max() > 1.0  # the branches are drawn to the limit of stability, and without gaps
    upper = seen[(seen.imag > 0.1) & (np.abs(seen) < 1.0)]
    apart = np.abs(upper[:, None] - upper) + 9.0 * np.eye(len(upper))
    assert apart.min(axis=1).max() < (right - left) / 100.0
    texts = [text.get_text() for text in locus.legends[0].get_texts()]
    assert texts[:2] == [f"limit of stability, reached at gain {margins.gain:.3g}", "poles at the designed gain (1.0)"]
    np.testing.assert_allclose(now.get_xydata(), np.column_stack([loop.poles().real, loop.poles().imag]))


def test_the_root_locus_names_the_limit_below_the_designed_gain_as_well():
    """A controller that estimates a load of an integrator twice over loses the loop also if its gain falls."""
    satellite = control.ss([[0, 1], [0, 0]], [[0], [2]], np.eye(2), 0, inputs=["torque"], outputs=["angle", "rate"])
    parts = {
        "measured": ["angle", "rate"],
        "actuated": "torque",
        "goal": "angle",
        "sensor_std": [1e-3, 1e-4],
        "dt": 0.1,
    }
    controller = controllers.design(
        satellite, disturbance=1e-8, acceptable_error=1e-3, acceptable_control=2e-3, **parts
    )
    loop = cosim.closed_loop(
        satellite, controller, control="torque", measured=["angle", "rate"], reference=0.0
    ).linear()
    margins, legend = loop.margins(), loop.root_locus().legends[0].get_texts()[0].get_text()
    assert 0.0 < margins.lowest_gain < 1.0 < margins.highest_gain < np.inf
    assert legend == f"limit of stability, reached at gain {margins.lowest_gain:.3g} and {margins.highest_gain:.3g}"


@pytest.mark.parametrize("count", [2, 4])
def test_the_root_locus_has_the_whole_unit_circle_and_enlarges_poles_near_one(count):
    poles = np.array([0.99, 0.97 + 0.01j, 0.97 - 0.01j, 0.95])[:count] if count > 2 else np.array([0.3, 0.99])
    system = control.ss(np.diag([0.98, 0.9]), [[0.01], [0.02]], [[1.0, 0.5]], 0, DT)
    figure = root_locus_figure(system, poles, "a title", bare_figure())
    figure.draw_without_rendering()
    for axis in figure.axes:
        assert axis.get_aspect() == 1.0
        assert np.ptp(axis.get_xlim()) == pytest.approx(np.ptp(axis.get_ylim()))
    whole = figure.axes[0]
    for low, high in (whole.get_xlim(), whole.get_ylim()):
        assert low < -1.0 < 1.0 < high
    assert len(figure.axes) == (1 if count == 2 else 2)
    if count > 2:
        part = figure.axes[1]
        assert part.get_title() == "enlarged: 4 of 4 poles of the loop, near 1"
        low, high = part.get_xlim()
        assert low < 0.9 < 1.0 < high
        assert high - low < 0.2


def source_alone():
    diagram = cosim.Diagram(DT)
    diagram.add(cosim.Constant(1.0))
    return diagram


def squares(u, clean):
    for i in range(clean.shape[0]):
        clean[i] = u[0] * u[0]


def unstable():
    return loop_of(lqg(), cosim.StateSpace(control.ss(2.0 * A, B, H, 0, DT, inputs=["force"], outputs=["position"])))


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: source_alone().bode(), "A closed loop has one Sensors block"),
        (lambda: loop_of(lqg(), sensors=cosim.Sensors(2, 0.1, function=squares)).margins(), "have a measurement function"),
        (lambda: unstable().step_info(), "The closed loop is not stable: its largest poles are 1.896"),
        (lambda: loop_of(lqg()).linear(plant=control.ss(A, np.eye(2), H, 0, DT)), "2 inputs and 1 outputs, but the loop has 1"),
        (lambda: loop_of(lqg()).linear(plant=control.ss(A, B, H, 0, 0.3)), "sample time of 0.3 s, but the controller runs every"),
        (lambda: loop_of(lqg()).linear(plant=3.0), "StateSpace takes a StateSpace"),
    ],
)  # fmt: skip
def test_refusals_are_sentences(ask, sentence):
    with pytest.raises(ModelError, match=sentence):
        ask()


def disturbed(source, total=None, **options):
    """Return the loop with a source added to its control."""
    connections = [(["plant.force", "source.y"], "total.u"), ("total.y", "plant.force")]
    blocks = {"source": source, "total": total or cosim.Sum()}
    return loop_of(lqg(), blocks=blocks, connections=connections, **options)


@pytest.mark.parametrize("source", [cosim.Gaussian(std=0.3), cosim.Constant(2.0)])
def test_what_a_source_adds_to_a_control_leaves_the_linear_loop_as_it_is(source):
    delay = {"input_faults": {"force": [cosim.Delay(delay=2 * DT, initial=0.0)]}}
    for options in ({}, delay):
        one, other = loop_of(lqg(), **options).linear(), disturbed(source, **options).linear()
        np.testing.assert_allclose(other.poles(), one.poles(), atol=1e-12)
        assert other.margins() == one.margins()


def test_a_fault_before_the_sum_belongs_to_the_control():
    loop = disturbed(cosim.Constant(2.0), input_faults={"force": [cosim.GainFault(factor=0.5, start=1.0)]})
    (role,) = find_roles(loop).controls
    assert (role.name, len(role.faults)) == ("force", 1)
    (received,) = find_roles(loop).inputs
    assert (received.name, received.control) == ("force", 0)


def test_a_sum_of_other_signals_is_no_part_of_the_control():
    with pytest.raises(
        ModelError, match="does not lead to the plant 'plant' through faults and sums with sources alone"
    ):
        disturbed(cosim.Constant(2.0), cosim.Sum("-+")).margins()


def test_another_system_may_stand_for_the_plant():
    softer = control.ss(0.98 * A, B, H, 0, DT)
    given = loop_of(lqg()).linear(plant=softer).poles()
    np.testing.assert_allclose(given, loop_of(lqg(), plant(0.98 * A)).poles(), atol=1e-12)


def test_an_integrator_that_no_goal_asks_about_does_not_disturb_the_response():
    """A position behind a speed that is led to its goal: it goes on for ever, and the speed settles."""
    model = controllers.LinearModel([[1, DT], [0, 0.9]], [[0.0], [0.1]], [[0, 1.0], [1.0, 0]], 1e-3, 1e-2, dt=DT)
    controller = controllers.LQGController(model, goal_on=[[0.0, 1.0]], goal_covariance=0.01)
    block = cosim.StateSpace(control.ss(model.A, model.B, model.C, 0, DT, inputs=["force"], outputs=["v", "s"]))
    loop = cosim.closed_loop(block, controller, control="force", measured=["v", "s"], reference=1.0)
    assert abs(loop.poles()[0]) > 1 - 1e-9
    assert loop.step_info()["SteadyStateValue"] == pytest.approx(1.0)
    assert "yes, apart from 1 mode without decay or growth" in loop.linear()._repr_html_()


@pytest.mark.slow
def test_an_fmu_that_hides_its_states_needs_a_model_in_its_place():
    path = fmus.path("PositionServo")
    controller = controllers.design(path, measured="angle", actuated="voltage", sensors=2)
    hidden, open_ = (
        cosim.closed_loop(
            block, controller, control="voltage", measured="angle", sensors=cosim.Sensors(2, 0.01), reference=1.0
        )
        for block in (cosim.FMU(path, isolate=True), cosim.FMU(path))
    )
    with pytest.raises(ModelError, match="has hidden states") as refused:
        hidden.bode()
    model = controllers.LinearModel.from_fmu(path, measured="angle", actuated="voltage", sensors=2)
    given = hidden.linear(plant=model.to_control()).margins()
    assert given == pytest.approx(open_.margins(), rel=1e-6)
    names = {"bayesftc": bayesftc, "loop": hidden}
    exec(str(refused.value).partition("\n")[2], names)  # the lines of the message, as they are
    assert names["linear"].margins() == pytest.approx(open_.margins(), rel=1e-6)


def test_the_model_in_place_of_a_hidden_plant_is_made_where_the_plant_rests():
    path = fmus.path("CruiseControl")
    controller = controllers.design(path, measured="v", actuated="force", at={"force": 500.0}, sensor_std=0.1)
    hidden = cosim.closed_loop(
        cosim.FMU(path, isolate=True), controller, control="force", measured="v", sensors=cosim.Sensors(1, 0.1), reference=1.0
    )  # fmt: skip
    with pytest.raises(ModelError, match=r"actuated=\['force'\], at=\{'force': 500\.0\}, dt='0\.02'\)"):
        hidden.bode()


def test_a_model_exchange_fmu_is_linearized_at_its_start(casadi_fmu):
    """A pendulum, held at 0.5 rad: its own equations there, sampled by python-control."""
    pendulum = cosim.FMU(casadi_fmu("pendulum", lambda q, u: q), kind="model exchange")
    sampled = control.ss([[0.0, 1.0], [-9.81 * np.cos(0.5), -0.1]], [[0.0], [1.0]], H, 0).sample(DT)
    model = controllers.LinearModel(sampled.A, sampled.B, C, Q, R, dt=DT)
    controller = controllers.LQGController(model, goal_covariance=0.01)
    loop = cosim.closed_loop(
        pendulum, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.2), reference=0.5
    )
    np.testing.assert_allclose(
        np.sort(np.abs(loop.poles())), np.sort(np.abs(controller.closed_loop_poles())), atol=1e-6
    )


def test_dead_times_of_the_diagram_are_part_of_the_linear_loop():
    """The poles are those of the same loop whose plant has the delays as states; a delay only for a time is a fault."""
    A, B, C = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
    model = controllers.LinearModel(A, B, np.vstack([C, C]), 1e-2 * B @ B.T + 1e-8 * np.eye(2), 1e-4, dt=0.1)
    controller = controllers.LQGController(
        model.with_delays(3, (0, 2)), controllers.FixedPrecision(), goal_covariance=0.01
    )

    def loop(delay, old):
        return cosim.closed_loop(
            cosim.StateSpace(control.ss(A, B, C, 0, 0.1)),
            controller,
            control="u",
            measured="y",
            sensors=cosim.Sensors(count=2, std=0.01),
            input_faults={"u": [cosim.Delay(delay=0.3, **delay)]},
            faults=[cosim.Delay(delay=0.2, sensor=1, **old)],
            reference=0.0,
        )

    right = loop({"initial": 0.0}, {"initial": float("nan")}).linear()
    poles = right.poles()
    slow = np.sort_complex(poles[np.abs(poles) > 0.05])
    expected = controller.closed_loop_poles()
    np.testing.assert_allclose(slow, np.sort_complex(expected[np.abs(expected) > 0.05]), atol=1e-9)
    assert right.margins().delay > 0.0
    without = loop({"stop": 5.0}, {"start": 1.0}).linear()
    assert len(without.poles()) == len(poles) - 5


def test_a_nonlinear_plant_is_linearized_with_the_controls_of_the_operating_point():
    """A tank whose outflow grows with the root of its level; without inflow it would be another plant."""

    def change(t, x, u, params):
        return np.array([0.1 * u[0] - 0.2 * np.sqrt(max(x[0], 1e-3)) * (1.0 + u[0])])

    tank = control.nlsys(change, lambda t, x, u, params: x, inputs=["pump"], outputs=["level"], states=["h"])
    plant = cosim.StateSpace(tank, initial=[0.25 / 9.0])  # 0.1 * 0.5 = 0.2 * sqrt(h) * 1.5
    controller = controllers.design(
        plant, measured="level", actuated="pump", sensors=2, sensor_std=0.01, dt=0.5, at={"pump": 0.5}
    )
    loop = cosim.closed_loop(
        plant, controller, control="pump", measured="level", sensors=cosim.Sensors(2, 0.01), reference=0.03
    )
    slope = -0.1 * 1.5 / np.sqrt(0.25 / 9.0)
    effect = 0.1 - 0.2 * np.sqrt(0.25 / 9.0)
    exact = control.ss([[slope]], [[effect]], [[1.0]], 0, inputs=["pump"], outputs=["level"])
    np.testing.assert_allclose(
        np.sort_complex(loop.poles()), np.sort_complex(loop.linear(plant=exact).poles()), rtol=1e-4
    )
    described = controller.describe().split("filter's included: ")[1].split(";")[0]
    poles = sorted(float(pole) for pole in described.split(", "))
    np.testing.assert_allclose(np.sort(loop.poles().real), poles, rtol=1e-4)


def test_a_loop_of_other_blocks_is_refused_with_what_to_use_and_that_works(make_block):
    def act(y, goal, integral, u):
        integral[0] = integral[0] + (goal[0] - y[0]) / 30.0
        u[0] = 2.0 * (goal[0] - y[0] + integral[0])

    ports = {"inputs": [cosim.Port("y"), cosim.Port("goal")], "outputs": [cosim.Port("u")]}
    diagram = cosim.Diagram(dt=0.1)
    plant = diagram.add(cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)), "plant")
    pi = diagram.add(make_block(output=act, state={"integral": 0.0}, **ports), "pi")
    diagram.connect(diagram.add(cosim.Constant(0.0), "reference")["y"], pi["goal"])
    diagram.connect(plant["y"], pi["y"])
    diagram.connect(pi["u"], plant["u"])
    for refused in (diagram.margins, diagram.bode, diagram.poles, diagram.step_info):
        with pytest.raises(ModelError, match=r"has 0\. For a loop of other blocks, system = diagram\.to_control\("):
            refused()
    system = diagram.to_control(inputs=["pi.u"], outputs=["pi.u"])
    z = np.exp(0.05j)
    expected = 0.1 / (z - 0.9) * 2.0 * (1.0 + 1.0 / 30.0 / (1.0 - 1.0 / z))
    assert complex(-system.linearize(system.initial_state)(z)) == pytest.approx(expected)


def test_the_frequencies_of_a_bode_plot_are_those_of_the_loop():
    """An integrator's pole at zero, up to rounding, gave ten decades on the left."""
    slow = control.ss([[1.0 - 1e-12]], [[0.1]], [[1.0]], 0, DT)
    figure = bode_figure(slow, None, "", bare_figure())
    frequencies = figure.axes[0].lines[0].get_xdata()
    assert np.pi / DT / 1e5 == pytest.approx(min(frequencies))
    assert max(frequencies) == pytest.approx(np.pi / DT)


# --- Controllers and plants in absolute values -----------------------------------------------------------------------

WARM, VALVE = 60.0, 0.5 * 40.0 / 30.0
"""The temperature of a heat exchanger, and the valve at which it stays: the effect of the valve depends on the temperature."""


def exchanger(initial=WARM, name="valve"):
    def rates(t, x, u, params):
        return [(u[0] * (90.0 - x[0]) - 0.5 * (x[0] - 20.0)) / 100.0]

    system = control.nlsys(rates, lambda t, x, u, p: x[:1], inputs=[name], outputs=["supply"], states=["T"])
    return cosim.StateSpace(system, initial=[initial])


def own_pi(low=0.0, high=1.0, bias=VALVE):
    """A PI controller with limits and an integral with limits; with a bias of None the bias is a further input."""

    def out(t, x, u, params):
        return [np.clip((u[3] if bias is None else bias) + 0.03 * (u[2] - (u[0] + u[1]) / 2) + x[0], low, high)]

    def update(t, x, u, params):
        return [np.clip(x[0] + 0.01 * (u[2] - (u[0] + u[1]) / 2), -0.5, 0.5)]

    names = ["y[0]", "y[1]", "goal", *(["bias"] if bias is None else [])]
    return cosim.StateSpace(control.nlsys(update, out, dt=5.0, inputs=names, outputs=["u"], states=1))


def heating(controller, block=None, **options):
    settings = {"measured": "supply", "sensors": cosim.Sensors(2, 0.2), "reference": WARM}
    return cosim.closed_loop(block or exchanger(), controller, control="valve", **settings | options)


def test_a_controller_in_absolute_values_is_linearized_where_the_loop_begins(recwarn):
    """At inputs of zero it is at its limit. python-control linearizes the whole loop at its goal; faults do not count."""
    faults = [cosim.Bias(sensor=0, start=0.0, magnitude=500.0)]
    loop = heating(own_pi(), faults=faults, reference=cosim.Step(time=100.0, before=WARM, after=65.0))
    whole = heating(own_pi()).to_control(inputs={"reference.y": "goal"}, outputs=["plant.supply"], seed=None)
    exact = np.linalg.eigvals(control.linearize(whole, whole.initial_state, [WARM]).A)
    np.testing.assert_allclose(np.sort_complex(loop.poles()), np.sort_complex(exact[np.abs(exact) > 1e-9]), rtol=1e-5)
    margins = loop.margins()
    assert 1.0 < margins.gain < np.inf
    assert margins == pytest.approx(heating(own_pi(-1e9, 1e9)).margins(), rel=1e-6)
    assert loop.step_info()["SteadyStateValue"] == pytest.approx(1.0)
    given = control.ss([[-(VALVE + 0.5) / 100.0]], [[0.3]], [[1.0]], 0, inputs=["valve"], outputs=["supply"])
    assert loop.linear(plant=given).margins() == pytest.approx(margins, rel=1e-6)
    assert not [each for each in recwarn if "no feedback" in str(each.message)]


@pytest.mark.parametrize(
    "options",
    [
        {"sensors": cosim.Sensors(2, 0.2, every=(1, 4))},
        {
            "faults": [cosim.Delay(delay=5.0, sensor=0, initial=np.nan)],
            "input_faults": {"valve": [cosim.Delay(delay=10.0)]},
        },
        {"input_faults": {"valve": [cosim.Stuck(start=0.0, at=1.0)]}},
    ],
)
def test_the_beginning_of_a_loop_is_that_without_faults_and_missing_samples(options):
    found = heating(own_pi(), **options).margins()
    assert 1.0 < found.gain < np.inf
    assert found == pytest.approx(heating(own_pi(-1e9, 1e9), **options).margins(), rel=1e-6)


def test_the_other_inputs_of_a_controller_have_their_first_values():
    bias = {"blocks": {"open": cosim.Constant(VALVE)}, "connections": [("open.y", "controller.bias")]}
    assert heating(own_pi(bias=None), **bias).margins() == pytest.approx(heating(own_pi()).margins(), rel=1e-9)


@pytest.mark.parametrize("start", [20.0, 89.0])
def test_a_controller_at_its_limit_is_said_and_is_no_feedback(start):
    loop = heating(own_pi(), exchanger(start))
    with pytest.warns(
        UserWarning, match=rf"at y = \[{start:g}, {start:g}\] and goal = \[60\].* no feedback: its control valve"
    ):
        assert loop.margins().gain == np.inf


@pytest.mark.parametrize("smooth", [cosim.ExponentialFilter(50.0), cosim.MovingAverage(4)])
def test_the_filters_of_a_controller_have_settled_at_the_first_samples(smooth):
    """With memories of zero the limit would be reached."""

    def law(limit):
        inside = cosim.Diagram(dt=5.0)
        filtered, error, gain, limited = (
            inside.add(block, name)
            for name, block in (
                ("filter", smooth),
                ("error", cosim.Sum("+-")),
                ("gain", cosim.Gain(VALVE / 5.0)),
                ("limit", limit),
            )
        )
        inside.connect(filtered["y"], error["u[1]"])
        inside.connect(error["y"], gain["u"])
        inside.connect(gain["y"], limited["u"])
        return cosim.Subsystem(inside, inputs={"y": "filter.u", "goal": "error.u[0]"}, outputs={"u": "limit.y"})

    loops = [
        heating(law(cosim.Saturation(-high, high)), sensors=cosim.Sensors(1, 0.2), reference=WARM + 5.0)
        for high in (1.0, 1e9)
    ]
    np.testing.assert_allclose(loops[0].poles(), loops[1].poles(), rtol=1e-9)
    assert loops[0].margins().gain < np.inf


@pytest.mark.filterwarnings("ignore:The controller's belief")
def test_a_plant_within_its_dead_band_has_finite_matrices_and_a_warning():
    """The figures were a LinAlgError."""

    def valve(band):
        def rates(t, x, u, params):
            e = u[0] - x[0]
            return [(e - np.clip(e, -band, band)) / 25.0, (40.0 * x[0] - x[1]) / 300.0]

        return control.nlsys(rates, lambda t, x, u, p: x[1:], inputs=["valve"], outputs=["supply"], states=["v", "T"])

    controller = controllers.design(
        valve(0.0), measured="supply", sensors=2, sensor_std=0.2, actuated="valve", dt=10.0, noise={"valve": 0.05},
        acceptable_error=1.0, acceptable_control=0.2,
    )  # fmt: skip
    plant = cosim.StateSpace(valve(0.01), initial=[0.0, 0.0])
    loop = heating(controller, plant, reference=0.0)
    with pytest.warns(UserWarning, match="Where the plant 'plant' begins, valve has no effect on its measured signals"):
        linear = loop.linear()
    exact = control.linearize(valve(0.01), [0.0, 0.0], [0.0]).sample(10.0)
    assert (
        np.abs(exact.poles() - 1.0).min() < 1e-9
    )  # the valve stays; without an effect on it, it is no state of the plant
    assert np.abs(exact.poles() - np.linalg.eigvals(linear.parts.plant.A)).min() < 1e-9
    assert np.isfinite(linear.closed.A).all()
    assert linear.margins().gain == np.inf
    assert linear.bode().axes
    assert linear.root_locus().axes


def test_a_plant_without_a_derivative_is_refused_with_a_sentence():
    system = control.nlsys(
        lambda t, x, u, p: [u[0] - np.sqrt(x[0])], lambda t, x, u, p: x, inputs=["valve"], outputs=["supply"], states=1
    )
    with pytest.raises(ModelError, match="The plant 'plant' cannot be linearized at its start values"):
        heating(own_pi(), cosim.StateSpace(system, initial=[0.0])).poles()


def test_a_bode_plot_may_be_in_hertz_and_over_other_frequencies():
    loop = loop_of(lqg())
    usual, hertz = loop.bode(), loop.bode(Hz=True, omega=[0.1, 10.0])
    (rad, gain), (hz, same) = (figure.axes[0].lines[0].get_data() for figure in (usual, hertz))
    assert (hz[0], hz[-1]) == pytest.approx((0.1 / (2 * np.pi), 10.0 / (2 * np.pi)))
    np.testing.assert_allclose(np.interp(2 * np.pi * hz, rad, gain), same, atol=0.01)
    at = loop.margins().gain_crossover / (2 * np.pi)
    assert f"(at {at:.3g} Hz)" in hertz.axes[0].get_title()
    assert "frequency (Hz)" in hertz.axes[1].get_xlabel()
    assert len(loop.bode(omega=[0.5, 1.0, 2.0]).axes[0].lines[0].get_xdata()) == 3
    for wrong in ([0.0, 1.0], [2.0, 1.0], [1.0], [1.0, 40.0]):
        with pytest.raises(ModelError, match=r"half of the sampling frequency, 31.4159 rad/s"):
            loop.bode(omega=wrong)


def test_a_goal_on_an_output_without_a_sensor_has_a_step_response():
    """As an area control error: the response is that of a run without noise, and margins are those without the output."""
    seen = np.array([[1.0, 0.0], [0.4, 1.0]])
    block = cosim.StateSpace(control.ss(A, B, seen, 0, DT, inputs=["force"], outputs=["position", "aim"]))
    controller = controllers.design(
        block, measured="position", actuated="force", goal="aim", dt=DT, sensors=2, sensor_std=0.01, loads=None,
        noise={"force": 0.01}, acceptable_error=0.1, acceptable_control=2.0,
    )  # fmt: skip
    loop = loop_of(controller, block, sensors=cosim.Sensors(2, 0.0))
    run = loop.simulate(6.0, engine="interpreted")
    linear = loop.linear()
    response = control.step_response(linear.closed[0, 0], run.time).outputs
    np.testing.assert_allclose(run["plant.aim"], response, atol=1e-6)
    assert loop.step_info() == loop.step_info("aim", "aim")
    assert linear.zeros("aim").size
    without = loop_of(controller, cosim.StateSpace(control.ss(A, B, H, 0, DT, inputs=["force"], outputs=["position"])))
    np.testing.assert_allclose(linear.poles(), without.poles(), atol=1e-9)
    with pytest.raises(
        ModelError, match="No measured signal, and no output of the plant, has its own goal in this loop"
    ):
        without.step_info()
