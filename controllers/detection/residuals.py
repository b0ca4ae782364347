"""Residuals of a run, which reveal faults: arrays with a row for each step and a column for each sensor."""

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
"""The controller's output that is NaN where a sample is missing; as a feature its magnitude is used."""


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
        The residual in squared units of the sensor; NaN for missing samples.

    Raises
    ------
    UnknownNameError
        If one of the two signals is not recorded.
    ModelError
        If the controller's precision learner has no rate.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> controller = controllers.LQGController(model, controllers.GammaPrecision())
    >>> loop = cosim.closed_loop(
    ...     plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), reference=1.0,
    ...     faults=[cosim.Bias(sensor=0, magnitude=2.0, start=2.0)],
    ... )
    >>> run = loop.simulate(3.0, engine="interpreted")
    >>> controllers.beta_residual(run)[-1].round(2).tolist()
    [17.73, 0.1]
    """
    beta = _signal(result, controller, "beta")
    missing = np.isnan(_signal(result, controller, INNOVATION))
    if len(beta) and np.isnan(beta).all():
        raise ModelError(
            f"{controller}.beta is NaN throughout, because the precision learner has no rate. Give the controller "
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
        The controller's model, to divide by the standard deviation of the innovation without a fault,
        ``sqrt(C P_t|t-1 C' + R)`` with the nominal R. This needs every step of the output ``P``. The first row is then NaN,
        because the belief before the first sample is not an output.

    Returns
    -------
    ndarray, shape (steps, m)
        The residual in units of the sensor, or in standard deviations; NaN for missing samples.

    Raises
    ------
    UnknownNameError
        If a signal is not recorded.
    ModelError
        If `standardised` is not the controller's model, or not every step is recorded.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> controller = controllers.LQGController(model, controllers.GammaPrecision())
    >>> loop = cosim.closed_loop(
    ...     plant, controller, control="u", measured="y", sensors=cosim.Sensors(2, 0.1), reference=1.0,
    ...     faults=[cosim.Bias(sensor=0, magnitude=2.0, start=2.0)],
    ... )
    >>> run = loop.simulate(3.0, engine="interpreted")
    >>> controllers.state_estimation_residual(run)[-1].round(1).tolist()
    [2.0, 0.1]
    >>> controllers.state_estimation_residual(run, standardised=model)[-1].round().tolist()
    [20.0, 1.0]
    """
    residual = np.abs(_signal(result, controller, INNOVATION))
    if standardised is None:
        return residual
    P = _signal(result, controller, "P")
    A, C, Q, R = (standardised.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    if P.shape[1:] != A.shape or residual.shape[1] != len(C):
        raise ModelError(
            f"The model has {len(A)} states and {len(C)} sensors, but {controller!r} has {P.shape[1]} and {residual.shape[1]}; "
            "give the controller's model."
        )
    if result.decimation != 1:
        raise ModelError(
            f"Only every {result.decimation}th step is recorded, but a standardised residual needs the belief one step earlier; "
            "simulate with decimation=1."
        )
    predicted = A @ P[:-1] @ A.T + Q
    variance = np.einsum("ij,tjk,ik->ti", C, predicted, C) + np.diag(R)
    deviation = np.sqrt(np.vstack([np.full((1, len(C)), np.nan), variance]))
    return np.asarray(residual / deviation)


def residual_features(
    result: Result, features: str | Sequence[str] = ("beta",), controller: str = "controller"
) -> Floats:
    """Return several residuals side by side, as `FaultClassifier` needs them (``.reshape(-1, len(features))``).

    Parameters
    ----------
    result : Result
        A run in which the features and the controller's output ``innovation`` were recorded.
    features : str or sequence of str
        ``"beta"`` for the beta residual, ``"innovation"`` for the state estimation residual (its magnitude), or another output
        of the controller with one value for each sensor.
    controller : str
        Name of the controller's block.

    Returns
    -------
    ndarray, shape (steps, m, features)
        The residuals; NaN for missing samples.

    Raises
    ------
    UnknownNameError, ModelError
        If a signal is not recorded, or does not have one value for each sensor.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> controller = controllers.LQGController(model, controllers.GammaPrecision())
    >>> sensors = cosim.Sensors(2, 0.1)
    >>> loop = cosim.closed_loop(plant, controller, control="u", measured="y", sensors=sensors, reference=1.0)
    >>> features = controllers.residual_features(loop.simulate(3.0, engine="interpreted"), ["beta", "innovation"])
    >>> features.shape, features.reshape(-1, 2).shape
    ((31, 2, 2), (62, 2))
    """
    innovation = _signal(result, controller, INNOVATION)
    columns = []
    for name in feature_names(features):
        values = beta_residual(result, controller) if name == "beta" else _signal(result, controller, name)
        if values.shape != innovation.shape:
            raise ModelError(
                f"{controller}.{name} has the shape {values.shape[1:]} at each step; give an output with one value for each of "
                f"the {innovation.shape[1]} sensors."
            )
        columns.append(np.where(np.isnan(innovation), np.nan, np.abs(values) if name == INNOVATION else values))
    return np.stack(columns, axis=-1)


def feature_names(features: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of features as a tuple; a string is one name.

    Raises
    ------
    ModelError
        If they are not names, or there are none.
    """
    names = (features,) if isinstance(features, str) else tuple(features) if isinstance(features, Iterable) else ()
    if not names or not all(isinstance(name, str) for name in names):
        raise ModelError(
            f'features={features!r} has no names of residuals; give names of the controller\'s outputs, as ("beta",).'
        )
    return names


def _signal(result: Result, controller: str, name: str) -> Floats:
    signal = f"{controller}.{name}"
    if signal not in result:
        raise UnknownNameError(
            f"The signal {signal!r} is not recorded; add it to simulate(record=...), or give the name of the controller's block "
            "as controller=."
        )
    return result[signal]
