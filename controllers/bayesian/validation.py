"""The Kalman check: compare estimates with those of filterpy's Kalman filter on the same samples and controls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.bayesian.recorded import check_recorded, estimate, sampled_rows, samples_of
from bayesftc.controllers.models.checks import as_covariance
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.precision.baselines import SERFDI
from bayesftc.controllers.precision.filterpy import reference_filter, update_by_ser
from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.bayesian.linear import BayesianController


INTERPRETED = 10_000
"""Recordings of up to this many steps run interpreted, because compiling takes seconds."""

AGREEMENT = 1e-9
"""Largest relative difference that counts as rounding."""

READER = "The Kalman check"


@dataclass(frozen=True)
class KalmanCheck:
    """Largest differences between the beliefs of a controller and of filterpy's filter over a run.

    Attributes
    ----------
    mean_difference : float
        Largest difference of a state's estimate, relative to the larger of its size and the belief's own standard deviation.
    covariance_difference : float
        Largest difference of an element of P, relative to the product of the two standard deviations.
    mean_absolute, covariance_absolute : float
        The same in the state's units.
    steps : int
        Number of samples compared.
    explanation : str
        Why a difference beyond rounding is expected of this controller; empty if there is none, or it is not expected.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> controller = controllers.BayesianController(model, controllers.FixedPrecision())
    >>> sensors = cosim.Sensors(2, 0.1)
    >>> loop = cosim.closed_loop(plant, controller, control="u", measured="y", sensors=sensors, reference=1.0)
    >>> check = controllers.check_kalman(loop.simulate(3.0, engine="interpreted"), controller)
    >>> check.steps, check.covariance_difference < 1e-12
    (31, True)
    """

    mean_difference: float
    covariance_difference: float
    mean_absolute: float
    covariance_absolute: float
    steps: int
    explanation: str = field(default="", repr=False)

    def __repr__(self) -> str:
        return f"{short(self)} {self.explanation}".rstrip()


class Estimates(NamedTuple):
    """Estimates of filterpy's filter over a recording.

    Attributes
    ----------
    x_hat, P : ndarray, steps x n and steps x n x n
        Filtered means and covariances.
    ignored : ndarray of bool, steps x m
        Which present samples were left out.
    innovation : ndarray, steps x m
        ``y - C x_t|t-1``; NaN for a missing sample.
    """

    x_hat: Floats
    P: Floats
    ignored: np.ndarray[Any, np.dtype[np.bool_]]
    innovation: Floats


def ser_reference(
    model: LinearModel,
    y: Floats,
    u: Floats,
    *,
    threshold: float = float("inf"),
    R: Floats | None = None,
    initial_mean: Any = 0.0,
    initial_covariance: Any = 1.0,
) -> Estimates:
    """Run filterpy's Kalman filter over recorded samples: the SER baseline in its reference form (paper, section 5.2.1).

    Parameters
    ----------
    model : LinearModel
        The model.
    y : ndarray, steps x m
        Samples; one that is not finite is missing.
    u : ndarray, steps x p
        The controls that were applied after each sample.
    threshold : float
        A sample whose innovation exceeds this many standard deviations is left out; infinite for a plain Kalman filter.
    R : ndarray, steps x m x m, optional
        Sensor covariance at each step, instead of the model's; a sensor with an infinite variance is left out.
    initial_mean, initial_covariance : number, vector or matrix
        Mean and covariance of the state before the first sample.

    Returns
    -------
    Estimates
        Filtered means and covariances, which present samples were left out, and the innovations.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> y = np.array([[0.1, 0.0], [0.0, 0.1], [0.1, 3.0]])
    >>> estimates = controllers.ser_reference(model, y, np.zeros((3, 1)), threshold=3.0)
    >>> estimates.ignored[-1].tolist(), estimates.x_hat[-1].round(2).tolist()
    ([False, True], [0.05])
    """
    n, m, p = model.states, model.sensors, model.controls
    y, u = np.asarray(y, float).reshape(-1, m), np.asarray(u, float).reshape(-1, p)
    start = as_covariance("The initial_covariance", initial_covariance, n, singular=True)
    A, B, C, Q = (model.matrix(name) for name in ("A", "B", "C", "process_covariance"))
    kf = reference_filter(A, B, Q, initial_mean, start)
    nominal = model.matrix("sensor_covariance")
    means, covariances, ignored = np.empty((len(y), n)), np.empty((len(y), n, n)), np.zeros((len(y), m), bool)
    innovation = np.empty((len(y), m))
    for k, sample in enumerate(y):
        innovation[k] = np.where(np.isfinite(sample), sample - (C @ kf.x)[:, 0], np.nan)
        ignored[k] = update_by_ser(kf, sample, C, nominal if R is None else R[k], threshold)
        means[k], covariances[k] = kf.x[:, 0], kf.P
        kf.predict(u=u[k].reshape(p, 1))
    return Estimates(means, covariances, ignored, innovation)


def check_kalman(
    signals: Mapping[str, Any],
    controller: BayesianController,
    *,
    y: str | None = None,
    name: str = "controller",
    most: int | None = None,
) -> KalmanCheck:
    """Compare a controller's recorded belief with filterpy's Kalman filter, step by step.

    filterpy gets the same samples, the controls that were applied, and at each step the sensor covariance that the controller
    used (``R``). With a learned precision, this therefore checks everything except the learning. For `SERFDI` filterpy gets the
    threshold instead, and its own innovations decide which sensors are left out.

    Parameters
    ----------
    signals : Result
        Must contain ``u``, ``x_hat``, ``P`` and ``R`` of the controller and its samples, at every sample of the
        controller. If it contains ``innovation``, samples that counted as missing are left out.
    controller : BayesianController
        The controller that ran, for its model and initial belief.
    y : str, optional
        Name of the signal that was connected to the controller's ``y``; of a closed loop it is known.
    name : str
        The controller's name in the diagram.
    most : int, optional
        Number of samples to compare, from the first one on; by default all.

    Returns
    -------
    KalmanCheck
        The largest differences. They are rounding errors, except with ``belief="joint"``, and with learners that infer state and
        faults together, as `SwitchingPrecision` does by default; `KalmanCheck.explanation` says so.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> plant = cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> controller = controllers.LQGController(model, controllers.GammaPrecision())
    >>> sensors = cosim.Sensors(2, 0.1)
    >>> loop = cosim.closed_loop(plant, controller, control="u", measured="y", sensors=sensors, reference=1.0)
    >>> check = controllers.check_kalman(loop.simulate(3.0, engine="interpreted"), controller)
    >>> check.mean_difference < 1e-12
    True
    """
    if not hasattr(controller, "precision"):
        raise ModelError(
            f"check_kalman() has the controller {brief(controller)}; give the result of the run first, then the controller: "
            "check_kalman(result, controller)."
        )
    samples = samples_of(signals, y, name, READER)
    check_recorded(signals, READER, *(f"{name}.{port}" for port in ("u", "x_hat", "P", "R")))
    rows = sampled_rows(signals, controller.model.step, READER)
    learner = controller.precision
    threshold = learner.threshold if isinstance(learner, SERFDI) else None
    if (innovation := f"{name}.innovation") in signals:  # NaN for absurd samples and invalid values as well
        samples = np.where(np.isnan(signals[innovation]), np.nan, samples)
    u, R, x_hat, P = (signals[f"{name}.{port}"][rows][:most] for port in ("u", "R", "x_hat", "P"))
    reference = ser_reference(
        controller.model,
        samples[rows][:most],
        u,
        threshold=float("inf") if threshold is None else threshold,
        R=R if threshold is None else None,
        initial_mean=controller.initial_mean,
        initial_covariance=controller.initial_covariance,
    )
    check = compare(x_hat, P, reference)
    differs = max(check.mean_difference, check.covariance_difference) > AGREEMENT
    return replace(check, explanation=expected_to_differ(controller)) if differs else check


def expected_to_differ(controller: BayesianController) -> str:
    """Return a sentence on why the belief of a controller is not that of a Kalman filter; empty if it is."""
    if controller.belief == "joint":
        return 'This is expected of belief = "joint", which depends on the goal; belief = "filtered" agrees.'
    if controller.precision.learner(controller.model).infer is not None:
        return (
            f"This is expected of this {type(controller.precision).__name__}, which infers state and faults together; a Kalman "
            "filter with its R does not. With joint = false the two agree."
        )
    return ""


def sensor_by_sensor(
    signals: Mapping[str, Any], controller: BayesianController, *, y: str | None = None, name: str = "controller"
) -> tuple[dict[str, Any], BayesianController]:
    """Estimate again, from a run's samples and controls, with the per-sensor form of the controller's learner.

    The belief of a learner that infers state and faults together is not a Kalman filter's; that of this form is.

    Parameters
    ----------
    signals : Result
        Must contain the samples, and ``u`` of the controller, at every sample of the controller.
    controller, y, name
        See `check_kalman`.

    Returns
    -------
    dict
        The signals that `check_kalman` needs, with a row for each sample of the controller.
    BayesianController
        The controller with the per-sensor form.

    Raises
    ------
    ModelError
        If the learner has no per-sensor form.
    """
    rows, ports = sampled_rows(signals, controller.model.step, READER), ("x_hat", "P", "R", "innovation")
    check_recorded(signals, READER, f"{name}.u")
    samples = samples_of(signals, y, name, READER)[rows]
    learner = controller.precision.apart("The Kalman check")
    estimator = StateEstimator(
        controller.model, learner, controller.initial_mean, controller.initial_covariance, invalid=controller.invalid
    )
    u = np.asarray(signals[f"{name}.u"])[rows]
    estimated = estimate(estimator, samples, u, ports, compiled=len(samples) > INTERPRETED)
    recorded = {f"{name}.{port}": values for port, values in estimated.items()} | {
        f"{name}.y" if y is None else y: samples,
        f"{name}.u": u,
    }
    return recorded, replace(controller, precision=learner)


def compare(x_hat: Floats, P: Floats, reference: Estimates) -> KalmanCheck:
    """Return the largest differences of means (steps x n) and covariances (steps x n x n) from the reference's."""
    mean, covariance = np.abs(x_hat - reference.x_hat), np.abs(P - reference.P)
    std = np.sqrt(np.maximum(np.diagonal(reference.P, axis1=1, axis2=2), 0.0))
    std = np.maximum(std, np.finfo(float).eps * std.max(axis=0))  # what is known exactly has no size of its own
    scale, size = np.maximum(np.abs(reference.x_hat), std), std[:, :, None] * std[:, None, :]
    return KalmanCheck(
        mean_difference=_largest_ratio(mean, scale),
        covariance_difference=_largest_ratio(covariance, size),
        mean_absolute=float(mean.max()),
        covariance_absolute=float(covariance.max()),
        steps=len(mean),
    )


def _largest_ratio(difference: Floats, scale: Floats) -> float:
    """Return the largest difference relative to its scale; 0 over 0 is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.max(np.where(difference == 0, 0.0, difference / scale)))
