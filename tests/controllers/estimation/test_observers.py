"""Observers of a model at the limits of rounding."""

import numpy as np
import pytest

from bayesftc import controllers
from bayesftc.controllers.estimation import observers as observer_module
from bayesftc.controllers.estimation.observers import observers


@pytest.mark.parametrize("pole", [0.999, 1.5, 1e6, 1e9, 1e18, 1e30])
def test_a_pole_of_any_size_gives_finite_observers_or_none(pole):
    model = controllers.LinearModel(
        [[pole]], [[2e-4]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
    )
    found = observers(model)
    if found is None:
        assert pole > 1e6
    else:
        assert np.isfinite(found.correction).all()
        assert np.abs(np.linalg.eigvals(model.matrix("A") - found.gain[0] @ model.matrix("C"))).max() < 1.0


def test_a_noise_that_rounding_loses_gives_none():
    """Two equal sensors: of their innovations' covariance P [[1, 1], [1, 1]] + R only the first part is left."""
    model = controllers.LinearModel(
        [[1e18]], [[2e-4]], [[1.0], [1.0]], process_covariance=0.001, sensor_covariance=1.0, dt=0.02
    )
    assert observers(model, ((0, 1),)) is None


def test_an_unseen_slow_mode_does_not_dull_what_is_seen():
    """No noise helps an observer to forget a mode that its sensors do not see; its innovations still have variance 1."""
    A = np.array([[0.99, 0.1, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 0.9999]])
    model = controllers.LinearModel(
        A, np.zeros((3, 1)), [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], np.diag([0, 1e-4, 1e-6]), 0.01, 0.1
    )
    bank = observer_module.observers(model, ((0,), (1,)))
    assert observer_module._remembers(model.matrix("A"), model.matrix("C")[:1])
    assert not observer_module._remembers(model.matrix("A"), model.matrix("C")[1:])
    np.testing.assert_array_equal(bank.noise[0], model.matrix("process_covariance"))
    assert bank.settling > observer_module.LONGEST_REST
    rng, x, z, white = np.random.default_rng(0), np.zeros(3), np.zeros(3), []
    for _ in range(4000):
        e = (x[0] + 0.1 * rng.standard_normal() - z[0]) * np.array([1.0, 0.0])
        white.append((bank.whiten[0] @ e)[0])
        z = A @ z + bank.gain[0] @ e
        x = A @ x + np.array([0.0, 1e-2, 1e-3]) * rng.standard_normal(3)
    assert np.var(white) == pytest.approx(1.0, abs=0.1)
