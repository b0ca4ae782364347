"""The exact fault probabilities of short sequences: by dense Gaussians, closed forms and integrals; and how far ours are."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, special, stats

from bayesftc import controllers
from bayesftc.reproduce.experiments.probabilities import exact_cases as _exact_cases
from bayesftc.reproduce.experiments.probabilities.exact import (
    Regressed,
    Shifted,
    Silent,
    Stuck,
    World,
    on_a_grid,
    probabilities,
)
from bayesftc.reproduce.experiments.probabilities.exact_cases import APART, DEFAULT, JOINT, OFTEN, ROWS
from bayesftc.reproduce.settings import Car, Probabilities, Tracking
from bayesftc.reproduce.shared.car import model
from bayesftc.reproduce.shared.ensemble import Ensemble

TWO = World(0.9, 0.3, 20.0, 0.5, np.array([1.0, 4.0]), begins=0.2, ends=0.3, loss=0.1)
ONE = replace(TWO, noise=np.array([1.0]))
SAMPLES = np.array([[21.0, 19.0], [23.5, 18.0], [22.0, 21.0], [24.0, 19.5]])


def moments(world, steps):
    """Return mean and covariance of the state over time."""
    mean = world.mean * world.decay ** np.arange(steps)
    variance = [world.variance]
    while len(variance) < steps:
        variance.append(world.decay**2 * variance[-1] + world.process_variance)
    k = np.arange(steps)
    early = np.minimum.outer(k, k)
    return mean, np.array(variance)[early] * world.decay ** np.abs(np.subtract.outer(k, k))


def chance(world, failed):
    """Return the probability of which sensors have failed when, an array of shape (steps, sensors)."""
    p = 1.0
    for before, now in zip(np.vstack([np.zeros_like(failed[:1]), failed]), failed, strict=False):
        for b, f in zip(before, now, strict=True):
            begins = 1 - world.ends if b else world.begins
            p *= begins if f else 1 - begins
    return p


def enumerated(world, samples, density):
    """Return the fault probabilities at the last sample, given the density of all samples if sensors have failed so."""
    total, share = 0.0, np.zeros(samples.shape[1])
    for flat in product((False, True), repeat=samples.size):
        failed = np.array(flat).reshape(samples.shape)
        weight = chance(world, failed) * density(failed)
        total, share = total + weight, share + weight * failed[-1]
    return share / total


def episodes(failed):
    """Yield first and last step of each fault of a sensor."""
    begins = [k for k, f in enumerate(failed) if f and not (k and failed[k - 1])]
    for begin in begins:
        healthy = [k for k in range(begin, len(failed)) if not failed[k]]
        yield begin, healthy[0] if healthy else len(failed)


def read(world, samples, where):
    """Return the density of those samples that read the state, by one dense Gaussian."""
    mean, covariance = moments(world, len(samples))
    k, i = np.nonzero(where)
    if not len(k):
        return 1.0
    S = covariance[np.ix_(k, k)] + np.diag(world.noise[i])
    return stats.multivariate_normal.pdf(samples[k, i], mean[k], S)


@pytest.mark.parametrize("seen", [False, True])
@pytest.mark.parametrize(
    "mode",
    [
        controllers.Offset(jump=1.5, walk=0.2),
        controllers.Ramping(slope=0.7),
        controllers.Offset(jump=2.0, slope=0.5, walk=0.3),
    ],
)
def test_offsets_are_those_of_a_dense_gaussian(mode, seen):
    """All samples as one normal vector; the size that is seen from the state's mean given all earlier samples."""
    rows = SAMPLES[:3]
    mean, covariance = moments(TWO, len(rows))

    def density(failed):
        S = np.kron(covariance, np.ones((2, 2))) + np.diag(np.tile(TWO.noise, len(rows)))
        faults = sorted((begin, i, end) for i in range(2) for begin, end in episodes(failed[:, i]))
        for begin, i, end in faults:
            earlier = np.arange(2 * begin)
            cross = np.repeat(covariance[begin, :begin], 2)
            error = rows.ravel()[earlier] - np.repeat(mean[:begin], 2)
            e = rows[begin, i] - mean[begin] - cross @ np.linalg.solve(S[np.ix_(earlier, earlier)], error)
            jump = mode.jump**2 * TWO.noise[i]
            if seen and mode.jump:
                jump = max(jump, e * e)
            for k, j in product(range(begin, end), repeat=2):
                slope = mode.slope**2 * TWO.noise[i] * (k - begin + 1) * (j - begin + 1)
                S[2 * k + i, 2 * j + i] += jump + slope + mode.walk**2 * TWO.noise[i] * (min(k, j) - begin)
        return stats.multivariate_normal.pdf(rows.ravel(), np.repeat(mean, 2), S)

    found = probabilities(TWO, Shifted(mode, seen), rows)
    np.testing.assert_allclose(found[-1], enumerated(TWO, rows, density), rtol=1e-9)


