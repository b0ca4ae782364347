"""Residuals of a run: what a fault shows itself by, as arrays with a row for each step and a column for each sensor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.errors import ModelError, UnknownNameError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.run.result import Result
    from bayesftc.cosim.types import Floats

INNOVATION = "innovation"
"""The controller's output that is NaN where a sample is missing; as a feature it stands for its magnitude."""


def beta_residual(result: Result, controller: str = "controller") -> Floats:
    """Return the beta residual: the rate of each sensor's precision (paper, section 4.2).

    Parameters
    ----------
    result : Result
        A run in which the controller's outputs ``beta`` and ``innovation`` were recorded.
    controller : str
        Name of the controller's block.

    Returns
    -------
    ndarray, shape (steps, m)
        In squared units of the sensor; NaN for missing samples.

    Raises
    ------
    UnknownNameError
        If one of the two was not recorded.
    ModelError
        If the controller's precision learner has no rate.
    """
    beta = _signal(result, controller, "beta")
    missing = np.isnan(_signal(result, controller, INNOVATION))
    if len(beta) and np.isnan(beta).all():
        raise ModelError(
            f"{controller}.beta is NaN throughout: its precision learner has no rate; give the controller "
            "precision=GammaPrecision() for a beta residual."
        )
    return np.where(missing, np.nan, beta)


def state_estimation_residual(
    result: Result, controller: str = "controller", standardised: LinearModel | None = None
) -> Floats:
    """Return the state estimation residual: the magnitude of each sensor's innovation, ``|y - C x_t|t-1|`` (section 4.1).

    Parameters
    ----------
    result : Result
        A run in which the controller's output ``innovation`` was recorded.
    controller : str
        Name of the controller's block.
    standardised : LinearModel, optional
        The controller's model, to divide by the standard deviation that the innovation has without fault,
        ``sqrt(C P_t|t-1 C' + R)`` with the nominal R. It needs every step of the output ``P``; the first row is then NaN, for
        the belief before the first sample is no output.

    Returns
    -------
    ndarray, shape (steps, m)
        In units of the sensor, or in standard deviations; NaN for missing samples.

    Raises
    ------
    UnknownNameError
        If a signal was not recorded.
    ModelError
        If it is to be standardised and the model is not the controller's, or not every step was recorded.
    """
    residual = np.abs(_signal(result, controller, INNOVATION))
    if standardised is None:
        return residual
    P = _signal(result, controller, "P")
    A, C, Q, R = (standardised.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    if P.shape[1:] != A.shape or residual.shape[1] != len(C):
        raise ModelError(
            f"The model has {len(A)} states and {len(C)} sensors, but {controller!r} has {P.shape[1]} and {residual.shape[1]}; "
            "give the model that the controller was made with."
        )
    if result.decimation != 1:
        raise ModelError(
            f"Only every {result.decimation}th step was recorded, but to standardise a residual takes the belief one step "
            "before it; simulate with decimation=1."
        )
    predicted = A @ P[:-1] @ A.T + Q
    variance = np.einsum("ij,tjk,ik->ti", C, predicted, C) + np.diag(R)
    deviation = np.sqrt(np.vstack([np.full((1, len(C)), np.nan), variance]))
    return np.asarray(residual / deviation)


def residual_features(
    result: Result, features: str | Sequence[str] = ("beta",), controller: str = "controller"
) -> Floats:
    """Return several residuals side by side, as `FaultClassifier` takes them (``.reshape(-1, len(features))``).

    Parameters
    ----------
    result : Result
        A run in which the features and the controller's output ``innovation`` were recorded.
    features : str or sequence of str
        ``"beta"`` for the beta residual, ``"innovation"`` for the state estimation residual (its magnitude), or any other of the
        controller's outputs that has one value for each sensor.
    controller : str
        Name of the controller's block.

    Returns
    -------
    ndarray, shape (steps, m, features)
        NaN for missing samples.

    Raises
    ------
    UnknownNameError, ModelError
        If a signal was not recorded, or has no value for each sensor.
    """
    innovation = _signal(result, controller, INNOVATION)
    columns = []
    for name in feature_names(features):
        values = beta_residual(result, controller) if name == "beta" else _signal(result, controller, name)
        if values.shape != innovation.shape:
            raise ModelError(
                f"{controller}.{name} has the shape {values.shape[1:]} at each step, which is not one value for each of the "
                f"{innovation.shape[1]} sensors; a residual must be."
            )
        columns.append(np.where(np.isnan(innovation), np.nan, np.abs(values) if name == INNOVATION else values))
    return np.stack(columns, axis=-1)


def feature_names(features: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of features as a tuple; a string is one name.

    Raises
    ------
    ModelError
        If they are no names, or there is none.
    """
    names = (features,) if isinstance(features, str) else tuple(features) if isinstance(features, Iterable) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise ModelError(
            f'features={features!r} does not name any residuals; give names of the controller\'s outputs, as ("beta",).'
        )
    return names


def _signal(result: Result, controller: str, name: str) -> Floats:
    signal = f"{controller}.{name}"
    if signal not in result:
        raise UnknownNameError(
            f"The signal {signal!r} was not recorded; add it to simulate(record=...), or say by controller= what the "
            "controller's block is called."
        )
    return result[signal]
