"""The robot arm: its FMU against Lagrange's equations, and its sensors, as a plant in a closed loop."""

import math
import pickle
from fractions import Fraction

import numpy as np
import pytest
from fmpy import simulate_fmu
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import ModelError, SimulationError, UnknownNameError
from bayesftc.cosim.stepping.differentiation import jacobian

STATE = ("q1", "q2", "dq1", "dq2")
MEASURED = list(STATE)
BARREL = (-1.5e-3, 5e-6, 0.0)  # the paper's camera

# The arm of the authors' public code, written down a second time on purpose.
ARM = {
    "I1": 1.0209, "I2": 1.0218, "m1": 2.1368, "m2": 2.2418, "L1": 1.0446, "L2": 1.0111, "Lg1": 0.5451, "Lg2": 0.5075,
    "D1": 101.519, "D2": 103.8566, "g": 9.81,
}  # fmt: skip
# Another arm, with little friction, so that everything else shows.
LIGHT = {
    "I1": 0.3, "I2": 0.11, "m1": 1.7, "m2": 0.9, "L1": 0.8, "L2": 0.6, "Lg1": 0.35, "Lg2": 0.4, "D1": 0.05, "D2": 0.02,
    "g": 9.7,
}  # fmt: skip
START = {"q1_0": 0.7, "q2_0": -1.9, "dq1_0": 1.1, "dq2_0": -2.3}


def energies(p, q, dq, cos=np.cos, sin=np.sin):
    """Return kinetic and potential energy, from how the two centres of mass move."""
    (a, b), (da, db) = (q[0], q[0] + q[1]), (dq[0], dq[0] + dq[1])
    v1 = (-p["Lg1"] * sin(a) * da, p["Lg1"] * cos(a) * da)
    v2 = (
        -p["L1"] * sin(a) * da - p["Lg2"] * sin(b) * db,
        p["L1"] * cos(a) * da + p["Lg2"] * cos(b) * db,
    )
    kinetic = 0.5 * p["m1"] * (v1[0] ** 2 + v1[1] ** 2) + 0.5 * p["m2"] * (v2[0] ** 2 + v2[1] ** 2)
    kinetic = kinetic + 0.5 * p["I1"] * da**2 + 0.5 * p["I2"] * db**2
    heights = p["Lg1"] * sin(a), p["L1"] * sin(a) + p["Lg2"] * sin(b)
    return kinetic, p["g"] * (p["m1"] * heights[0] + p["m2"] * heights[1])


def lagrange(p):
    """Return d/dt of the state, from Lagrange's equations of these energies by automatic differentiation."""
    ca = pytest.importorskip("casadi", reason="CasADi is not installed (extra 'test')")
    q, dq, torque = (ca.SX.sym(name, 2) for name in ("q", "dq", "torque"))
    kinetic, potential = energies(p, (q[0], q[1]), (dq[0], dq[1]), ca.cos, ca.sin)
    momentum = ca.gradient(kinetic, dq)
    friction = ca.vertcat(p["D1"] * dq[0], p["D2"] * dq[1])
    force = torque - friction + ca.gradient(kinetic - potential, q) - ca.jtimes(momentum, q, dq)
    ddq = ca.solve(ca.jacobian(momentum, dq), force)
    rate = ca.Function("rate", [q, dq, torque], [ca.vertcat(dq, ddq)])
    return lambda x, u: np.array(rate(x[:2], x[2:], u)).ravel()


def exact(parameters, start, torques, h):
    """Integrate with small tolerances; row k of the torques is held from k h on."""
    rate, rows = lagrange(parameters), [np.array(list(start.values()))]
    for u in torques:
        held = solve_ivp(lambda t, x, u=u: rate(x, u), (0.0, h), rows[-1], method="DOP853", rtol=1e-12, atol=1e-13)
        rows.append(held.y[:, -1])
    return np.array(rows)


