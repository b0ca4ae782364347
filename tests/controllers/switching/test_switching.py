"""Switching between fault modes: densities and probabilities against scipy, filterpy and enumeration; faults in a loop."""

import copy
import pickle
import re
from ast import literal_eval
from dataclasses import dataclass, fields, replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy import integrate, special, stats

from bayesftc import controllers, scenario
from bayesftc.controllers import (
    Burst,
    Drifting,
    DroppedOut,
    ExplicitDetection,
    Frozen,
    LinearModel,
    Noisier,
    Offset,
    Ramping,
    StateEstimator,
    SwitchingPrecision,
    Unmodelled,
)
from bayesftc.controllers.linalg.special import squared_gamma_half_step
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.controllers.switching import fault_modes
from bayesftc.controllers.switching.default_time import time_at
from bayesftc.controllers.switching.fault_modes import ENTERED, FACTOR, OWN, REPEATS_STRENGTH, SIZE
from bayesftc.controllers.switching.mode_kernels import drops, scatters, shifts
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import argument_names

STEP = 0.02
MODEL = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, [1.0, 4.0], STEP)
MEAN_NOISE = 2.0  # geometric mean, the unit of offsets in the joint form


def test_the_half_step_of_the_gamma_function_is_scipys():
    for a in np.logspace(-3, 6, 200):
        above, below = special.gammaln([a + 0.5, a])  # of which large ones differ by little
        assert np.log(squared_gamma_half_step(a)) / 2 == pytest.approx(above - below, abs=1e-12 + 4e-16 * abs(below))
    assert squared_gamma_half_step(0.5) == pytest.approx(1 / np.pi, rel=1e-12)


def learned(learner, y, nominal=None, spread=None):
    """Call the learning step for each row of y, with innovations from 20; yield fault probabilities and the memory."""
    made = learner.learner(MODEL)
    m, memory = y.shape[1], np.array(made.memory)
    nominal = np.diag([1.0, 4.0]) if nominal is None else nominal
    spread = np.zeros((m, m)) if spread is None else spread
    work, R = np.zeros((made.work, m, m)), np.zeros((m, m))
    used, precision, beta, probability = np.zeros((4, m))
    for row in y:
        present = np.isfinite(row).astype(float)
        e = np.where(present > 0, row - 20.0, 0.0)
        with np.errstate(all="ignore"):
            made.step(
                Sample(row, e, present, spread, nominal),
                Trust(R, used, precision, beta, probability),
                memory,
                made.settings,
                work,
            )
        yield probability.copy(), memory.copy(), R.copy()


def enumerated(y, variance, modes, loss):
    """Return P(fault) at the last sample, by the sum over all sequences of modes of a sensor."""
    frozen, dropped = modes
    enter = [STEP / mode.time_to_fault for mode in modes]
    leave = [STEP / mode.time_to_recovery for mode in modes]
    T = np.array([[1 - sum(enter), *enter], [leave[0], 1 - leave[0], 0], [leave[1], 0, 1 - leave[1]]])
    T[1:] *= 1 - np.array(enter[::-1])[:, None]  # while no second fault begins
    width, dither = 1e-9 * np.sqrt(variance), 2 * frozen.dither**2 * variance
    last, evidence = np.nan, []
    for value in y:
        sent = dropped.arrives * (1 - loss)
        if np.isnan(value):
            evidence.append([loss, loss, 1 - sent])
            continue
        healthy = stats.norm.pdf(value - 20.0, scale=np.sqrt(variance))
        change = value - last
        near = (1 - frozen.repeats) * stats.norm.pdf(change, scale=np.sqrt(dither + width**2 / 6))
        stuck = healthy if np.isnan(change) else frozen.repeats / width if change == 0 else near
        evidence.append([(1 - loss) * healthy, (1 - loss) * stuck, sent * healthy])
        last = value
    total = np.zeros(3)
    for sequence in product(range(3), repeat=len(y)):
        before, p = 0, 1.0
        for mode, told in zip(sequence, evidence, strict=True):
            p *= T[before, mode] * told[mode]
            before = mode
        total[before] += p
    return 1 - total[0] / total.sum()


def test_modes_without_moments_have_the_probabilities_of_all_their_sequences():
    frozen = Frozen(time_to_fault=0.3, time_to_recovery=0.2, healthy_repeats=0)
    modes = (frozen, DroppedOut(time_to_fault=0.5, time_to_recovery=0.1))
    rows = np.array([20.3, 19.1, 19.1, 19.10001, np.nan, np.nan, 21.9, 21.9])
    precision = SwitchingPrecision(modes=modes, loss=(0.1, 0.8), noise_factor=1.0)
    found = learned(precision, np.column_stack([rows, rows[::-1]]))
    for n, (probability, *_) in enumerate(found, start=1):
        expected = [enumerated(rows[:n], 1.0, modes, 0.1), enumerated(rows[::-1][:n], 4.0, modes, 0.8)]
        np.testing.assert_allclose(probability, expected, rtol=1e-9, atol=1e-12)