def test_silence_and_samples_that_come_all_the_same():
    rows, mode = SAMPLES.copy(), controllers.DroppedOut(arrives=0.25)
    rows[1:3, 0] = rows[2:, 1] = np.nan
    there = ~np.isnan(rows)

    def density(failed):
        sends = (1 - TWO.loss) * np.where(failed, mode.arrives, 1)
        return np.where(there, sends, 1 - sends).prod() * read(TWO, rows, there)

    np.testing.assert_allclose(probabilities(TWO, Silent(mode), rows)[-1], enumerated(TWO, rows, density), rtol=1e-9)


@pytest.mark.parametrize("healthy", [0.0, 0.02])
def test_repetitions_of_failed_and_healthy_sensors(healthy):
    """A healthy sensor repeats samples as often as a beta distributed share says, which counts as ten samples."""
    mode = controllers.Frozen(repeats=0.8, dither=0.05, resolution=0.2, healthy_repeats=healthy)
    rows = np.array([[21.0, 19.0], [21.0, 18.9], [21.3, 18.9], [21.3, 20.0]])
    equal = np.vstack([[False, False], np.abs(np.diff(rows, axis=0)) <= 0.1])
    change = np.vstack([[np.nan, np.nan], np.diff(rows, axis=0)])
    spread = 2 * mode.dither**2 * TWO.noise + 0.2**2 / 6
    repeated = np.where(equal, mode.repeats / 0.2, (1 - mode.repeats) * stats.norm.pdf(change, scale=spread**0.5))

    def density(failed):
        stuck = failed & ~np.isnan(change)
        told = repeated[stuck].prod()
        if not healthy:
            return told * read(TWO, rows, ~stuck)
        a, b = 10 * healthy, 10 * (1 - healthy)
        for i in range(2):
            n, of = (equal[:, i] & ~failed[:, i]).sum(), (~failed[:, i]).sum()
            told *= special.beta(a + n, b + of - n) / special.beta(a, b) / 0.2**n
        # With the first sample nothing can be repeated yet, whatever has failed.
        share = np.where(failed[0], a / 10, 0.0)
        return told * (1 - share).prod() * read(TWO, rows, ~stuck & ~equal)

    np.testing.assert_allclose(probabilities(TWO, Stuck(mode), rows)[-1], enumerated(TWO, rows, density), rtol=1e-9)


def test_a_course_of_its_own_has_the_evidence_of_the_regression():
    """In closed form, of all innovations of a fault at once (Murphy 2007); each from the state's mean given what is healthy."""
    mode, rows = controllers.Unmodelled(forgetting=1.0, fading=0.8), SAMPLES[:, :1]
    mean, covariance = moments(ONE, len(rows))
    prior, first = np.diag(np.square(mode.deviations) ** -1.0), np.array(mode.means)
    some, others = mode.repeats_strength * np.array([mode.repeats, 1 - mode.repeats])

    def density(failed):
        told = read(ONE, rows, ~failed)
        r, predicted = np.zeros(len(rows)), np.zeros(len(rows))
        for k in range(len(rows)):
            earlier = np.flatnonzero(~failed[:k, 0])
            S = covariance[np.ix_(earlier, earlier)] + np.eye(len(earlier))
            predicted[k] = mean[k] + covariance[k, earlier] @ np.linalg.solve(S, rows[earlier, 0] - mean[earlier])
            r[k] = rows[k, 0] - predicted[k]
        level = np.zeros(len(rows))
        for k in range(1, len(rows)):
            level[k] = 0.8 * level[k - 1] + predicted[k] - predicted[k - 1]
        for begin, end in episodes(failed[:, 0]):
            own = slice(begin, end)
            X = np.column_stack([np.ones(end - begin), np.append(0.0, r)[own], level[own]])
            after, a = prior + X.T @ X, mode.shape + 0.5 * (end - begin)
            middle = np.linalg.solve(after, prior @ first + X.T @ r[own])
            b0 = mode.shape * mode.scale**2
            b = b0 + 0.5 * (first @ prior @ first + r[own] @ r[own] - middle @ after @ middle)
            told *= (2 * np.pi) ** (-0.5 * (end - begin)) * b0**mode.shape / b**a
            told *= (np.linalg.det(prior) / np.linalg.det(after)) ** 0.5
            told *= special.gamma(a) / special.gamma(mode.shape)
            told *= special.beta(some, others + end - begin) / special.beta(some, others)  # none is a repetition
        return told

    np.testing.assert_allclose(probabilities(ONE, Regressed(mode), rows)[-1], enumerated(ONE, rows, density), rtol=1e-9)