def torque_table(h, duration, size):
    t = np.arange(0.0, duration + h / 2, h)
    return t, np.column_stack((size * np.sin(2.0 * t), size * np.cos(3.1 * t) - 0.3 * size))


def run(torques=None, *, h=0.01, duration=1.0, fmi="2.0", engine="auto", **parameters):
    """Run the FMU in a diagram; torques are rows for the instants k h."""
    diagram = cosim.Diagram(dt=h)
    arm = diagram.add(cosim.FMU(fmus.path("TwoLinkArm", fmi=fmi), parameters=parameters), "arm")
    if torques is not None:
        t, values = torques
        for i in range(2):
            table = cosim.Table(t, values[:, i])
            diagram.connect(diagram.add(table, f"torque_{i}")["y"], arm[f"torque{i + 1}"])
    return diagram.simulate(duration, engine=engine)


def states(result):
    return np.column_stack([result[f"arm.{name}"] for name in STATE])


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("given", "size", "tolerance"),
    [({}, 150.0, 1e-6), ({"max_substep": 1e-4}, 150.0, 1e-10), (LIGHT, 8.0, 1e-8)],
    ids=["shipped", "shipped, short substeps", "light"],
)
@pytest.mark.parametrize("h", [0.001, 0.01])
def test_motion_is_that_of_lagranges_equations(given, size, tolerance, h):
    torques = torque_table(h, 1.0, size)
    found = states(run(torques, h=h, **given, **START))
    expected = exact(ARM | given, START, torques[1][:-1], h)
    assert np.ptp(expected, axis=0).min() > 0.5  # it does move
    assert_allclose(found, expected, atol=tolerance, rtol=0.0)


def test_energy_is_kept_without_friction():
    given = {**LIGHT, "D1": 0.0, "D2": 0.0}
    found = states(run(duration=10.0, **given, **START))
    kinetic, potential = energies(given, found[:, :2].T, found[:, 2:].T)
    total = kinetic + potential
    assert np.ptp(kinetic) > 5.0
    assert np.abs(total - total[0]).max() < 1e-6 * np.ptp(kinetic)


def test_it_hangs_at_rest_by_default():
    result = run(duration=5.0)
    assert_allclose(states(result), np.tile([-math.pi / 2, 0.0, 0.0, 0.0], (501, 1)), atol=1e-15)
    assert_allclose(result["arm.y"], -(ARM["L1"] + ARM["L2"]), rtol=1e-15)
    assert_allclose(result["arm.x"], 0.0, atol=1e-15)


def test_energy_is_lost_to_friction_until_it_hangs():
    found = states(run(duration=60.0, h=0.1, **{**LIGHT, "D1": 2.0, "D2": 1.0}, **START))
    turns = found[-1, :2] / (2.0 * np.pi) - [-0.25, 0.0]
    assert_allclose(turns, np.round(turns), atol=1e-4)
    assert_allclose(found[-1, 2:], 0.0, atol=1e-3)


def test_a_longer_step_is_cut_into_substeps():
    fine, coarse = (states(run(h=h, **LIGHT, **START)) for h in (0.001, 0.01))
    assert_allclose(coarse, fine[::10], atol=1e-11)
    # The classical method's error falls by 2^4 where the substep is halved.
    best = states(run(h=0.04, max_substep=1e-4, **LIGHT, **START))
    errors = [
        np.sqrt(np.mean((states(run(h=0.04, max_substep=m, **LIGHT, **START)) - best) ** 2)) for m in (5e-3, 2.5e-3)
    ]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.25)