def jumped(e, nominal, variance):
    """Return the density of an innovation at the onset of an offset of jump 3, or of as much as the innovation itself."""
    return stats.norm.pdf(e, scale=np.sqrt(variance + max(9 * nominal, e * e)))


def test_a_missing_sample_tells_nothing_but_that_it_is_missing():
    """All modes but the drop-out lose samples as often as a healthy sensor: only time passes, whatever a mode would have said."""
    modes = (Offset(10.0, 5.0), Noisier(10.0, 5.0), Frozen(10.0, 5.0))
    rows = np.column_stack([[20.3, 22.5, 17.9, 22.6, np.nan, np.nan, np.nan]] * 2)
    said = [p[0] for p, *_ in learned(SwitchingPrecision(modes, loss=0.3), rows)]
    before, enter, leave, alone = said[3], 3 * STEP / 10.0, STEP / 5.0, 1 - 2 * STEP / 10.0
    assert 0.01 < before < 0.99
    for now in said[4:]:
        whole = before * alone + 1 - before  # while no second fault begins
        before = (before * alone * (1 - leave) + (1 - before) * enter) / whole
        assert now == pytest.approx(before, rel=1e-9)


def test_in_an_outage_of_all_sensors_only_time_passes():
    """A lasting offset is still known after it, and no sensor has dropped out; a sensor that is silent alone has."""
    modes = (Offset(10.0, 5.0), DroppedOut(10.0, 5.0))
    precision = SwitchingPrecision(modes, joint=False, outages=True)
    rows = np.full((60, 2), 20.0) + np.random.default_rng(0).normal(size=(60, 2)) * [1.0, 2.0]
    rows[10:, 0] += 8.0
    rows[40:45], rows[50:, 1] = np.nan, np.nan
    step = controllers.StateEstimator(MODEL, precision, initial_mean=20.0, initial_covariance=0.1).online(
        compiled=False
    )
    outs = [step(y=row, u=0.0) for row in rows]
    fails, recovers = STEP / 10.0, STEP / 5.0
    T = np.array([[1 - 2 * fails, fails, fails], [recovers, 1 - recovers, 0], [recovers, 0, 1 - recovers]])
    T[1:] *= 1 - fails  # while no second fault begins
    for before, now in pairwise(out.mode_probability for out in outs[39:45]):
        np.testing.assert_allclose(now, before @ T / (before @ T).sum(axis=1)[:, None], rtol=1e-9, atol=1e-9)
    assert outs[44].log_density == pytest.approx(np.log((before @ T).sum(axis=1)).sum(), rel=1e-6)
    assert outs[45].mode_probability[0, 1] > 0.99
    assert outs[45].fault_size[0] == pytest.approx(8.0, abs=1.0)
    assert outs[59].mode_probability[1, 2] > 0.99


@pytest.mark.sampled(1)
@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize(
    "others",
    [
        (),
        (Frozen(5.0, 1.0), Noisier(5.0, 1.0), DroppedOut(5.0, 1.0)),
        (Unmodelled(5.0, 10.0),),
        (Ramping(5.0, 10.0),),
    ],
)
def test_a_fault_that_changes_nothing_stays_as_probable_as_it_is_often(others, joint):
    """It became the more probable, the longer none of the other faults was seen, because a faulty sensor could not get them."""
    nothing = Drifting(time_to_fault=10.0, time_to_recovery=1.0, slope=1e-7)
    precision = SwitchingPrecision(
        (nothing, *others), joint=joint, process_modes=(), duration_shape=np.inf, noise_factor=1.0
    )
    model = LinearModel([[0.999]], [[2e-4]], [[1.0]] * 3, 1e-6, 1.0, STEP)
    step = controllers.StateEstimator(model, precision, initial_mean=20.0, initial_covariance=1e-4).online(
        compiled=False
    )
    said = [
        step(y=row, u=100.0).mode_probability[:, 1] for row in 20.0 + np.random.default_rng(0).normal(size=(1500, 3))
    ]
    assert np.mean(said[500:]) == pytest.approx(0.1 / 1.1, rel=0.1)


def test_a_harmless_mode_takes_nothing_from_a_fault_while_a_sensor_is_silent():
    """No sample says that the sensor is not harmless: after a silence the fault is as probable beside `Burst` as without it."""
    rows = np.full((330, 2), np.nan)
    rows[:, 1] = 20.0
    rows[:30, 0] = 28.0
    modes = (Offset(100.0, 20.0), Burst(time_to_fault=1.0, time_to_recovery=0.1))
    last = [list(learned(SwitchingPrecision(of, loss=0.5), rows))[-1][0][0] for of in (modes[:1], modes)]
    assert 0.5 < last[0] < 0.9
    assert last[1] == pytest.approx(last[0], abs=0.02)


