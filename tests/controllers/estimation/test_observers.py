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


def test_observers_that_cannot_forget_their_start_soon():
    """An unseen mode that decays slowly: the short cut has the results of all the trials."""
    A = [[0.99, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.9999]]
    model = controllers.LinearModel(
        A, np.zeros((3, 1)), [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], np.diag([0, 1e-4, 1e-6]), 0.01, 0.1
    )
    unseen = observer_module.observers(model, ((0,), (1,)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observer_module, "_remembers", lambda A, C: False)
        tried = observer_module.observers(model, ((0,), (1,)))
    assert observer_module._remembers(model.matrix("A"), model.matrix("C")[:1])
    assert not observer_module._remembers(model.matrix("A"), model.matrix("C")[1:])
    assert unseen.settling == tried.settling > observer_module.LONGEST_REST
    for name in ("gain", "correction", "whiten", "noise"):
        np.testing.assert_array_equal(getattr(unseen, name), getattr(tried, name))