def test_both_versions_and_both_engines_give_the_same_bits(same_bits):
    torques = torque_table(0.01, 1.0, 150.0)
    first = run(torques, **START)
    for other in (run(torques, fmi="3.0", **START), run(torques, engine="interpreted", **START)):
        for name in (*STATE, "x", "y"):
            same_bits(first[f"arm.{name}"], other[f"arm.{name}"], name)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_fmpys_own_loop_gives_the_same(fmi):
    h, (t, values) = 0.01, torque_table(0.01, 1.0, 150.0)
    kind = [("time", float), ("torque1", float), ("torque2", float)]
    signals = np.array([(a, *row) for a, row in zip(t, values, strict=True)], dtype=kind)
    names = [*STATE, "x", "y"]
    path = str(fmus.path("TwoLinkArm", fmi=fmi))
    theirs = simulate_fmu(path, stop_time=1.0, output_interval=h, start_values=START, input=signals, output=names)
    ours = run((t, values), fmi=fmi, **START)
    for name in names:
        assert_allclose(ours[f"arm.{name}"], theirs[name], atol=1e-12, rtol=0.0)


@pytest.mark.parametrize(
    ("substep", "code"),
    [(0.0, 1), (-1e-3, 1), (1e-9, 2)],
)
def test_a_substep_that_cannot_be_is_an_error(substep, code):
    with pytest.raises(SimulationError, match=rf"could not go from 0 to 0\.01 \(code {code}\)"):
        run(max_substep=substep)


def test_start_values_are_the_descriptions_or_the_users():
    arm = cosim.FMU(fmus.path("TwoLinkArm"), parameters={"L2": 0.8})
    assert {name: arm.start_value(name) for name in ARM} == {**ARM, "L2": 0.8}
    assert arm.start_value("q1") is None
    with pytest.raises(UnknownNameError, match="no variable 'L11'; did you mean"):
        arm.start_value("L11")


def called(function, x, size):
    y = np.full(size, np.nan)
    function(np.asarray(x, float), y)
    return y


def seen(x, lengths, k):
    """What the sensors of the arm read, by NumPy."""
    x = np.asarray(x)
    n = len(lengths)
    absolute = np.cumsum(x[:n])
    end = np.array([np.sum(lengths * np.cos(absolute)), np.sum(lengths * np.sin(absolute))])
    r = np.hypot(*end)
    return np.concatenate([x, end * (1.0 + k[0] * r**2 + k[1] * r**4 + k[2] * r**6)])


@pytest.mark.parametrize("k", [(0.0, 0.0, 0.0), BARREL, (0.02, -0.003, 4e-4)])
def test_distortion(k):
    rng = np.random.default_rng(3)
    for p in rng.normal(size=(50, 2)) * 3.0:
        found = called(cosim.radial_distortion(*k), p, 2)
        r = np.hypot(*p)
        assert_allclose(found, p * np.polynomial.polynomial.polyval(r**2, (1.0, *k)), rtol=1e-13, atol=1e-14)
        if not any(k):
            assert_array_equal(found, p)
    assert called(cosim.radial_distortion(*k), (0.0, 0.0), 2).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("lengths", [(0.7,), (1.0446, 1.0111), (0.3, 0.5, 0.2, 0.9)])
@pytest.mark.parametrize("k", [(0.0, 0.0, 0.0), BARREL, (0.02, -0.003, 4e-4)])
def test_arm_with_camera(lengths, k):
    rng, n = np.random.default_rng(4), len(lengths)
    function = cosim.arm_with_camera(lengths, k)
    assert function is cosim.arm_with_camera(list(lengths), list(k))  # so that it is compiled once
    for x in rng.normal(size=(50, 2 * n)) * 4.0:
        found = called(function, x, 2 * n + 2)
        assert_allclose(found, seen(x, lengths, k), rtol=1e-12, atol=1e-13)
        assert_array_equal(found[: 2 * n], x)
        end = called(cosim.planar_arm(lengths), x, 2)
        assert_array_equal(found[2 * n :], called(cosim.radial_distortion(*k), end, 2))


