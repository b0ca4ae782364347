"""The probability that a recorded sample is healthy, given the output that a model predicts: the weights of `cosim.fit`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import RecordingError
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.fit import fit_model
from bayesftc.monitoring.models import ConstantRate, RandomWalk
from bayesftc.monitoring.precision import default_precision
from bayesftc.monitoring.recording import Recording, expected_loss
from bayesftc.monitoring.run import monitor_recording

LAG = 16
"""Samples between which the model's error must have changed to be distinguished from noise."""

WANDER = 0.01
"""Least change of the model's error in a step, in standard deviations of the noise: no model is exact, and 10,000 samples of an
error that wanders by one standard deviation are no fault."""

LASTING = 100
"""Samples from which on an error of a sensor lasts: then it is at most as large as the noise. A larger one is a fault."""

MOST = 3
"""Least number of sensors of which most are right: what they have in common is then the error of the model. Of two sensors that
drift apart, the model alone shows which one errs."""

SPREAD = 0.6745
"""Median of the magnitude of a standard normal number."""

FINEST = 1e-9
"""Least noise, as a share of the typical sample beside 0, for recordings without noise."""

Indices = np.ndarray[Any, np.dtype[np.int64]]


def healthy(y: Floats, predicted: Floats, dt: float) -> Floats:
    """Return the probability of each sample that its sensor is healthy, by the learner of the monitor.

    The state is the output: it changes as predicted, and by a random walk, the error of the model, which all sensors share. The
    size of the walk and the sensors' noise are estimated from the differences of the residuals, by medians, which faults in
    fewer than half of the samples hardly move. Three or more sensors are judged together, so that those that agree are
    healthy, and the walk goes at least as far as what they have in common. Of two or more sensors, noise that is coloured or
    shared is estimated as by `bayesftc monitor --fit`. From the onset of a fault up to its alarm, the probability is 0: the
    learner has noticed it late.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples of redundant sensors of one output; NaN where there is none.
    predicted : ndarray, steps
        The output that the model predicts.
    dt : float
        Seconds between two steps.

    Returns
    -------
    ndarray, steps x sensors
        Probabilities; 0 where there is no sample. Those of a sensor with few samples, or whose samples are
        all 0, are 1.
    """
    present = np.isfinite(y)
    probability = present.astype(float)
    judged = np.flatnonzero((present.sum(axis=0) > LAG) & (np.nan_to_num(y) != 0.0).any(axis=0))
    if len(judged):
        probability[:, judged] *= _judged(y[:, judged], predicted, dt)
    return probability


def _judged(y: Floats, predicted: Floats, dt: float) -> Floats:
    step = rational_step(dt)
    present = [np.flatnonzero(column) for column in np.isfinite(y).T]
    resolution = tuple(find_resolution(column) for column in y.T)
    sensors = tuple(f"sensor {i}" for i in range(len(present)))
    recording = Recording(
        start=0.0,
        dt=step,
        sensors=sensors,
        y=y,
        u=np.diff(predicted, append=predicted[-1:])[:, None],
        loss=tuple(expected_loss(np.asarray(there * float(step)), step) for there in present),
        resolution=resolution,
        replaced=(0,) * len(sensors),
        units=("",) * len(sensors),
    )
    walks, noises = zip(*map(_walk_and_noise, y.T, present, [predicted] * len(present), resolution), strict=True)
    model, joint = _model(recording, y - predicted[:, None], min(walks), np.array(noises))
    start = [predicted[0] + np.nanmedian((y - predicted[:, None])[:LAG]), *np.zeros(model.states - 1)]
    A, Q = model.matrix("A"), model.matrix("process_covariance")
    covariance = np.diag([max(noises), *(np.diag(Q) / (1.0 - np.diag(A) ** 2 + WANDER**4))[1:]])
    learner = default_precision(recording.loss, resolution, joint=joint)
    monitored = monitor_recording(recording, model, learner, initial_mean=tuple(start), initial_covariance=covariance)
    # A harmless burst of noise does not count, and an absurd sample is faulty, though it is no evidence for a mode.
    probability = np.minimum(monitored.mode_probability[:, :, 0], 1.0 - monitored.fault_probability)
    for event in monitored.events:
        if event.onset is not None:
            unnoticed = (monitored.time >= event.onset) & (monitored.time < event.start)
            probability[unnoticed, sensors.index(event.sensor)] = 0.0
    return probability


def _model(recording: Recording, residuals: Floats, walk: float, noises: Floats) -> tuple[LinearModel, bool]:
    """Return the model of the output, and whether sensors are judged together.

    If there are enough sensors, it has their errors, and the walk of what their residuals have in common.
    """

    def walking(variances: Floats) -> LinearModel:
        return LinearModel([[1.0]], [[1.0]], [[1.0]] * len(noises), walk, np.diag(variances), dt=recording.dt)

    try:
        fitted = fit_model(replace(recording, y=residuals, resolution=(0.0,) * len(noises)))
    except RecordingError:  # a single sensor, or few samples: white noise
        return walking(noises), False
    joint = len(noises) >= MOST and fitted.joint
    if joint and fitted.moves:
        walk = max(walk, _per_step(fitted.plant, fitted.rate, float(recording.dt)))
    model = walking(np.square([sensor.std for sensor in fitted.sensors.values()]))
    lasting = LASTING * float(recording.dt)
    noise = {name: sensor.std**2 for name, sensor in fitted.sensors.items()}
    for errors in sorted(fitted.errors, key=lambda errors: float(np.max(errors.time_constant))):
        names, std = list(errors.sensors or ()), float(np.max(errors.std))
        if np.max(errors.time_constant) > lasting:
            std = min(std, *(noise[name] ** 0.5 for name in names))
        noise |= {name: noise[name] + std**2 for name in names}
        places = [recording.sensors.index(name) for name in names]
        model = model.with_sensor_errors(std, errors.time_constant, places, common=errors.common)
    return model, joint


def _per_step(error: RandomWalk | ConstantRate, rate: float, dt: float) -> float:
    """Return the variance of a random walk in a step that goes as far as the model's error, over `LAG` steps if it is smooth."""
    return error.std**2 * dt if isinstance(error, RandomWalk) else (rate * dt) ** 2 * LAG


def _walk_and_noise(samples: Floats, there: Indices, predicted: Floats, resolution: float) -> tuple[float, float]:
    """Return the variances of the change of the model's error in a step, and of the sensor's noise.

    The difference of residuals over k samples of a random walk (variance Q a sample) with noise (R) has the variance k Q + 2 R.
    """
    error = (samples - predicted)[there]
    near, far = ((np.median(np.abs(error[lag:] - error[:-lag])) / SPREAD) ** 2 for lag in (1, LAG))
    walk = max((far - near) / (LAG - 1), 0.0)
    usual = np.median(np.abs(samples[there][samples[there] != 0.0]))
    noise = max((near - walk) / 2, resolution**2 / 12, (FINEST * usual) ** 2)
    return max(float(walk) / float(np.median(np.diff(there))), WANDER**2 * noise), float(noise)
