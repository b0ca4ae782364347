"""What is wrong with one of several controls is named with this control."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc.controllers import LinearModel, diagnose_recording
from bayesftc.controllers.models.linear import SignalNames

A, B, C = np.array([[0.9, 0.05], [0.0, 0.8]]), np.array([[0.2, 0.05], [0.02, 0.3]]), np.repeat(np.eye(2), 2, axis=0)
NAMES = SignalNames(states=("a", "b"), controls=("stock", "steam"), sensors=("a", "a", "b", "b"))
MODEL = replace(LinearModel(A, B, C, 1e-5, 1e-3, dt=1.0), names=NAMES)


def recording(seed=0, *, late=(0, 0), acting=lambda u: u, steps=300):
    """Return samples and controls of a plant on which the controls act late, and changed."""
    rng = np.random.default_rng(seed)
    sent = np.repeat(rng.normal(size=(steps // 10, 2)), 10, axis=0)
    arrived = acting(np.stack([np.pad(sent[:, j], (k, 0))[:steps] for j, k in enumerate(late)], axis=1))
    x, y = np.zeros(2), np.zeros((steps, 4))
    for t in range(steps):
        y[t] = C @ x + 1e-3**0.5 * rng.normal(size=4)
        x = A @ x + B @ arrived[t] + 1e-5**0.5 * rng.normal(size=2)
    return y, sent


@pytest.mark.parametrize(
    ("modelled", "true", "kind", "values", "words"),
    [
        ((0, 0), (0, 3), "late", (3.0, 0.0, 1.0), "the control steam acts late, by 3 s (3 samples)"),
        ((0, 0), (2, 0), "late", (2.0, 0.0, 0.0), "the control stock acts late, by 2 s"),
        ((0, 0), (2, 2), "late", (2.0, 0.0), "the controls act late, by 2 s"),
        (
            (2, 5),
            (2, 1),
            "early",
            (4.0, 1.0),
            "the control steam acts earlier than in the model, by 4 s (4 samples). Sho",
        ),
        ((3, 5), (1, 3), "early", (2.0,), "the controls act earlier than in the model, by 2 s"),
        ((2, 5), (2, 5), None, (), ""),
    ],
)
def test_a_wrong_dead_time_of_one_control_is_named_with_it(modelled, true, kind, values, words):
    finding = diagnose_recording(MODEL.with_delays(modelled), *recording(late=true))
    if kind is None:
        assert finding is None
        return
    assert (finding.kind, finding.values) == (kind, values)
    assert words in finding.sentence