@pytest.mark.parametrize(("loss", "silent"), [(0.01, [0]), (0.01, [0, 1]), ((0.01, 0.9, 0.9), [])])
def test_the_last_sensor_that_is_silent_has_dropped_out(loss, silent):
    """The others have dropped out before, or send seldom: that all are silent now is no sign of an outage."""
    count = len(silent) + 1 if silent else 3
    precision = SwitchingPrecision((Offset(), DroppedOut()), joint=False, outages=True, loss=loss)
    model = LinearModel([[0.999]], [[2e-4]], [[1.0]] * count, 0.001, 1.0, STEP)
    step = controllers.StateEstimator(model, precision, initial_mean=20.0, initial_covariance=0.1).online(
        compiled=False
    )
    rows = 20.0 + np.random.default_rng(0).normal(size=(60, count))
    rows[10:, silent] = np.nan
    if not silent:
        rows[np.arange(60) % 10 > 0, 1:] = np.nan
    rows[31:39, -1 if silent else 0] = np.nan
    probability = np.array([step(y=row, u=0.0).fault_probability for row in rows])
    assert probability[30, -1 if silent else 0] < 0.5
    assert probability[38, -1 if silent else 0] > 0.99
    assert (probability[38, silent] > 0.99).all()


@pytest.mark.parametrize("joint", [True, False])
def test_the_density_of_the_samples_is_that_of_all_modes_together(joint):
    """At the first sample: each sensor's densities, weighted; in the joint form the second sensor's after the first one's."""
    mode, P, e = Offset(time_to_fault=1.0, jump=3.0, walk=0.0), 0.5, np.array([4.0, -1.0])
    precision = SwitchingPrecision(modes=(mode,), joint=joint, loss=0.1, process_modes=(), noise_factor=1.0)
    estimator = controllers.StateEstimator(MODEL, precision, initial_mean=20.0, initial_covariance=P)
    out = estimator.online(compiled=False)(y=20.0 + e, u=0.0)
    R, enter = np.array([1.0, 4.0]), STEP / mode.time_to_fault
    alone = 0.9 * ((1 - enter) * stats.norm.pdf(e, scale=(P + R) ** 0.5))
    alone += 0.9 * enter * np.array([jumped(*row) for row in zip(e, R, P + R, strict=True)])
    if not joint:
        assert out.log_density == pytest.approx(np.log(alone).sum(), rel=1e-9)
        return
    together = 0.0
    for first, second in ((0.0, 0.0), (18.0, 0.0), (0.0, 18.0)):  # both at once do not begin with one sample
        S = P + np.diag(R + np.array([first, second]))
        weight = enter if first or second else 1 - 2 * enter
        together += weight * stats.multivariate_normal.pdf(e, cov=S)
    assert out.log_density == pytest.approx(np.log(0.81 * together), rel=1e-9)


@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize("share", [0.001, 0.02, 0.3])
def test_the_density_of_a_repeated_sample_is_its_probability_over_the_resolution(joint, share):
    """Whatever share of its samples a healthy sensor repeats: it does so where its noise is probable."""
    frozen = Frozen(time_to_fault=1.0, time_to_recovery=0.5, resolution=1e-6, healthy_repeats=share)
    precision = SwitchingPrecision(modes=(frozen,), joint=joint, loss=0.1, process_modes=(), noise_factor=1.0)
    model = LinearModel([[1.0]], [[1.0]], [[1.0], [1.0]], 1e-15, [1.0, 4.0], STEP)
    online = controllers.StateEstimator(model, precision, initial_mean=20.0, initial_covariance=1e-15).online(
        compiled=False
    )
    for _ in range(2):
        out = online(y=[20.7, np.nan], u=0.0)
    enter, leave = STEP / 1.0, STEP / 0.5
    failed = enter * (1 - leave) + (1 - enter) * enter
    repeats = share * REPEATS_STRENGTH / (REPEATS_STRENGTH + 1 - enter)
    healthy = repeats * stats.norm.pdf(0.7) * np.sqrt(2 * np.pi * np.e)
    mass = 0.9 * (failed * frozen.repeats + (1 - failed) * healthy) * 0.1
    assert out.log_density == pytest.approx(np.log(mass / 1e-6), rel=1e-7)


