"""Margins against a scan of the closed loop's poles, over gains and over phases; `test_delays` has the delays."""

import re

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.control.margins import margins_of

DT = 0.1


def loop(A, B, C, D=0.0):
    return control.ss(A, B, C, D, DT)


def largest_pole(system, gain):
    """Largest pole of the loop that is closed with this gain, which may be complex: of a changed phase."""
    gain = gain / (1.0 + gain * system.D[0, 0])
    return np.abs(np.linalg.eigvals(system.A - gain * system.B @ system.C)).max()


def random_loops(count=25):
    rng = np.random.default_rng(3)
    while count:
        n = rng.integers(1, 6)
        A = rng.standard_normal((n, n))
        A *= rng.uniform(0.5, 1.1) / np.abs(np.linalg.eigvals(A)).max()
        system = loop(A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)) * rng.uniform(0.05, 1.0))
        if largest_pole(system, 1.0) < 0.999:
            count -= 1
            yield system


LOOPS = {
    "limit at half of the sampling frequency": loop([[0.9]], [[1.0]], [[0.9]]),
    "unstable plant": loop([[1.2]], [[1.0]], [[0.8]]),
    "lightly damped": loop(
        0.999 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]), [[0.0], [1.0]], [[-0.0007, 0.0006]]
    ),
    "integrator": loop([[1.0, 0.1], [0.0, 0.6]], [[0.0], [1.0]], [[0.5, 0.0]]),
    **{f"random {i}": system for i, system in enumerate(random_loops())},
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("system", LOOPS.values(), ids=LOOPS)
def test_margins_are_where_poles_reach_the_unit_circle(system):
    found = margins_of(system)
    assert largest_pole(system, 1.0) < 1.0
    scan = np.concatenate([np.geomspace(1e-4, 1.0, 4000), np.geomspace(1.0, 1e4, 4000)])
    lost = np.array([largest_pole(system, k) >= 1.0 for k in scan])
    if np.isfinite(found.gain):
        assert largest_pole(system, found.gain) == pytest.approx(1.0, abs=1e-7)
        edge = abs(np.log(found.gain))
        assert not lost[np.abs(np.log(scan)) < 0.999 * edge].any()
    else:
        assert not lost.any()
    turns = np.deg2rad(np.linspace(0.0, 180.0, 2001))
    lost = np.array([max(largest_pole(system, np.exp(s * 1j * a)) for s in (1, -1)) >= 1.0 for a in turns])
    if np.isfinite(found.phase):
        assert largest_pole(system, np.exp(-1j * np.deg2rad(found.phase))) == pytest.approx(1.0, abs=1e-7)
        assert not lost[turns < np.deg2rad(abs(found.phase)) * 0.999].any()
    else:
        assert not lost.any()
    angles = np.linspace(1e-4, np.pi, 40_000)
    distances = np.abs(1.0 + system(np.exp(1j * angles)))
    assert found.modulus <= distances.min() * (1 + 1e-9)
    assert found.modulus == pytest.approx(distances.min(), rel=2e-3)


def test_a_repeated_pole_at_one_has_margins():
    """Its poles are computed as 1 ± 1e-8, but at z = 1 the matrix z I - A is singular."""
    chain, b, c = np.array([[1.0, 0.125], [0.0, 1.0]]), np.array([[0.0], [1.0]]), np.array([[0.05, 0.5]])
    turn, back = np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([[1.0, 0.0], [-1.0, 1.0]])
    found = margins_of(loop(turn @ chain @ back, turn @ b, c @ back))
    assert found.phase == pytest.approx(margins_of(loop(chain, b, c)).phase, rel=1e-6)


def test_margins_and_poles_do_not_depend_on_the_units_of_the_states():
    """A hydraulic cylinder with its pressure in Pa: a matrix with entries of 1e9 seemed singular at -1 and at 1."""
    A = np.array([[0, 1, 0], [0, -10, 5e-6], [0, -8e9, -16.0]])
    B = np.array([[0, 0], [0, -0.005], [4e9, 0]])
    found = []
    for unit in (1.0, 1e-5):
        S = np.diag([1, 1, unit])
        plant = control.ss(
            S @ A @ np.linalg.inv(S), S @ B, np.eye(3), 0, inputs=["valve", "load"], outputs=["x", "v", "p"]
        )
        std = [1e-4] * 3 + [5e4 * unit] * 2
        controller = controllers.design(
            plant, measured=["x", "p"], actuated="valve", sensors=[3, 2], sensor_std=std, goal="x", dt=0.002,
            noise={"load": 200.0}, acceptable_error=0.002, acceptable_control=0.5, precision=controllers.FixedPrecision(),
        )  # fmt: skip
        sensors = cosim.Sensors([3, 2], std)
        closed = cosim.closed_loop(
            plant, controller, control="valve", measured=["x", "p"], sensors=sensors, reference=0.1
        )
        poles = re.search(r"All poles.*the slowest of magnitude ([\d.]+) \(", controller.describe())[1]
        assert float(poles) == pytest.approx(np.abs(closed.poles()).max(), abs=1e-3)
        _, phases, _, _, crossovers, _ = control.stability_margins(closed.linear().open(), returnall=True)
        delay = min(np.deg2rad(phase % 360) / w for phase, w in zip(phases, crossovers, strict=True))
        assert closed.margins().delay == pytest.approx(delay, rel=0.01)  # nearly three samples, within which it differs
        check = controllers.check_kalman(closed.simulate(2.0, seed=1), controller)
        assert max(check.mean_difference, check.covariance_difference) < 1e-9
        found.append(closed.margins())
    np.testing.assert_allclose(*found, rtol=1e-5)
