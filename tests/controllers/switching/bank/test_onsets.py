"""Faults of actuators and unexpected motions that begin while a sensor has an offset."""

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st

from bayesftc import controllers, cosim
from bayesftc.controllers.switching.bank.hypothesis import OFFSET_AGE, STATE
from bayesftc.controllers.switching.bank.layout import Layout
from bayesftc.controllers.switching.bank.merges import OLD, make_describe, make_gather, make_receive_new
from bayesftc.controllers.switching.mode_kernels import AGE, ENTERED, OWN, SIZE, WEIGHT
from bayesftc.controllers.switching.sensor_kernels import ENDS, FIRST, FIRST_SETTINGS, HEALTHY

LAYOUT = Layout(
    n=2, m=3, p=1, plant=2, kinds=(1, 2, 1), becomes=(0, 1, 0), slow=(0, 0, 0), lost=(), quantity=(0, 0, 0), groups=(),
    common=-1, kick=-1, fades=(), alone=(5, 0, 0), other=(5, 10, 10), faults=(1, 1, 1), actuator_modes=1, process_modes=0,
    width=10, width_of_settings=9,
)  # fmt: skip

STD = (0.3, 1.5, 0.5, 0.05)


def random_bank(rng):
    """Return the memory of a bank whose hypotheses are all about as probable, with any beliefs."""
    memory = LAYOUT.start(np.zeros(LAYOUT.m * LAYOUT.sensor))
    memory = np.concatenate([np.zeros(LAYOUT.actuators), memory])
    N = LAYOUT.n + 2
    for h in range(LAYOUT.hypotheses):
        at = LAYOUT.first + h * LAYOUT.length
        memory[at], memory[at + OFFSET_AGE] = rng.uniform(0.05, 0.1), rng.uniform(0, 500)
        memory[at + STATE : at + STATE + N] = rng.normal(size=N)
        root = rng.normal(size=(N, N))
        memory[at + STATE + N : at + LAYOUT.kept] = (root @ root.T).ravel()
        for i in range(LAYOUT.m):
            of_sensor = at + LAYOUT.kept + i * LAYOUT.sensor
            memory[of_sensor : of_sensor + LAYOUT.sensor] = rng.normal(size=LAYOUT.sensor)
            weights = rng.dirichlet(np.ones(4))
            memory[of_sensor + HEALTHY] = weights[0]
            memory[of_sensor + FIRST + WEIGHT : of_sensor + LAYOUT.sensor : LAYOUT.width] = weights[1:]
    return memory


def test_the_belief_before_an_onset_is_the_mixture_of_all_hypotheses_it_may_follow():
    memory = random_bank(np.random.default_rng(1))
    n, N = LAYOUT.n, LAYOUT.n + 2
    offsets = [(i, q) for i in range(3) for q in range(2)]  # the third kind is the first sample of a jump
    places = [LAYOUT.first] + [LAYOUT.first + (1 + 3 * i + q) * LAYOUT.length for i, q in offsets]
    p, age = memory[places], memory[[at + OFFSET_AGE for at in places]]
    settings = np.zeros(LAYOUT.elsewhere)
    for i in range(3):
        for k in (1, 2):
            settings[i * LAYOUT.row + FIRST_SETTINGS + k * LAYOUT.width_of_settings + ENDS] = 0.02 * k
    ends = [np.nan] + [0.02 * LAYOUT.kinds[q] for _, q in offsets]
    old = np.array([1.0, *((age * ends / (age * ends + OLD)) ** 4)[1:]])
    z = np.array([memory[at + STATE : at + STATE + N] for at in places])
    P = np.array([memory[at + STATE + N : at + LAYOUT.kept].reshape(N, N) for at in places])
    for (i, q), at in zip(offsets, places[1:], strict=True):
        make_describe(LAYOUT)(memory, at, i, LAYOUT.kinds[q])
    assert make_gather(LAYOUT)(memory, settings, 0.25) == pytest.approx((old * p)[1:].sum())
    np.testing.assert_allclose(memory[places[1:]], (p * (1 - 0.25 * old))[1:])

    p = p * old  # young offsets count little
    before, part = LAYOUT.before, p / p.sum()
    assert memory[before] == pytest.approx(p.sum())
    mean = part @ z[:, :n]
    apart = z[:, :n] - mean
    covariance = np.einsum("h,hab->ab", part, P[:, :n, :n]) + np.einsum("h,ha,hb->ab", part, apart, apart)
    np.testing.assert_allclose(memory[before + STATE : before + STATE + n], mean, rtol=1e-12)
    found = memory[before + STATE + N : before + LAYOUT.kept].reshape(N, N)[:n, :n]
    np.testing.assert_allclose(found, covariance, rtol=1e-12)

    for i in range(3):
        of_sensor = LAYOUT.kept + i * LAYOUT.sensor
        healthy = sum(
            share * (0.0 if h and offsets[h - 1][0] == i else memory[at + of_sensor + HEALTHY])
            for h, (share, at) in enumerate(zip(part, places, strict=True))
        )
        assert memory[before + of_sensor + HEALTHY] == pytest.approx(healthy)
    # The own offset of hypothesis 1, of sensor 0: its share of the mode, and what the mode then is.
    block = LAYOUT.kept + FIRST + LAYOUT.width
    at = places[1]
    assert memory[at + block + WEIGHT] == 1.0
    assert memory[at + block + AGE] == age[1] + 1.0
    expected = [z[1, n], z[1, n + 1], P[1, n, n], P[1, n, n + 1], P[1, n + 1, n + 1]]
    np.testing.assert_array_equal(memory[[at + block + a for a in (SIZE, OWN, OWN + 1, OWN + 2, OWN + 3)]], expected)
    weights = part * memory[[at + block + WEIGHT for at in places]]
    assert memory[before + block + WEIGHT] == pytest.approx(weights.sum())
    sizes = memory[[at + block + SIZE for at in places]]
    assert memory[before + block + SIZE] == pytest.approx(weights @ sizes / weights.sum())