@pytest.mark.parametrize("begins", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("present", [0.0, 1.0])
def test_an_offset_is_filtered_as_filterpy_does_from_the_merged_prior(begins, present):
    nominal, variance, e = 4.0, 4.7, 6.0
    jump, slope, walk = 25.0 * nominal, 0.04 * nominal, 0.01 * nominal
    memory, settings = np.zeros(OWN + 4), np.array([25.0, 0.04, 0.01, 1.0])
    mean, P = np.array([2.0, 0.3]), np.array([[3.0, 0.2], [0.2, 0.1]])
    memory[ENTERED], memory[SIZE], memory[OWN] = begins, *mean
    memory[OWN + 1 :] = P[0, 0], P[0, 1], P[1, 1]
    healthy = stats.norm.logpdf(e, scale=np.sqrt(variance))
    told = shifts(e, present, variance, nominal, np.nan, healthy, memory, 0, settings, 0) + np.log(memory[FACTOR])
    filtered = KalmanFilter(2, 1)
    filtered.F, filtered.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    filtered.Q, filtered.R, filtered.x, filtered.P = np.diag([walk, 0.0]), np.array([[variance]]), mean[:, None], P
    filtered.predict()
    new = np.array([[jump + slope, slope], [slope, slope]])
    old, around = filtered.x[:, 0], begins * (1 - begins)
    filtered.P = (1 - begins) * filtered.P + begins * new + around * np.outer(old, old)
    filtered.x = (1 - begins) * filtered.x
    expected = stats.norm.logpdf(e, filtered.x[0, 0], np.sqrt(variance + filtered.P[0, 0]))
    if present:
        filtered.update(e)
    assert told == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose([memory[SIZE], memory[OWN]], filtered.x[:, 0], rtol=1e-12)
    np.testing.assert_allclose(memory[OWN + 1 :], filtered.P[[0, 0, 1], [0, 1, 1]], rtol=1e-9)


def test_noise_of_unknown_precision_has_the_density_of_numerical_integration():
    a, b, variance = 1.7, 12.0, 2.0
    for e in (0.0, 0.5, 4.0, 30.0):
        memory = np.array([0.0] * OWN + [a, b])
        healthy = stats.norm.logpdf(e, scale=np.sqrt(variance))
        told = scatters(e, 1.0, variance, 1.0, np.nan, healthy, memory, 0, np.array([1.0, 16.0, 1.0]), 0)
        told += np.log(memory[FACTOR])
        density, _ = integrate.quad(
            lambda w, e=e: stats.norm.pdf(e, scale=np.sqrt(variance / w)) * stats.gamma.pdf(w, a, scale=1 / b),
            0,
            np.inf,
        )
        assert told == pytest.approx(np.log(density), rel=1e-7)
        np.testing.assert_allclose(memory[OWN:], [a + 0.5, b + 0.5 * e * e / variance], rtol=1e-12)


def test_the_first_sample_is_bayes_rule():
    """An offset is expected to be as large as the first innovation, 4, if it is believed smaller."""
    modes = (Offset(time_to_fault=1.0, jump=3.0), Noisier(time_to_fault=2.0))
    precision = SwitchingPrecision(modes=modes, noise_factor=1.0)
    probability, _, R = next(learned(precision, np.array([[24.0, 20.0]]), spread=0.5 * np.eye(2)))
    S, enter = np.array([1.5, 4.5]), np.array([STEP / 1.0, STEP / 2.0])
    for i, e in enumerate((4.0, 0.0)):
        nominal = (1.0, 4.0)[i]
        noisy = stats.t.pdf(e / np.sqrt(S[i] * 16.0), 2) / np.sqrt(S[i] * 16.0)
        told = np.array(
            [
                stats.norm.pdf(e, scale=np.sqrt(S[i])),
                stats.norm.pdf(e, scale=np.sqrt(S[i] + max(9 * MEAN_NOISE, e * e))),
                noisy,
            ]
        )
        weights = told * [1 - enter.sum(), *enter]
        weights /= weights.sum()
        assert probability[i] == pytest.approx(1 - weights[0], rel=1e-9)
        trust = weights[0] + weights[2] * min(1.0, 1.5 / (16.0 + 0.5 * e * e / S[i]))
        assert R[i, i] == pytest.approx(nominal / trust, rel=1e-9)


def car(kind, precision, steps=400, begins=150, ends=300, seed=0):
    """Run the car with one faulty sensor in plain Python; yield the outputs."""
    rng, x, last = np.random.default_rng(seed), 20.0, np.nan
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, STEP)
    step = controllers.BayesianController(model, precision=precision, initial_mean=20.0).online(compiled=False)
    for k in range(steps):
        y = x + rng.normal(size=2)
        noise = rng.normal()
        if begins <= k < ends:
            y[0] = {
                "healthy": y[0],
                "Frozen": last,
                "Offset": y[0] + 5.0,
                "Drifting": y[0] + 0.05 * (k - begins),
                "Ramping": y[0] + 0.4 * (k - begins),
                "Noisier": y[0] + 5.0 * noise,
                "Unmodelled": 20.0 + 5.0 * np.sin(2 * np.pi * k / 80),
                "DroppedOut": np.nan,
                "dither": last + 0.01 * noise,
            }[kind]
        last = y[0]
        out = step(y=y, goal=[20.0 + 5.0 * np.sin(STEP * k)])
        yield out, x
        x = 0.999 * x + 2e-4 * out.u[0] + 0.03 * rng.normal()


def test_the_onset_of_a_jump_is_its_sample_beside_another_fault():
    """In the hypothesis of the other fault a small old belief in an offset must not make the jump older."""
    model = LinearModel([[0.999]], [[0.0]], [[1.0]] * 3, 1e-3, [0.09, 0.09, 0.64], dt=STEP)
    errors = []
    for seed in range(8):
        rng, x = np.random.default_rng(seed), 0.0
        step = StateEstimator(model, SwitchingPrecision()).online()
        for k in range(400):
            x = 0.999 * x + 0.03 * rng.normal()
            y = x + np.array([0.3, 0.3, 0.8]) * rng.normal(size=3)
            y[0] += 0.02 * max(k - 50, 0)
            y[2] += 6.0 * (k >= 300)
            out = step(y=y)
        errors.append(out.fault_onset[2] / STEP - 300)
    assert np.abs(errors).max() < 3.0


