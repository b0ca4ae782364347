"""Delays of a part of a sample, against the poles of a loop whose held input is split by hand, and against runs."""

import control
import numpy as np
import pytest
from scipy.linalg import expm

from bayesftc import controllers, cosim
from bayesftc.cosim.control.delays import Held, Matrices, delay_margin, interpolated, repeated
from bayesftc.cosim.errors import ModelError

# --- The search, for random loops ------------------------------------------------------------------------------------


def step(A, B, t):
    """Matrices of a step of `t` with the input held."""
    n = len(A)
    both = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * t)
    return both[:n, :n], both[:n, n:]


def largest_pole(plant, law, delay):
    """Largest pole of the loop u = -law(y), sampled with a period of 1, whose plant gets u later by `delay`."""
    (A, B, C, D), (a, b, c, d) = plant, law
    whole, n, m = int(delay), len(A), len(a)
    part = delay - whole
    P, both = step(A, B, 1.0)
    now = step(A, B, 1.0 - part)[1]
    size = n + m + whole + 1  # states, those of the law, and u of the last samples
    rows = np.eye(size)
    x, z, past = rows[:n], rows[n : n + m], rows[n + m :]
    reads = whole - 1 if part == 0 else whole  # y contains the u that the plant has at this time
    if reads < 0:
        u = -(c @ z + d * C @ x) / (1.0 + d * D)
        y = C @ x + D * u
    else:
        y = C @ x + D * past[[reads]]
        u = -(c @ z + d * y)
    newer = past[[whole - 1]] if whole else u
    M = np.vstack([P @ x + now @ newer + (both - now) @ past[[whole]], a @ z + b @ y, u, past[:-1]])
    return np.abs(np.linalg.eigvals(M)).max()


def margin(plant, law, start, kind):
    """The delay margin of the same loop."""
    (A, B, C, D), (a, b, c, d) = plant, law
    P, G = step(A, B, 1.0)
    n, m = len(A), len(a)
    loop = Matrices(
        np.block([[P, np.zeros((n, m))], [b @ C, a]]), np.vstack([0 * G, b * D]), np.hstack([d * C, c]), np.array(d * D)
    )
    within = Held(A, B, 1.0) if kind == "continuous" else Held(*step(A, B, 1.0 / 64), 1.0, 64)
    return delay_margin(loop, lambda part: np.append(within.reached(part)[:, 0], np.zeros(m)), start)


def random_loops(seed, count):
    rng = np.random.default_rng(seed)
    while count:
        n, m = rng.integers(1, 5), rng.integers(0, 3)
        A = rng.choice([0.1, 0.5, 2.0]) * rng.standard_normal((n, n))
        A -= np.eye(n) * rng.choice([0.0, np.linalg.eigvals(A).real.max() + rng.choice([0.0, 1e-3, 0.05, 0.3])])
        D = rng.choice([0.0, 0.0, 0.3]) * rng.standard_normal((1, 1))
        plant = A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)), D
        a = rng.standard_normal((m, m))
        a *= rng.uniform(0.1, 0.9) / np.abs(np.linalg.eigvals(a)).max(initial=1e-9)
        gain = rng.uniform(0.02, 1.5)
        law = a, rng.standard_normal((m, 1)), gain * rng.standard_normal((1, m)), gain * rng.standard_normal((1, 1))
        start = float(rng.choice([0.0, 0.3, 1.0, 2.75]))
        if largest_pole(plant, law, start) < 0.9999:
            count -= 1
            yield plant, law, start


@pytest.mark.sampled(1)
@pytest.mark.parametrize("kind", ["continuous", "in steps"])
@pytest.mark.parametrize("seed", range(4))
def test_the_delay_margin_is_the_first_delay_that_moves_a_pole_out_of_the_unit_circle(seed, kind):
    finite = 0
    for plant, law, start in random_loops(seed, 12):
        found = margin(plant, law, start, kind)
        shorter = start + np.arange(1, 32 * min(found, 4.0)) / 32
        assert all(largest_pole(plant, law, delay) < 1.0 for delay in shorter)
        if np.isfinite(found):
            finite += 1
            near = 1e-3 if kind == "in steps" else 1e-6 + 1e-6 * found
            assert largest_pole(plant, law, start + found + near) > 1.0
            assert largest_pole(plant, law, start + max(found - near, 0.0)) < 1.0 + 1e-12
    assert finite > 2


