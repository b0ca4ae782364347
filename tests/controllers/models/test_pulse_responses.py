"""The eigensystem realisation, against python-control's."""

from contextlib import nullcontext

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayesftc.controllers.models import pulse_responses


@pytest.mark.parametrize(("outputs", "inputs", "samples"), [(1, 1, 100), (2, 1, 41), (2, 3, 100)])
@pytest.mark.parametrize("order", [None, 2])
def test_the_realisation_is_python_controls(outputs, inputs, samples, order):
    rng = np.random.default_rng(3)
    A, B, C = np.diag([0.9, 0.7, -0.4]), rng.standard_normal((3, inputs)), rng.standard_normal((outputs, 3))
    markov = np.array([C @ np.linalg.matrix_power(A, k) @ B for k in range(samples)])
    with pytest.warns(pulse_responses.PoorFitWarning) if order == 2 else nullcontext():
        found = pulse_responses._eigensystem(markov, np.zeros_like(markov), order)
    rows = np.abs(markov).max(axis=(0, 2))
    scaled = markov / rows[:, None]
    columns = np.abs(scaled).max(axis=(0, 1))
    impulse = np.concatenate([np.zeros((1, outputs, inputs)), scaled / columns]).transpose(1, 2, 0)
    half = (samples - 1) // 2
    system, values = control.era(impulse, r=order or 3, m=half, n=half)
    expected = system.A, system.B * columns, system.C * rows[:, None], values
    for ours, theirs in zip(found, expected, strict=False):
        assert_allclose(ours, theirs, rtol=1e-12, atol=1e-14)
