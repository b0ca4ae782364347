"""Residuals of a run: against the controller's own signals and a belief recomputed by hand."""

from dataclasses import replace

import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.controllers import (
    FixedPrecision,
    GammaPrecision,
    beta_residual,
    residual_features,
    state_estimation_residual,
)
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.examples.cruise_control.cruise_control import FREEZE, cruise_control

DROPOUT = cosim.Dropout(sensor=1, start=1.0, stop=2.0)


@pytest.fixture(scope="module")
def result():
    return cruise_control(GammaPrecision(), fault=DROPOUT).simulate(5.0, seed=2, engine="interpreted")


def test_both_residuals_are_nan_for_missing_samples_and_the_outputs_elsewhere(result):
    e, beta = state_estimation_residual(result), beta_residual(result)
    missing = np.isnan(result["dropout_1.y"])
    assert missing.sum() == 50
    assert e.shape == beta.shape == missing.shape == (251, 2)
    np.testing.assert_array_equal(np.isnan(e), missing)
    np.testing.assert_array_equal(np.isnan(beta), missing)
    np.testing.assert_array_equal(e[~missing], np.abs(result["controller.innovation"])[~missing])
    np.testing.assert_array_equal(beta[~missing], result["controller.precision_rate"][~missing])


def test_the_residual_is_what_the_sensor_says_beyond_the_prediction(result):
    x, u = result["controller.x_hat"][:, 0], result["controller.u"][:, 0]
    predicted = np.concatenate([[20.0], 0.999 * x[:-1] + 2e-4 * u[:-1]])
    np.testing.assert_allclose(
        state_estimation_residual(result), np.abs(result["dropout_1.y"] - predicted[:, None]), rtol=1e-9
    )


@pytest.mark.slow
def test_standardised_by_the_models_own_covariance():
    """Without a fault and at fixed precision it has unit mean square; and equals the scalar recursion."""
    loop = cruise_control(FixedPrecision(), fault=replace(FREEZE, start=5000.0, stop=5001.0))
    model = loop["controller"].block.model
    result = loop.simulate(60.0, seed=3, engine="interpreted")
    standard = state_estimation_residual(result, standardised=model)
    assert np.isnan(standard[0]).all()
    variance = 0.999**2 * result["controller.P"][:-1, 0, 0] + 0.001 + 1.0
    np.testing.assert_allclose(
        standard[1:], np.abs(result["controller.innovation"][1:]) / np.sqrt(variance)[:, None], rtol=1e-12
    )
    assert np.mean(standard[1:] ** 2) == pytest.approx(1.0, abs=0.05)


def test_features_side_by_side(result):
    features = residual_features(result, ("beta", "innovation", "precision_mean"))
    assert features.shape == (251, 2, 3)
    np.testing.assert_array_equal(features[..., 0], beta_residual(result))
    np.testing.assert_array_equal(features[..., 1], state_estimation_residual(result))
    missing = np.isnan(features[..., 0])
    np.testing.assert_array_equal(features[~missing][:, 2], result["controller.precision_mean"][~missing])
    assert np.isnan(features[missing]).all()


def test_what_is_not_there(result):
    loop = cruise_control(FixedPrecision())
    short = loop.simulate(1.0, engine="interpreted", record=["controller.innovation", "controller.beta"])
    with pytest.raises(ModelError, match="has no rate"):
        beta_residual(short)
    with pytest.raises(UnknownNameError, match=r"'controller\.P' is not recorded; add it"):
        state_estimation_residual(short, standardised=loop["controller"].block.model)
    with pytest.raises(UnknownNameError, match=r"'brain\.innovation' is not recorded"):
        state_estimation_residual(result, "brain")
    with pytest.raises(UnknownNameError, match=r"'controller\.innovation' is not recorded"):
        beta_residual(loop.simulate(1.0, engine="interpreted", record=["controller.beta"]))
    with pytest.raises(ModelError, match="give an output with one value for each of the 2 sensors"):
        residual_features(result, ["x_hat"])
    with pytest.raises(ModelError, match="decimation=1"):
        state_estimation_residual(
            loop.simulate(1.0, decimation=2, engine="interpreted"), standardised=loop["controller"].block.model
        )
    with pytest.raises(ModelError, match="give the controller's model"):
        state_estimation_residual(
            result, standardised=controllers.LinearModel(np.eye(2), np.ones((2, 1)), np.eye(2), 1.0, 1.0, 0.02)
        )