# --- The margin of a diagram -----------------------------------------------------------------------------------------

T = 5e-5
RATE = 2 * np.pi * 4100
A = np.zeros((5, 5))
A[:2] = [[0, 1, 0, 0, 0], [-1e5, -120, 0, 0, 6.4e7]]
A[2:4] = [[0, 0, 0, 1, 0], [0, 0, -(RATE**2), -0.03 * RATE, -1e7]]
A[4, 4] = -5e4
B = np.array([[0.0], [0.0], [0.0], [0.0], [5e4]])
C = np.array([[1.0, 0, 1, 0, 0], [1.0, 0, 0, 0, 0]])  # fmt: skip
NAMES = {"inputs": ["drive"], "outputs": ["head", "coil"]}
SERVO = control.ss(A, B, C, 0, **NAMES)
"""A lightly damped mode at a fifth of the sampling frequency, driven through a lag."""


@pytest.fixture(scope="module")
def controller():
    return controllers.design(
        SERVO, measured=["head", "coil"], actuated="drive", goal="head", sensor_std=[0.01, 0.1], dt=T,
        acceptable_error=0.2, acceptable_control=1.0, noise={"drive": 2.0}, precision=controllers.FixedPrecision(),
    )  # fmt: skip


def servo(controller, plant=SERVO, late=None, std=(0.01, 0.1), **options):
    if late is not None:
        options["input_faults"] = {"drive": cosim.Delay(delay=late, initial=0.0)}
    return cosim.closed_loop(
        plant, controller, control="drive", measured=["head", "coil"], sensors=cosim.Sensors([1, 1], std),
        reference=options.pop("reference", 0.0), **options,
    )  # fmt: skip


def delayed(delay):
    """The servo in discrete time with a delay of its input of less than a sample."""
    P, both = step(A, B, T)
    now = step(A, B, T - delay)[1]
    M = np.block([[P, both - now], [np.zeros((1, 6))]])
    return control.ss(M, np.vstack([now, [[1.0]]]), np.hstack([C, np.zeros((2, 1))]), 0, T, **NAMES)


def test_the_delay_margin_of_a_loop_is_where_its_poles_leave_the_unit_circle(controller):
    loop = servo(controller)
    limit = loop.margins().delay
    assert 0.0 < limit < T
    radius = [np.abs(loop.linear(plant=delayed(limit * share)).poles()).max() for share in (0.999, 1.0, 1.001)]
    assert radius[0] < 1.0 < radius[2]
    assert radius[1] == pytest.approx(1.0, abs=1e-9)


def test_runs_decay_below_the_delay_margin_and_grow_above_it(controller):
    limit, fine = servo(controller).margins().delay, T / 50
    for delay, grows in ((np.floor(0.9 * limit / fine) * fine, False), (np.ceil(1.1 * limit / fine) * fine, True)):
        loop = servo(controller, late=delay, std=1e-12, dt=fine, reference=cosim.Step(time=0.001, after=0.01))
        head = np.abs(loop.simulate(0.06, seed=1)["plant.head"] - 0.01)
        middle, end = head[20_000:30_000].max(), head[50_000:].max()
        assert (end > middle) == grows


def test_a_dead_time_of_a_part_of_a_sample_is_in_the_loop(controller):
    plain, late = servo(controller), servo(controller, late=T / 5, dt=T / 5)
    poles = plain.linear(plant=delayed(T / 5)).poles()
    np.testing.assert_allclose(np.abs(late.poles()), np.abs(poles), rtol=1e-6, atol=1e-9)
    margins, expected = late.margins(), plain.linear(plant=delayed(T / 5)).margins()
    assert margins.delay == pytest.approx(plain.margins().delay - T / 5, rel=1e-6)
    assert margins[:2] == pytest.approx(expected[:2], rel=1e-6)