NUMBERS = {type(mode).__name__: 1 + k for k, mode in enumerate(SwitchingPrecision().modes)}


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("kind", "mode"),
    [(name, name) for name in NUMBERS] + [("dither", "Frozen")],
)
def test_the_kind_of_fault_is_told_with_its_size_and_onset(kind, mode):
    # A drift of 0.05 standard deviations per sample is nearly as probable a ramp: how large these are must be known.
    precision = SwitchingPrecision(noise_factor=1.0 if kind == "Drifting" else 3.0)
    outs = [out for out, _ in car(kind, precision)]
    during, after = outs[160:299], outs[310:]
    if kind == "Drifting":  # it grows by 2.5 standard deviations a second, so at first nothing shows
        during, after = outs[250:299], outs[320:]
    assert np.mean([out.fault_kind[0] == NUMBERS[mode] for out in during]) > 0.97
    assert np.mean([out.fault_probability[0] > 0.9 for out in during]) > 0.97
    assert np.mean([out.fault_probability[0] < 0.1 for out in after]) > 0.95
    assert np.mean([out.fault_probability[1] < 0.1 for out in outs]) > 0.97
    assert outs[250].fault_onset[0] == pytest.approx(150 * STEP, abs=1.0 if kind == "Drifting" else 0.1)
    if kind in {"Offset", "Noisier"}:
        assert outs[290].fault_size[0] == pytest.approx(5.0, abs=1.0)
    for out in outs:
        np.testing.assert_allclose(out.mode_probability.sum(axis=1), 1.0, rtol=1e-9)
        np.testing.assert_allclose(1 - out.mode_probability[:, 0], out.fault_probability, atol=1e-12)


def glitches(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    return settings[first] + 0.0 * e


@dataclass(frozen=True)
class Glitching(controllers.FaultMode):
    """A mode of a user's: any value within a given range."""

    span: float = 200.0

    evidence = glitches

    def settings(self, model, sensor):
        """Return the logarithm of the density."""
        return (-np.log(self.span),)


def test_a_mode_of_ones_own():
    learner = SwitchingPrecision((Glitching(time_to_fault=60.0), Frozen(time_to_fault=60.0)), noise_factor=1.0)
    rows = np.array([[20.1, 20.3], [75.0, 19.0], [-31.0, 22.0]])
    probabilities = [p for p, *_ in learned(learner, rows)]
    chance = (STEP / 60.0) / 200.0
    healthy = (1 - 2 * STEP / 60.0) * stats.norm.pdf(0.1)
    assert probabilities[0][0] == pytest.approx(
        1 - healthy / (healthy + chance + STEP / 60.0 * stats.norm.pdf(0.1)), rel=1e-9
    )
    assert probabilities[2][0] > 0.999
    assert probabilities[2][1] < 0.01


@pytest.mark.sampled(3)
@pytest.mark.parametrize("mode", controllers.FAULT_MODES, ids=lambda c: c.__name__)
def test_every_listed_mode_is_tried_and_runs_and_can_be_said(mode, tmp_path):
    """Beside an offset, in both forms; a scenario file says it by its name."""
    for joint in (True, False):
        precision = SwitchingPrecision((mode(time_to_fault=60.0), Offset()), joint=joint)
        assert precision.learner(MODEL).memory.size
        step = controllers.StateEstimator(MODEL, precision, initial_mean=20.0).online(compiled=False)
        for y in ([20.3, 19.8], [20.3, np.nan], [25.0, 21.0]):
            out = step(y=y, u=[100.0])
            assert np.isfinite(out.fault_probability).all()
            np.testing.assert_allclose(out.mode_probability.sum(axis=1), 1.0, rtol=1e-9)
    text = scenario.load_scenario("cruise_control").path.read_text(encoding="utf-8")
    text = text[: text.index("[controller.precision]")] + '[controller.precision]\nkind = "SwitchingPrecision"\n'
    file = tmp_path / "car.toml"
    file.write_text(f'{text}modes = [{{ kind = "{mode.__name__}", time_to_fault = 9 }}]\n', encoding="utf-8")
    assert scenario.load_scenario(file).controller.precision.modes == (mode(time_to_fault=9.0),)


def test_the_page_and_the_module_say_how_a_mode_is_called():
    page = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "extend.md").read_text(encoding="utf-8")
    arguments = f"({', '.join(argument_names(drops))})"
    assert arguments in page
    assert arguments in fault_modes.__doc__


@pytest.mark.parametrize("mode", controllers.FAULT_MODES, ids=lambda c: c.__name__)
def test_the_table_of_modes_has_their_defaults(mode):
    page = (Path(__file__).resolve().parents[3] / "docs" / "explanation" / "precision.md").read_text(encoding="utf-8")
    rows = re.findall(rf"^\| `{mode.__name__}` \|.* = .*$", page, re.M)
    assert len(rows) == 1, (
        f"docs/explanation/precision.md needs one row for {mode.__name__}, with each default as `name` = value"
    )
    (row,) = rows
    told = {name: literal_eval(value) for name, value in re.findall(r"`(\w+)` = ([\d.]+|\([\d., ]+\))", row)}
    times = {"time_to_fault": 300.0, "time_to_recovery": 10.0}
    assert {**times, **told} == {field.name: getattr(mode(), field.name) for field in fields(mode)}


