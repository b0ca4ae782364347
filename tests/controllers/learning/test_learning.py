"""Learning from recorded runs: expected counts by enumeration, sizes by dense Gaussians, resolutions, and whole streams."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import signal, stats

from bayesftc.controllers import (
    Drifting,
    DroppedOut,
    FixedPrecision,
    Frozen,
    LinearModel,
    Noisier,
    Offset,
    Ramping,
    RecordedRun,
    SwitchingPrecision,
    find_resolution,
    learn_modes,
)
from bayesftc.controllers.learning.kernels import measure_offsets, measure_scatter, smooth
from bayesftc.cosim.errors import ModelError

STEP = 0.02
KNOWN = {"initial_mean": 20.0, "initial_covariance": 1e-20}
"""Of a state that is known and never moves, so that samples depend on their own mode and the last sample only."""


def still(*noise):
    m = len(noise)
    return LinearModel([[1.0]], [[0.0]], [[1.0]] * m, 1e-20, np.square(noise), STEP)


def densities(y, modes, loss):
    """Return the density of each sample (rows) if its sensor is healthy, frozen, dropped out."""
    frozen, dropped = modes
    width, last, sent = 1e-9, np.nan, dropped.arrives * (1 - loss)
    for value in y:
        if np.isnan(value):
            yield [loss, loss, 1 - sent]
            continue
        healthy, change = stats.norm.pdf(value - 20.0), value - last
        spread = np.sqrt(2 * frozen.dither**2 + width**2 / 6)
        near = (1 - frozen.repeats) * stats.norm.pdf(change, scale=spread)
        stuck = healthy if np.isnan(change) else frozen.repeats / width if change == 0 else near
        yield [(1 - loss) * healthy, (1 - loss) * stuck, sent * healthy]
        last = value


def enumerated(y, modes, loss):
    """Return the density of all samples, and for each mode the mean numbers of onsets, recoveries, healthy and faulty steps."""
    enter, leave = ([STEP / getattr(mode, f"time_to_{what}") for mode in modes] for what in ("fault", "recovery"))
    T = np.array([[1 - sum(enter), *enter], [leave[0], 1 - leave[0], 0], [leave[1], 0, 1 - leave[1]]])
    T[1:] *= 1 - np.array(enter[::-1])[:, None]  # while no second fault begins
    told, counts, total = list(densities(y, modes, loss)), np.zeros((4, 2)), 0.0
    for sequence in product(range(3), repeat=len(y)):
        path = (0, *sequence)
        p = np.prod([T[a, b] * of[b] for a, b, of in zip(path, sequence, told, strict=False)])
        total += p
        for k in (1, 2):
            moves = list(zip(path, sequence, strict=False))
            counts[:, k - 1] += p * np.array(
                [moves.count((0, k)), moves.count((k, 0)), path[:-1].count(0), path[:-1].count(k)]
            )
    return np.log(total), counts / total


FEW = (
    Frozen(time_to_fault=0.3, time_to_recovery=0.2, healthy_repeats=0),
    DroppedOut(time_to_fault=0.5, time_to_recovery=0.1),
)
ROWS = np.array([20.3, 19.1, 19.1, 19.1001, np.nan, np.nan, 21.9])


def test_what_is_expected_is_the_mean_over_all_sequences_of_modes():
    start = SwitchingPrecision(FEW, loss=0.1, noise_factor=1.0)
    learned = learn_modes([RecordedRun(ROWS[:, None], **KNOWN)], still(1.0), start, iterations=1)
    likelihood, counts = enumerated(ROWS, FEW, 0.1)
    assert learned.log_likelihood == pytest.approx([likelihood], rel=1e-9)
    np.testing.assert_allclose(learned.onsets, counts[0], rtol=1e-9)
    np.testing.assert_allclose(learned.recoveries, counts[1], rtol=1e-9)
    np.testing.assert_allclose(learned.faulty, STEP * counts[3], rtol=1e-9)
    assert learned.healthy == pytest.approx(STEP * counts[2, 0], rel=1e-9)
    for start, now, (onsets, recoveries, healthy, faulty) in zip(FEW, learned.precision.modes, counts.T, strict=True):
        assert now.time_to_fault == pytest.approx((STEP * healthy + 0.5 * start.time_to_fault) / (onsets + 0.5))
        assert now.time_to_recovery == pytest.approx(
            (STEP * faulty + 0.5 * start.time_to_recovery) / (recoveries + 0.5)
        )


def broken(seed, modes, steps, m=2, walk=0.0):
    """Return samples of sensors that fail at random in the ways of the modes, and the number of the mode (0: healthy).

    The state stays at 20, or moves by a random walk that returns to 20.
    """
    rng = np.random.default_rng(seed)
    chances = np.cumsum([STEP / mode.time_to_fault for mode in modes])
    state = 20.0 + signal.lfilter([1.0], [1.0, -0.999], walk * rng.standard_normal(steps))
    y, kinds = state[:, None] + rng.standard_normal((steps, m)), np.zeros((steps, m), dtype=int)
    for i in range(m):
        now, offset, rate, scale = 0, 0.0, 0.0, 1.0
        for t in range(steps):
            if now and rng.random() < STEP / modes[now - 1].time_to_recovery:
                now = 0
            elif not now and (now := int(np.searchsorted(chances, rng.random()) + 1) % (len(modes) + 1)):
                mode = modes[now - 1]
                jump, slope, shape = (getattr(mode, name, 1.0) for name in ("jump", "slope", "shape"))
                offset, rate = jump * rng.standard_normal(), slope * rng.standard_normal()
                scale = getattr(mode, "scale", 1.0) / np.sqrt(rng.gamma(shape) / shape)
            mode = modes[now - 1] if now else None
            kinds[t, i] = now
            if isinstance(mode, Frozen):
                y[t, i] = y[max(t - 1, 0), i]
            elif isinstance(mode, Offset):
                offset += rate
                y[t, i] += offset
            elif isinstance(mode, Noisier):
                y[t, i] = state[t] + scale * (y[t, i] - state[t])
            elif isinstance(mode, DroppedOut):
                y[t, i] = np.nan
    return y, kinds


def realised(modes, kinds):
    """Return for each mode the number of onsets and the mean times in seconds to a fault and to recovery that there were."""
    for k in range(1, len(modes) + 1):
        onsets = int(((kinds[1:] == k) & (kinds[:-1] != k)).sum())
        yield onsets, STEP * (kinds == 0).sum() / onsets, STEP * (kinds == k).sum() / onsets


def wrong(modes, factor):
    """Return the modes with all times and sizes wrong by a factor."""
    names = ("time_to_fault", "time_to_recovery", "jump", "slope", "scale")
    return [replace(m, **{n: factor * getattr(m, n) for n in names if hasattr(m, n)}) for m in modes]


def test_the_density_never_falls_where_nothing_is_approximated():
    # Of a lossy sensor, so that silence does not say all.
    modes = (Frozen(2.0, 0.5, healthy_repeats=0), DroppedOut(2.0, 0.5, arrives=0.3))
    y, _ = broken(3, modes, 600)
    start = SwitchingPrecision(wrong(modes, 5.0), loss=0.2, noise_factor=1.0)
    learned = learn_modes([RecordedRun(y, **KNOWN)], still(1.0, 1.0), start, compiled=True)
    assert learned.settled
    assert len(learned.log_likelihood) > 2
    assert np.diff(learned.log_likelihood).min() > -0.01  # of what is believed before, half a fault
    assert learned.log_likelihood[-1] > learned.log_likelihood[0] + 5.0


@pytest.mark.slow
def test_times_and_sizes_are_found_from_a_start_that_is_wrong_by_a_factor_of_five():
    modes = (Frozen(2.0, 0.5), Offset(1.0, 1.0, jump=5.0, walk=0.0), DroppedOut(2.0, 0.5))
    runs, kinds = zip(*(broken(seed, modes, 6000) for seed in (7, 8)), strict=True)
    times = list(realised(modes, np.vstack(kinds)))
    for factor in (0.2, 1.0, 5.0):
        # Noise that is learned at the same time also changes the likelihood.
        start = SwitchingPrecision(wrong(modes, factor), joint=False, noise_factor=1.0)
        learned = learn_modes([RecordedRun(y, **KNOWN) for y in runs], still(1.0, 1.0), start, compiled=True)
        assert learned.settled
        for now, (onsets, *true) in zip(learned.precision.modes, times, strict=True):
            assert onsets > 100
            # Some offsets are too small to be seen.
            np.testing.assert_allclose(np.log([now.time_to_fault, now.time_to_recovery]), np.log(true), atol=0.35)
        assert learned.precision.modes[1].jump == pytest.approx(5.0, rel=0.3)
        assert np.diff(learned.log_likelihood).min() > -1e-3 * abs(learned.log_likelihood[0])
        assert factor == 1.0 or learned.log_likelihood[-1] > learned.log_likelihood[0] + 500.0


@pytest.mark.slow
def test_a_mode_that_never_shows_gets_rare_and_stays_possible():
    y = 20.0 + np.random.default_rng(0).standard_normal((500, 2))
    modes = (Frozen(5.0), Offset(20.0), Ramping(7.0))
    for joint in (False, True):
        learned = learn_modes([RecordedRun(y, **KNOWN)], still(1.0, 1.0), SwitchingPrecision(modes, joint=joint))
        frozen, offset, ramping = learned.precision.modes
        assert frozen.time_to_fault == pytest.approx(2 * 20.0 + 5.0, rel=0.05)
        assert 20.0 < offset.time_to_fault < 2 * 20.0 + 20.0
        assert (ramping == modes[2]) == (not joint)  # where it takes no part nothing is learned of it


@pytest.mark.parametrize(("jump", "slope", "walk"), [(5.0, 0.0, 0.1), (0.0, 0.3, 0.0), (3.0, 0.2, 0.05)])
def test_sizes_are_those_of_the_gaussian_posterior(jump, slope, walk):
    rng, steps, onset, end, nominal = np.random.default_rng(1), 12, 3, 9, 2.0
    e, variance = rng.normal(4.0, 2.0, (steps, 1)), rng.uniform(2.0, 3.0, (steps, 1))
    e[5] = np.nan
    begun, lasts, totals = np.zeros((steps, 1, 1)), np.ones((steps, 1, 1)), np.zeros(3)
    begun[onset], lasts[end] = 0.7, 0.0
    squares = np.square([jump, slope, walk])
    measure_offsets(begun, lasts, e, variance, np.array([nominal]), 0, *squares, totals)
    # Unknown: the jump, the slope, and each step of the walk.
    seen = [t for t in range(onset, end + 1) if np.isfinite(e[t, 0])]
    reads = np.array([[1.0, t - onset + 1.0, *(t >= s for s in range(onset + 1, end + 1))] for t in seen])
    prior = nominal * np.diag([*squares[:2], *[squares[2]] * (end - onset)])
    gain = prior @ reads.T @ np.linalg.inv(reads @ prior @ reads.T + np.diag(variance[seen, 0]))
    mean, left = gain @ e[seen, 0], prior - gain @ reads @ prior
    expected = (mean**2 + np.diag(left))[:2] / nominal
    np.testing.assert_allclose(totals, 0.7 * np.array([1.0, *expected]), rtol=1e-9, atol=1e-15)


def test_the_precision_at_the_onset_is_that_of_the_gamma_posterior():
    e, variance = np.array([[3.0], [np.nan], [-5.0], [9.0]]), np.full((4, 1), 2.0)
    begun, lasts, totals = np.zeros((4, 1, 1)), np.ones((4, 1, 1)), np.zeros(3)
    begun[0], lasts[2] = 0.4, 0.0
    measure_scatter(begun, lasts, e, variance, 0, 1.5, 6.0, 1.0, totals)
    np.testing.assert_allclose(totals[:2], [0.4, 0.4 * (1.5 + 1.0) / (6.0 + (9.0 + 25.0) / 4.0)], rtol=1e-12)


def test_the_pass_backward_is_one_of_probabilities():
    """What is expected sums up to what it is of: as many samples as there are, as many onsets as recoveries but for the last."""
    rng = np.random.default_rng(2)
    filtered = rng.dirichlet([5.0, 1.0, 0.5], (50, 3))
    begun, lasts = np.empty((2, 50, 3, 2))
    counts = np.zeros((4, 2))
    chances = np.array([[0.01, 0.02], [0.9, 0.94], [0.09, 0.05]])
    smooth(filtered, chances, begun, lasts, counts)
    np.testing.assert_allclose(counts[2] + counts[3].sum(), 150.0, rtol=1e-12)
    np.testing.assert_allclose(counts[0] - counts[1], filtered[-1, :, 1:].sum(axis=0), rtol=1e-9)
    assert ((lasts >= 0) & (lasts <= 1)).all()


@pytest.mark.parametrize("scale", [0.5, 3.0, 30.0])
@pytest.mark.parametrize("resolution", [1.0, 0.01 / 3.6])
def test_a_resolution_is_found_among_faults_and_rounding(resolution, scale):
    rng = np.random.default_rng(4)
    y = 30.0 + np.cumsum(0.05 * rng.standard_normal(5000)) * resolution
    y = np.round((y + scale * resolution * rng.standard_normal(5000)) / resolution) * resolution
    y[1000:1200] = y[1000]
    y[2000:2100] += 0.3137 * resolution
    y[3000:3010] = np.nan
    assert find_resolution(np.float32(y).astype(float)) == pytest.approx(resolution, rel=1e-3)


def test_a_sensor_without_a_resolution_has_none():
    rng = np.random.default_rng(5)
    for y in (rng.standard_normal(5000), np.cumsum(rng.standard_normal(200)), np.zeros(100), [1.0, 2.0, 3.0], []):
        assert find_resolution(y) == 0.0


def test_equal_samples_beyond_the_resolution_are_freezes():
    """Each sensor gets its own resolution; that of the coarse one explains its repetitions."""
    rng = np.random.default_rng(6)
    y = 20.0 + np.column_stack([np.round(rng.standard_normal(900)), rng.standard_normal(900)])
    y[400:430, 1] = y[400, 1]
    assert (np.diff(y[:, 0]) == 0).mean() > 0.2
    learned = learn_modes([RecordedRun(y, **KNOWN)], still(1.0, 1.0), SwitchingPrecision((Frozen(),)), compiled=True)
    assert learned.precision.modes[0].resolution == pytest.approx((1.0, 0.0), rel=1e-6)
    assert learned.onsets[0] == pytest.approx(1.0, abs=0.2)
    assert learned.faulty[0] == pytest.approx(30 * STEP, rel=0.1)
    given = SwitchingPrecision((Frozen(resolution=0.5),))
    learned = learn_modes([RecordedRun(y, **KNOWN)], still(1.0, 1.0), given, iterations=1, compiled=True)
    assert learned.precision.modes[0].resolution == 0.5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: learn_modes([], still(1.0)), "no recording"),
        (lambda: learn_modes([RecordedRun([[1.0, 2.0]])], still(1.0)), r"Recording 0 has y of shape \(1, 2\)"),
        (lambda: learn_modes([RecordedRun([1.0, 2.0])], still(1.0)), r"steps x 1 sensors"),
        (lambda: learn_modes([RecordedRun([["a"]])], still(1.0)), "Recording 0: y is"),
        (lambda: learn_modes([RecordedRun([[1.0]], [[1.0, 2.0]])], still(1.0)), r"u of shape \(1, 2\).*1 steps x 1"),
        (lambda: learn_modes([RecordedRun([[1.0]])], still(1.0), FixedPrecision()), "modes of a SwitchingPrecision"),
        (lambda: learn_modes([RecordedRun([[1.0]])], still(1.0), iterations=0), "iterations=0"),
        (lambda: learn_modes([RecordedRun([[1.0]])], None), "needs a LinearModel"),
        (
            lambda: learn_modes(RecordedRun([[1.0]]), still(1.0)),
            "has recordings of the type RecordedRun; give a list of",
        ),
        (lambda: learn_modes([[[1.0]]], still(1.0)), "has a recording of the type list; give a list of Rec"),
        (lambda: learn_modes(3, still(1.0)), "has recordings of the type int; give a list of Rec"),
        (
            lambda: learn_modes(still(1.0), [RecordedRun([[1.0]])]),
            r"LinearModel after the recordings, not .* the type list\.$",
        ),
        (lambda: learn_modes([RecordedRun([[1.0]])], SwitchingPrecision(), still(1.0)), r"not of a LinearModel\.$"),
        (lambda: find_resolution("fine"), "The samples is 'fine'"),
    ],
)
def test_mistakes_are_named(call, words):
    with pytest.raises(ModelError, match=words):
        call()


def test_the_scale_of_the_noise_is_found():
    rng = np.random.default_rng(9)
    y = 20.0 + rng.standard_normal((900, 2))
    for begin in range(50, 850, 200):
        y[begin : begin + 100, 0] += 6.0 * rng.standard_normal(100)
    start = SwitchingPrecision((Noisier(5.0, 2.0, scale=20.0),))
    learned = learn_modes([RecordedRun(y, **KNOWN)], still(1.0, 1.0), start, compiled=True)
    assert learned.onsets[0] == pytest.approx(4.0, abs=0.5)
    assert learned.precision.modes[0].scale == pytest.approx(37**0.5, rel=0.25)


@pytest.mark.slow
def test_all_modes_are_learned_within_the_sampling_error():
    """A table of ``docs/explanation/precision.md``: three sensors for 4000 s, a state that moves, right and wrong beginnings."""
    modes = (
        Frozen(200.0, 5.0),
        Offset(100.0, 10.0, jump=5.0, walk=0.0),
        Drifting(200.0, 10.0),
        Noisier(200.0, 10.0, shape=5.0),
        DroppedOut(300.0, 5.0),
    )
    y, kinds = broken(1, modes, 200_000, m=3, walk=0.001**0.5)
    model = LinearModel([[0.999]], [[2e-4]], [[1.0]] * 3, 0.001, 1.0, STEP)
    run = RecordedRun(y - 20.0, initial_covariance=1.0)
    for factor in (1.0, 5.0, 0.2):
        learned = learn_modes([run], model, SwitchingPrecision(wrong(modes, factor)))
        assert learned.log_likelihood[-1] > learned.log_likelihood[0]
        for true, now, (onsets, *times) in zip(modes, learned.precision.modes, realised(modes, kinds), strict=True):
            near = 0.1 + 2.0 / np.sqrt(onsets)
            np.testing.assert_allclose(np.log([now.time_to_fault, now.time_to_recovery]), np.log(times), atol=near)
            sizes = [(n, getattr(true, n), getattr(now, n)) for n in ("jump", "slope", "scale") if getattr(true, n, 0)]
            for name, size, its in sizes:
                # Of offsets some are too small to be told from drifts, which look slower and more frequent for it.
                assert abs(np.log(its / size)) < near + 0.25 * (name == "slope"), name