def test_a_plant_in_discrete_time_has_the_margin_of_the_one_that_was_sampled(controller):
    sampled = control.c2d(SERVO, T)
    block = cosim.StateSpace(control.ss(sampled.A, sampled.B, sampled.C, sampled.D, T, **NAMES))
    limit = servo(controller).margins().delay
    assert servo(controller, block).margins().delay == pytest.approx(limit, rel=1e-6)
    assert servo(controller).linear(plant=sampled).margins().delay == pytest.approx(limit, rel=1e-6)
    # A pole at zero is a delay, which has no effect of its own within a sample.
    assert servo(controller).linear(plant=delayed(0.0)).margins().delay == pytest.approx(limit, rel=1e-6)
    assert servo(controller).linear(plant=delayed(T / 5)).margins().delay == pytest.approx(limit - T / 5, rel=0.01)


def slower(delay, every=2):
    """A plant at 0.1 s with a dead time, and a controller at every second step."""
    model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0]], 1e-3, 1e-4, dt=0.2)
    return cosim.closed_loop(
        cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)),
        controllers.LQGController(model, controllers.FixedPrecision()),
        control="u", measured="y", reference=0.0, dt=0.1, **delay,
    )  # fmt: skip


def test_dead_times_are_multiples_of_the_steps_at_which_a_block_reads():
    late, plain = slower({"input_faults": {"u": [cosim.Delay(delay=0.3)]}}), slower({})
    # In the two steps of a sample the plant has the u of two samples before and the last one.
    one = np.array([[0.81, 0.09, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    one[0, 1:] = 0.9 * 0.1, 0.1
    by_hand = control.ss(one, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]], 0, 0.2)
    np.testing.assert_allclose(
        np.sort(np.abs(late.poles())), np.sort(np.abs(plain.linear(plant=by_hand).poles())), atol=1e-9
    )
    with pytest.raises(
        ModelError, match=r"dead time of 0.3 s, which is no multiple of the sample time of 0.2 s at which"
    ):
        slower({"faults": [cosim.Delay(delay=0.3, initial=float("nan"))]}).linear()


@pytest.mark.parametrize("least", [0.0, 1e-4, 0.3])
def test_dead_times_are_exact_at_the_steps_of_a_plant_in_discrete_time(least):
    """A plant with a delay of its own, ten steps a sample, was stable with a dead time of 7 steps, and is not."""
    A, B = np.array([[0.9, 0.1], [0.0, least]]), np.array([[0.0], [1.0]])
    within = interpolated(A, B, 0.1, 10)
    for steps in range(11):
        np.testing.assert_allclose(within.reached(steps / 10), repeated(A, B, steps)[1], atol=1e-9)
    around = [within.reached(0.3 + d) for d in (-1e-6, 1e-6)]
    np.testing.assert_allclose(*around, atol=1e-4)


@pytest.mark.parametrize("lag", [10.0, 100.0, 5000.0])
def test_the_delay_margin_of_a_slow_loop_is_that_of_continuous_time(lag):
    """At 5000 s it was 20 of 125658 samples too long. Holding the input is a delay of half a sample."""
    step, gain = 0.1, 0.5 / lag  # gain / (s (lag s + 1))
    crossover = np.sqrt((np.sqrt(1.0 + 4.0 * (gain * lag) ** 2) - 1.0) / 2.0) / lag
    limit = (np.pi / 2.0 - np.arctan(lag * crossover)) / crossover / step - 0.5
    A, B = np.array([[0.0, 1.0], [0.0, -1.0 / lag]]), np.array([[0.0], [1.0 / lag]])
    loop = Matrices(expm(A * step), np.zeros((2, 1)), np.array([[gain, 0.0]]), np.zeros((1, 1)))
    assert delay_margin(loop, Held(A, B, step).reached) == pytest.approx(limit, rel=2e-6)


@pytest.mark.parametrize("omega", [[1.0, 5.0, 3.0, 10.0], [1.0, np.nan, 10.0], [1.0], [5.0, 1.0]])
def test_frequencies_of_a_bode_plot_must_grow(omega):
    loop = cosim.closed_loop(
        control.ss(-1, 1, 1, 0, inputs=["u"], outputs=["x"]),
        controllers.BayesianController(controllers.LinearModel([[0.99]], [[0.01]], [[1.0]], 1e-4, 1e-2, dt=0.01)),
        control="u", measured="x", sensors=cosim.Sensors(1, 0.1), reference=0.0,
    )  # fmt: skip
    with pytest.raises(ModelError, match="Give frequencies in rad/s that grow"):
        loop.bode(omega=omega)