def of_ones_own(base, **attributes):
    """Return a mode of a class Wrong, a subclass of ``base`` with these attributes."""
    return dataclass(frozen=True)(type("Wrong", (base,), attributes))()


def renamed(e, present, variance, noise, change, healthy, memory, at, settings, first):
    return healthy


def swapped(e, present, nominal, variance, change, healthy, memory, at, settings, first):
    return healthy


def silent(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    memory[at + SIZE] = e


def unknown(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    return memory[at + SIZE] * e


def grasping(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    return healthy + memory[at + OWN]


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({}, "fault mode Wrong has no step function; give the class one: evidence.e, present,"),
        ({"evidence": 3}, "Wrong.evidence: A step function must be a plain Python function"),
        ({"evidence": lambda e, *rest: e}, r"Wrong.evidence: .* no \*args"),
        ({"evidence": lambda self, e: e}, "Wrong.evidence has the arguments self, e; it must be"),
        ({"evidence": renamed}, "Wrong.evidence has the arguments e, present, variance, noise,"),
        ({"evidence": swapped}, "in this order: evidence.e, present, variance, nominal,"),
        ({"evidence": silent}, "Wrong.evidence returned None; it must return one number"),
        ({"evidence": grasping}, "Wrong.evidence uses an index .* has 6 numbers"),
        ({"evidence": glitches}, "Wrong.evidence uses an index .* and 0 from settings"),
        ({"evidence": glitches, "settings": lambda self, model, i: "no"}, "The result of Wrong.settings is 'no'"),
        (
            {"evidence": glitches, "settings": lambda self, model: (1.0,)},
            r"Wrong.settings is called as settings\(model, sen",
        ),
        ({"evidence": glitches, "settings": (1.0,)}, r"Wrong.settings is \(1.0,\); it must be a method"),
        ({"evidence": unknown}, "Wrong.evidence returned nan for an ordinary sample"),
        ({"evidence": glitches, "first": (0.0,)}, "Wrong.first is .* at least two numbers"),
        ({"evidence": glitches, "first": lambda self: (0.0, 0.0)}, "Wrong.first .* must be a property"),
    ],
)
def test_a_mode_of_ones_own_that_cannot_be_compiled_is_refused_in_a_sentence(attributes, words):
    with pytest.raises(ModelError, match=words):
        SwitchingPrecision([of_ones_own(controllers.FaultMode, **attributes)]).learner(MODEL)


def test_arguments_are_looked_at_before_there_is_a_model():
    with pytest.raises(ModelError, match=r"Wrong\.evidence has the arguments"):
        SwitchingPrecision([of_ones_own(Offset, evidence=swapped)])


def test_a_hypothesis_of_its_own_is_for_subclasses_of_unmodelled():
    """The joint form reads the settings of such a mode as those of an `Unmodelled`, whatever they are."""
    attributes = {"evidence": glitches, "own_hypothesis": True, "settings": lambda self, model, sensor: (1.0,)}
    with pytest.raises(ModelError, match=r"Wrong has own_hypothesis = True.* derive it from Unmodelled, or leave"):
        SwitchingPrecision([of_ones_own(controllers.FaultMode, **attributes)])
    assert SwitchingPrecision([of_ones_own(Unmodelled)]).learner(MODEL).memory.size


@pytest.mark.slow
def test_a_resolution_explains_equal_samples():
    """Rounded to its standard deviation a healthy sensor repeats itself in a quarter of the samples: no freeze.

    Where it is not given, only a learned share of repetitions explains them (``test_unmodelled.py``).
    """
    rows = 20.0 + np.round(np.random.default_rng(5).normal(size=(2000, 2)))
    assert (np.diff(rows[:, 0]) == 0).mean() > 0.2
    for resolution, share in ((1.0, 0.02), (0.0, None)):
        modes = (Frozen(resolution=resolution, healthy_repeats=0), Offset(), Noisier(), DroppedOut())
        alarms = np.mean([p[0] > 0.5 for p, *_ in learned(SwitchingPrecision(modes=modes), rows)])
        assert alarms < share if share else alarms > 0.1


def test_each_sensor_has_its_resolution():
    """Both repeat themselves; of the one with a fine resolution that is a freeze."""
    rows = np.tile([[20.0], [20.0], [20.5], [21.0], [21.0], [20.5]], (50, 2))
    modes = (Frozen(resolution=[0.5, 0.0], healthy_repeats=0),)
    *_, (probability, *_) = learned(SwitchingPrecision(modes=modes), np.vstack([rows, rows[-2:-1], rows[-2:-1]]))
    assert probability[0] < 0.1 < 0.9 < probability[1]
    assert Frozen(resolution=[0.5, 0.0]) == Frozen(resolution=(0.5, 0.0))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("joint", [True, False])
def test_a_harmless_mode_is_no_part_of_the_fault_probability(joint):
    modes = (Offset(), controllers.Burst())
    outs = [out for out, _ in car("Noisier", SwitchingPrecision(modes, joint=joint), 170)]
    for out in outs:
        np.testing.assert_allclose(out.fault_probability, out.mode_probability[:, 1], rtol=1e-12)
    assert max(out.mode_probability[0, 2] for out in outs[155:]) > 0.9
    assert min(out.precision[0] for out in outs[155:]) < 0.5


@pytest.mark.slow
def test_a_sensor_whose_offset_is_known_informs_though_its_own_precision_is_near_zero():
    model = LinearModel([[0.999]], [[2e-4]], [[1.0], [1.0]], 0.001, 1.0, STEP)
    alone = LinearModel([[0.999]], [[2e-4]], [[1.0]], 0.001, 1.0, STEP)
    steps = [
        controllers.StateEstimator(of, precision, initial_mean=20.0).online(compiled=False)
        for of, precision in (
            (model, SwitchingPrecision()),
            (model, controllers.FixedPrecision()),
            (alone, controllers.FixedPrecision()),
        )
    ]
    rng, x = np.random.default_rng(0), 20.0
    for k in range(500):
        y = x + rng.normal(size=2) + [8.0 * (k >= 100), 0.0]
        known, both, one = (step(y=y[2 - size :], u=[0.0]) for step, size in zip(steps, (2, 2, 1), strict=True))
        x = 0.999 * x + 0.001**0.5 * rng.normal()
    assert known.precision[0] < 1e-9
    assert both.P[0, 0] < known.P[0, 0] < (both.P[0, 0] + one.P[0, 0]) / 2


@pytest.mark.slow
def test_insurance_costs_nothing_on_healthy_sensors():
    """To learn the noise costs a little, until it is known after 4 s."""
    squares = []
    for precision in (controllers.FixedPrecision(), SwitchingPrecision(), SwitchingPrecision(noise_factor=1.0)):
        runs = [car("healthy", precision, 1000, seed=seed) for seed in range(3)]
        squares.append(np.square([[out.x_hat[0] - x for out, x in run] for run in runs]))
    fixed, learned, believed = squares
    assert believed.mean() < 1.01 * fixed.mean()
    assert learned[:, 200:].mean() < 1.01 * fixed[:, 200:].mean()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: SwitchingPrecision(modes=()), "at least one"),
        (lambda: SwitchingPrecision(modes=3), "modes=3; give a list of fault modes"),
        (lambda: SwitchingPrecision(modes="Offset"), "modes='Offset'; give a list of fault modes"),
        (lambda: SwitchingPrecision(modes=Offset()), "give a list of fault modes"),
        (lambda: SwitchingPrecision(modes=("Offset",)), "give a list of fault modes"),
        (lambda: SwitchingPrecision(modes=(Frozen(), Offset)), r"the class Offset; .*: Offset\(\)"),
        (lambda: SwitchingPrecision(modes=(controllers.FaultMode(),)), "FaultMode has no step function"),
        (lambda: SwitchingPrecision(loss=0.0), "loss=0.0"),
        (lambda: SwitchingPrecision(loss=(0.1, 1.5)), "loss=1.5"),
        (lambda: SwitchingPrecision(loss=()), r"loss=\(\)"),
        (lambda: SwitchingPrecision(loss=(0.1, 0.1, 0.1)).learner(MODEL), "must be a vector of 2"),
        (
            lambda: SwitchingPrecision(modes=(Offset(time_to_fault=0.01),)).learner(MODEL),
            "not longer than the sample time of .*; give more seconds",
        ),
        (lambda: SwitchingPrecision(modes=(Offset(0.03), Frozen(0.03))).learner(MODEL), "too short: lengthen time_to_"),
        (lambda: SwitchingPrecision(modes=(Offset(0.03),)).learner(MODEL), "for the joint form .* or take joint=False"),
        (lambda: Offset(jump=-1.0), "Offset has jump=-1.0"),
        (lambda: Frozen(repeats=1.0), "repeats=1.0"),
        (lambda: Frozen(resolution=(0.1, -1.0)), "resolution=-1.0"),
        (lambda: Frozen(resolution="fine"), "resolution='fine'"),
        (
            lambda: SwitchingPrecision(modes=(Frozen(resolution=(0.1, 0.1, 0.1)),)).learner(MODEL),
            "resolution of Frozen has the shape",
        ),
        (lambda: Noisier(forgetting=0.0), "forgetting=0.0"),
        (lambda: DroppedOut(time_to_fault="soon"), "time_to_fault='soon'"),
        (lambda: Unmodelled(scale=0.0), "Unmodelled has scale=0.0"),
        (lambda: Unmodelled(forgetting=1.5), "Unmodelled has forgetting=1.5"),
        (
            lambda: Unmodelled(means=(0.0, 0.8)),
            r"means of Unmodelled has the shape \(2,\); it must be a vector of 3",
        ),
        (lambda: Unmodelled(deviations=(3.0, 0.0, 0.3)), "Unmodelled has deviations=0.0"),
        (lambda: SwitchingPrecision(noise_factor=0.5), "noise_factor=0.5"),
        (lambda: SwitchingPrecision(noise_strength=0.0), "noise_strength=0.0"),
        (lambda: SwitchingPrecision(noise_forgetting=1.1), "noise_forgetting=1.1"),
    ],
)
def test_bad_settings(make, words):
    with pytest.raises(ModelError, match=words):
        make()