def test_the_grid_is_numerical_integration():
    mode, rows = controllers.Noisier(), np.array([[24.0], [12.0]])
    mean, covariance = moments(ONE, 2)

    def density(failed):
        def given(w):
            S = covariance + np.diag(np.where(failed[:, 0], 1 / w, 1.0))
            gauss = stats.multivariate_normal.pdf(rows[:, 0], mean, S, allow_singular=True)
            return gauss * stats.gamma.pdf(w, 1.0, scale=1 / 16.0)

        if not failed.any():
            return read(ONE, rows, ~failed)
        return integrate.quad(lambda s: given(np.exp(s)) * np.exp(s), -14.0, 4.0, epsrel=1e-10)[0]

    np.testing.assert_allclose(on_a_grid(ONE, mode, rows)[-1], enumerated(ONE, rows, density), rtol=1e-5)


def table():
    """Return what docs/explanation/precision.md says: by mode, pace and form the largest difference."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "explanation" / "precision.md").read_text(encoding="utf-8")
    part = page.split("## How far from the exact posterior")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `?([^`|]+?)`?(, [^|]+?)? \| (.+) \|$", part, re.M)
    columns = [(DEFAULT, JOINT), (DEFAULT, APART), (OFTEN, JOINT), (OFTEN, APART)]
    return {
        name + more: dict(zip(columns, (re.match(r"[\d.]*", cell)[0] for cell in cells.split(" | ")), strict=True))
        for name, more, cells in rows
        if name + more in ROWS
    }


def check(name, settings, paces, low=0.0):
    """Assert that no difference is larger than the page says, which rounds to three digits, nor below the part ``low`` of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_exact_cases, "ROWS", {name: ROWS[name]})
        patch.setattr(_exact_cases, "paces", lambda settings, row: {pace: PACES(settings, row)[pace] for pace in paces})
        found = _exact_cases.distances(settings, model(Car()), Tracking.constant, Ensemble(0))[name]
    told = table()[name]
    for pace, form in product(paces, (JOINT, APART)):
        if form not in found[pace]:
            assert told[pace, form] == ""
            continue
        of = found[pace][form]
        said = float(told[pace, form])
        assert low * said - 0.0005 <= of["largest"] <= said + 0.0005
        assert max(each["largest"] for each in of["by_size"].values()) == of["largest"]


PACES = _exact_cases.paces


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ROWS)
def test_the_differences_are_no_larger_than_the_page_says(name):
    """On the first of its sequences, with faults as frequent as in the detection experiment."""
    check(name, Probabilities(sequences=3), [OFTEN])


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_the_differences_are_those_of_the_page(name):
    check(name, Probabilities(), [DEFAULT, OFTEN], low=1.0)


def test_what_is_exact_is_within_what_was_aimed_at():
    """A repetition and a silence have their exact probability; the page says so of no others."""
    close = {name for name, of in table().items() if all(float(v or 0) <= Probabilities().close for v in of.values())}
    assert close == {"Frozen(healthy_repeats=0)", "DroppedOut"}
    settings = Probabilities(sequences=3, sizes=(("Frozen", (1.0,)), ("DroppedOut", (1.0,))))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_exact_cases, "ROWS", {name: ROWS[name] for name in ("Frozen(healthy_repeats=0)", "DroppedOut")})
        found = _exact_cases.distances(settings, model(Car()), Tracking.constant, Ensemble(7))
    for of in found.values():
        for pace in (DEFAULT, OFTEN):
            for form in (JOINT, APART):
                assert of[pace][form]["largest"] < 0.02


def test_the_first_variance_is_that_of_a_filter_that_has_run_for_long():
    step = controllers.StateEstimator(model(Car()), controllers.FixedPrecision(), initial_mean=20.0).online(
        compiled=False
    )
    for _ in range(400):
        out = step(y=[20.0, 20.0], u=[0.0])
    decay, added = 0.999, 0.001
    assert _exact_cases.settled_variance(model(Car())) == pytest.approx(decay**2 * out.P[0, 0] + added, rel=1e-6)