def test_barrel_distortion_draws_points_inwards_in_order():
    radii = np.linspace(0.01, 2.1, 100)  # all that the arm can reach
    seen_radii = np.array([called(cosim.radial_distortion(*BARREL), (r, 0.0), 2)[0] for r in radii])
    assert (seen_radii < radii).all()
    assert (np.diff(seen_radii) > 0.0).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cosim.radial_distortion(math.nan), "radial_distortion has k1, k2, k3=.*three finite"),
        (lambda: cosim.planar_arm(()), "planar_arm has lengths=.*positive"),
        (lambda: cosim.planar_arm((1.0, -1.0)), "planar_arm has lengths=.*positive"),
        (lambda: cosim.arm_with_camera((1.0, math.inf)), "arm_with_camera has lengths="),
        (lambda: cosim.arm_with_camera((1.0, 1.0), (0.1,)), "arm_with_camera has distortion=.*three finite"),
    ],
)
def test_settings_that_cannot_be_are_errors(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def pd(y, goal, u):
    """Drive the joints to the goal by their encoders and tachometers; the camera is not used."""
    for i in range(u.shape[0]):
        u[i] = 5000.0 * (goal[i] - y[i]) - 300.0 * y[u.shape[0] + i]


measure = cosim.arm_with_camera((ARM["L1"], ARM["L2"]), BARREL)


def measure_by_name(u, clean):
    """A function that can be pickled, since it stands in a module."""
    measure(u, clean)


@pytest.mark.parametrize("function", [measure, measure_by_name])
def test_the_arm_in_a_closed_loop(make_block, run_both, function):
    arm = cosim.FMU(fmus.path("TwoLinkArm"))
    std = (1e-3,) * 4 + (1e-2,) * 2
    controller = make_block(
        inputs=(cosim.Port("y", (6,)), cosim.Port("goal", (2,))),
        outputs=(cosim.Port("u", (2,)),),
        output=pd,
        sample_time=Fraction(1, 1000),
    )
    loop = cosim.closed_loop(
        plant=arm,
        controller=controller,
        measured=["q1", "q2", "dq1", "dq2"],
        control=["torque1", "torque2"],
        sensors=cosim.Sensors(count=6, signals=4, function=function, std=std),
        reference=[-0.2, 0.5],
    )
    result = run_both(loop, 2.0, seed=1)
    x = np.column_stack([result[f"plant.{name}"] for name in MEASURED])
    assert_allclose(x[0], [-math.pi / 2, 0.0, 0.0, 0.0], rtol=0.0)
    assert_allclose(x[-500:, :2], np.broadcast_to([-0.2, 0.5], (500, 2)), atol=0.02)
    lengths = np.array([arm.start_value("L1"), arm.start_value("L2")])
    noise = result["sensors.y"] - np.array([seen(row, lengths, BARREL) for row in x])
    assert_allclose(noise.std(axis=0), std, rtol=0.1)
    assert_allclose(noise.mean(axis=0) / std, 0.0, atol=4.0 / np.sqrt(len(noise)))
    end = np.array([called(cosim.planar_arm(lengths), row, 2) for row in x[::100]])
    assert_allclose(end, np.column_stack([result["plant.x"], result["plant.y"]])[::100], rtol=1e-14)


def test_sensors_with_a_named_function_can_be_pickled():
    sensors = cosim.Sensors(count=6, signals=4, function=measure_by_name, std=1e-3)
    assert pickle.loads(pickle.dumps(sensors)) == sensors


def test_the_measurement_has_a_jacobian():
    derivative = jacobian(measure, {"x": 4, "y": 6}, "y", ["x"])
    x, h, found = np.array([-0.9, 0.4, 0.3, -0.2]), 1e-6, np.full((6, 4), np.nan)
    derivative(x, found)
    for j, e in enumerate(np.eye(4)):
        difference = (called(measure, x + h * e, 6) - called(measure, x - h * e, 6)) / (2.0 * h)
        assert_allclose(found[:, j], difference, atol=1e-9)