@pytest.mark.parametrize("step", [2e-5, 0.001, 0.02, 0.1, 30.0, 86400.0])
def test_default_times_follow_the_step_and_given_ones_stay(step):
    longer = max(min(1.0, step / 0.005), step / 0.02)
    every = [mode() for mode in controllers.FAULT_MODES if mode is not controllers.Burst]
    actuators = [mode() for mode in controllers.ACTUATOR_MODES]
    default = SwitchingPrecision(every, actuator_modes=actuators)
    paced = default.paced(step)
    assert paced == default.slowed(longer) == paced.paced(step)  # what is a number now stays
    given = SwitchingPrecision([Offset(time_to_fault=300.0), Frozen(time_to_recovery=7.0)]).paced(step).modes
    assert [(mode.time_to_fault, mode.time_to_recovery) for mode in given] == [
        (300.0, 10.0 * longer),
        (300.0 * longer, 7.0),
    ]
    (burst,) = SwitchingPrecision([controllers.Burst()]).paced(step).modes
    assert burst.time_to_recovery == pytest.approx(
        max(min(0.3, 60 * step), 3 * step)
    )  # a bump lasts as long however it is sampled
    model = replace(MODEL, dt=step)
    np.testing.assert_array_equal(default.learner(model).settings, default.slowed(longer).learner(model).settings)


