"""Sentences about a fit."""

import numpy as np

from bayesftc.cosim.fitting import sentences

STEPS = 1000


def left_out(faulty, late=(), missing=()):
    """Return the sentence about the first of two sensors, with stretches of steps."""
    weights, after_gap, present = np.ones((STEPS, 2)), np.zeros((STEPS, 2), dtype=bool), np.ones((STEPS, 2), dtype=bool)
    for flags, stretches, value in (
        (weights, (*faulty, *late), 0.0),
        (after_gap, late, True),
        (present, missing, False),
    ):
        for begin, end in stretches:
            flags[begin:end, 0] = value
    (sentence,) = sentences.left_out({"x": ("a", "b")}, weights, after_gap & present, present, np.arange(float(STEPS)))
    return sentence


def test_the_longest_stretch_has_no_samples_from_which_the_fmu_has_not_recovered():
    sentence = left_out([(300, 400)], late=[(420, 700)], missing=[(400, 420)])
    assert "10% of its samples are probably faulty" in sentence
    assert "the longest stretch is from 300 to 399 s." in sentence
    assert "the longest stretch is from 700 to 999 s." in left_out([(300, 400), (700, 1000)], late=[(420, 700)])


def test_a_stretch_begins_and_ends_with_a_faulty_sample_and_may_lack_some():
    assert "from 300 to 499 s." in left_out([(300, 400), (420, 500)], missing=[(280, 300), (400, 420), (500, 600)])


def test_an_fmu_that_runs_away_does_not_follow():
    """An unstable plant was recorded under a controller: parameters at their bounds were to get a wider range."""
    t, rng = np.arange(STEPS) / 50.0, np.random.default_rng(0)
    y = 0.05 * np.sin(t)[:, np.newaxis] + 0.005 * rng.standard_normal((STEPS, 2))
    away = np.column_stack([0.05 * np.sin(t), np.minimum(0.001 * np.exp(t), 3.0)])
    (sentence,) = sentences.not_followed(("a", "b"), y, away, np.ones_like(y, dtype=bool))
    assert "far larger than the motion in b (" in sentence
    assert "identify a linear model instead" in sentence
    assert not list(sentences.not_followed(("a",), y, away, np.ones_like(y, dtype=bool)))


def contradicted(drift, near=0.0, blamed=(400, 1000), noise=(0.5, 0.5)):
    """Return the sentences if a counts, with a drift, and b, at this distance from the FMU, does not count for some steps."""
    errors = np.array(noise) * np.random.default_rng(0).standard_normal((STEPS, 2))
    errors[400:] += np.column_stack([drift * np.arange(600) / 600, np.full(600, near)])
    weights, present = np.ones((STEPS, 2)), np.ones((STEPS, 2), dtype=bool)
    weights[slice(*blamed), 1] = 0.0
    given = errors, weights, ~present, present, np.arange(float(STEPS)), {"x": "%"}
    return list(sentences.contradicted({"x": ("a", "b")}, *given))


def test_a_sensor_that_counts_far_from_the_fmu_beside_one_that_does_not_count_near_it_is_named():
    """Of two sensors one drifted slowly: the healthy one was called faulty, without a word that the FMU agreed with it."""
    (sentence,) = contradicted(-30.0)
    assert "contradicts its weights from 400 to 999 s: a, which counts, differs from the FMU by 17" in sentence
    assert "Probably a has failed, and not b. Fit again without the column a" in sentence


def test_no_sensor_is_named_if_the_fmu_does_not_tell_which_is_right():
    assert not contradicted(0.0)  # both are near
    assert not contradicted(-30.0, near=20.0)  # both are far
    assert not contradicted(-30.0, blamed=(400, 404))  # hardly a sample
    assert not contradicted(0.0, near=0.5, noise=(5.0, 0.5))  # the one that counts has more noise
