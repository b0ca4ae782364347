"""Innovations of many explanations at once are those of each observer's recursion, sample by sample."""

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.estimation.observers import observers


def by_recursion(model, bank, k, recording, moved):
    """Whitened innovations (T x m) of the k-th observer under one explanation, and the predicted states."""
    A, C = model.matrix("A"), model.matrix("C")
    white, states = np.zeros_like(recording.y), []
    for t, y in enumerate(recording.y):
        if t in recording.begins:
            x = recording.mean
        states.append(x)
        e = np.where(np.isfinite(y), y - C @ x, 0.0)
        white[t] = bank.whiten[k] @ e
        x = A @ x + bank.gain[k] @ e + moved[t]
    return white, np.array(states)


@pytest.mark.parametrize(("samples", "begins"), [(1, (0,)), (2, (0, 1)), (7, (0,)), (203, (0, 50, 53, 190))])
def test_they_are_those_of_the_recursion(samples, begins):
    rng = np.random.default_rng(samples)
    A, C = np.array([[1.0, 0.1], [-0.2, 0.9]]), np.array([[1.0, 0.0]] * 3 + [[0.0, 1.0]] * 2)
    models = [controllers.LinearModel(A * f, [[0.0], [1.0]], C, 1e-3, 0.01, dt="0.1") for f in (1.0, 0.97)]
    banks = [observers(model, ((0, 2, 3), (1, 4))) for model in models]
    y = 3.0 * rng.standard_normal((samples, 5))
    y[rng.random(y.shape) < 0.1] = np.nan
    recording = Recording(y, np.zeros((samples, 1)), rng.standard_normal(2), begins)
    moved = rng.standard_normal((2, 4, samples, 2))
    whites, predicted = innovations(models, banks, recording, moved)
    mean = 0.0
    for model, bank, white, pushes in zip(models, banks, whites, moved, strict=True):
        for k in range(2):
            expected = [by_recursion(model, bank, k, recording, push) for push in pushes]
            assert np.allclose(white[k, :4], [e for e, _ in expected], rtol=1e-12, atol=1e-11)
            mean = mean + expected[0][1] / 2 * (model is models[0])
    assert np.allclose(predicted, mean, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("first", [0, 1, 30, 49, 60, 202])
def test_before_the_first_push_nothing_is_computed_and_all_is_zero(first):
    rng, begins = np.random.default_rng(first), (0, 50, 53, 190)
    model = controllers.LinearModel([[1.0, 0.1], [-0.2, 0.9]], [[0.0], [1.0]], np.eye(2), 1e-3, 0.01, dt="0.1")
    bank = observers(model, ((0, 1),))
    moved = np.where(np.arange(203)[:, np.newaxis] < first, 0.0, rng.standard_normal((1, 4, 203, 2)))
    recording = Recording(np.zeros((203, 2)), np.zeros((203, 1)), np.zeros(2), begins)
    whole, late = (innovations([model], [bank], recording, moved, k)[0][0][:, :4] for k in (0, first))
    assert np.allclose(late, whole, rtol=1e-12, atol=1e-12)
    assert whole.any() == (first < 202)  # a push at the last sample moves no other one


def test_a_column_is_the_response_to_an_error_of_a_state_where_it_begins():
    rng = np.random.default_rng(3)
    model = controllers.LinearModel([[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], np.eye(2), 1e-3, 0.01, dt="0.1")
    bank = observers(model, ((0, 1),))
    recording = Recording(rng.standard_normal((40, 2)), np.zeros((40, 1)), np.zeros(2), (0, 25))
    moved = rng.standard_normal((1, 1, 40, 2))
    (white,), _ = innovations([model], [bank], recording, moved)
    base = by_recursion(model, bank, 0, recording, moved[0, 0])[0]
    for i, state in enumerate(np.eye(2)):
        off = Recording(recording.y, recording.u, state, recording.begins)
        change = by_recursion(model, bank, 0, off, moved[0, 0])[0] - base
        assert np.allclose(white[0, 1 + i, :25], change[:25], atol=1e-12)
        assert not white[0, 1 + i, 25:].any()
        assert np.allclose(white[0, 3 + i, 25:], change[25:], atol=1e-12)
        assert not white[0, 3 + i, :25].any()


def test_a_column_is_the_response_to_an_offset_of_a_sensor():
    rng = np.random.default_rng(4)
    model = controllers.LinearModel(
        [[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], np.eye(2)[[0, 0, 1]], 1e-3, 0.01, dt="0.1"
    )
    bank = observers(model, ((0, 2), (1,)))
    y = rng.standard_normal((40, 3))
    y[10:13] = np.nan
    y[rng.random(y.shape) < 0.1] = np.nan
    recording = Recording(y, np.zeros((40, 1)), rng.standard_normal(2), (0, 13), offsets=(0, 2))
    moved = rng.standard_normal((1, 2, 40, 2))
    (white,), _ = innovations([model], [bank], recording, moved)
    for k in range(2):
        base = by_recursion(model, bank, k, recording, moved[0, 0])[0]
        assert np.allclose(white[k, 0], base, atol=1e-12)
        for column, offset in zip(white[k, -2:], np.eye(3)[[0, 2]], strict=True):
            off = Recording(y + offset, recording.u, recording.mean, recording.begins)
            assert np.allclose(column, by_recursion(model, bank, k, off, moved[0, 0])[0] - base, atol=1e-12)