def test_default_times_survive_a_copy_of_their_mode():
    for mode in (
        pickle.loads(pickle.dumps(controllers.Burst())),
        copy.deepcopy(controllers.Burst()),
        replace(Offset()),
    ):
        assert time_at(mode.time_to_fault, 30.0) > 100 * mode.time_to_fault


def test_a_time_that_was_given_is_refused_where_samples_are_further_apart():
    model = replace(MODEL, dt=30.0)
    with pytest.raises(ModelError, match=r"Offset has time_to_recovery=20.0, .* 30 s"):
        SwitchingPrecision([Offset(time_to_recovery=20.0)]).learner(model)


@pytest.mark.parametrize(
    ("loss", "before", "every", "expected"),
    [
        (0.01, (1, 1), (1, 1), 0.01),
        (0.01, (1, 1), (1, 10), (0.01, 0.901)),
        ((0.01, 0.95), (1, 1), (1, 10), (0.01, 0.95)),  # it counts the pauses already
        ((0.01, 0.901), (1, 10), (1, 10), (0.01, 0.901)),
        ((0.01, 0.901), (1, 10), (1, 4), (0.01, 0.7525)),
        ((0.01, 0.9), (1, 10), (1, 1), (0.01, 0.01)),  # of which none was for losses
    ],
)
def test_the_loss_of_a_slow_sensor_counts_the_steps_between_its_samples(loss, before, every, expected):
    learner = SwitchingPrecision(loss=loss)
    assert learner.for_rates(every, before).loss == pytest.approx(expected)
    wrapped = ExplicitDetection(learner, threshold=0.5).for_rates(every, before)
    assert wrapped.learning == learner.for_rates(every, before)


@pytest.mark.parametrize("every", [2, 10, 50])
def test_a_slow_sensor_that_is_back_has_no_alarm_between_its_samples(every):
    """A sensor that has dropped out sends as rarely of what is due, however slow it is."""
    model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.01)
    step = controllers.StateEstimator(model, SwitchingPrecision().for_rates((1, every), (1, 1))).online()
    rng, p = np.random.default_rng(every), []
    for k in range(60 * every):
        due = k % every == 0 and not 20 <= k // every < 40
        y = 0.1 * rng.standard_normal(2) + [0.0, 0.0 if due else np.nan]
        p.append(float(step(y=y, u=[0.0]).fault_probability[1]))
    begins = np.flatnonzero(np.diff(np.array([0.0, *p]) >= 0.5)) / every
    assert len(begins) == 2
    assert 25 <= begins[0] <= 29
    assert begins[1] == 40


def test_rarer_faults_are_rarer_at_every_sample_time():
    """Default times stay default ones; times of harmless and process modes, and of recoveries, do not change."""
    learner = SwitchingPrecision([Frozen(), Offset(time_to_fault=3600.0), controllers.Burst()])
    for step in (0.001, 0.02, 300.0):
        usual, rare = learner.paced(step), learner.rarer(100.0).paced(step)
        for one, other in zip(usual.modes, rare.modes, strict=True):
            factor = 1.0 if isinstance(one, controllers.Burst) else 100.0
            assert other.time_to_fault == pytest.approx(factor * one.time_to_fault)
            assert other.time_to_recovery == one.time_to_recovery
        assert rare.process_modes == usual.process_modes