@given(seed=st.integers(0, 100), probability=st.floats(1e-130, 1.0), incoming=st.floats(1e-130, 1.0))
def test_no_offset_begins_with_more_than_its_own_probability(seed, probability, incoming):
    """However improbable the hypothesis is: the share that has just begun was above 1 by rounding, and the belief was lost."""
    rng = np.random.default_rng(seed)
    memory = random_bank(rng)
    at = LAYOUT.first + LAYOUT.first_actuator * LAYOUT.length
    memory[at] = probability
    begun = [
        at + LAYOUT.kept + i * LAYOUT.sensor + FIRST + k * LAYOUT.width + ENTERED for i in range(3) for k in (1, 2)
    ]
    memory[begun] = rng.choice([0.0, 1e-70, 0.5, 1.0], 6)
    before = memory[begun].copy()
    make_receive_new(LAYOUT)(memory, at, incoming, 0.0, 1.0)
    assert (memory[begun] <= before * (1 + 1e-12)).all()
    assert (memory[begun] >= 0.0).all()


def steered(faults, gust, seeds, **options):
    """Yield the outputs of a ship's controller from 150 s on, when its rudder has a gust for 15 s, and the largest error.

    A Nomoto model of 12 s with three compasses and a rate gyro.
    """
    ship = control.ss(
        [[0, 1], [0, -1 / 12]], [[0], [0.01]], np.eye(2), 0, inputs=["rudder"], outputs=["heading", "rate"]
    )
    controller = controllers.design(
        ship, measured=["heading", "rate"], sensors=[3, 1], sensor_std=STD, actuated="rudder", goal="heading", dt=0.2,
        acceptable_error=2.0, acceptable_control=10.0, u_min=-35.0, u_max=35.0, noise={"rudder": 1.0}, disturbance=0.01,
        **options,
    )  # fmt: skip
    loop = cosim.closed_loop(
        ship, controller, control="rudder", measured=["heading", "rate"], faults=faults,
        sensors=cosim.Sensors(count=[3, 1], std=STD), reference=cosim.Pulse(amplitude=20.0, period=120.0),
        input_faults={"rudder": [cosim.Bias(magnitude=gust, start=150.0, stop=165.0)]},
    )  # fmt: skip
    for seed in seeds:
        result = loop.simulate(175.0, seed=seed)
        during = result.time >= 150.0
        heading, estimate = result["plant.heading"].ravel()[during], result["controller.x_hat"][during, 0]
        yield (
            lambda name, result=result, during=during: result[f"controller.{name}"][during],
            np.abs(heading - estimate).max(),
        )


DRIFTING = cosim.Drift(sensor=0, start=80.0, stop=180.0, slope=0.05)
OFFSET = cosim.Bias(sensor=0, start=80.0, stop=180.0, magnitude=3.0)


@pytest.mark.parametrize("fault", [DRIFTING, OFFSET], ids=lambda fault: type(fault).__name__)
def test_an_actuator_fault_is_found_while_the_most_precise_sensor_has_an_offset(fault):
    """It was never found: its hypothesis began only from the one without any fault."""
    precision = controllers.SwitchingPrecision(actuator_modes=[controllers.InputOffset()])
    for output, error in steered([fault], 10.0, range(20, 23), precision=precision):
        assert output("actuator_fault_probability").max() > 0.95
        blamed = 0.2 * (output("fault_probability")[:, 1:] > 0.5).sum(axis=0)
        assert blamed.max() < 5.0
        assert error < 0.5


def test_an_unexpected_motion_beside_an_offset_is_followed_about_as_well_as_without_it():
    """The error was three times that of healthy sensors."""
    healthy, drifting = (
        np.mean([error for _, error in steered(faults, 20.0, range(20, 26))]) for faults in ([], [DRIFTING])
    )
    assert drifting < 1.3 * healthy
