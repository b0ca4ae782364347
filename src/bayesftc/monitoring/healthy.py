"""The probability that a recorded sample is healthy, given the output that a model predicts: the weights of `cosim.fit`."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesftc.controllers.learning.resolution import find_resolution
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.recording import Recording, expected_loss
from bayesftc.monitoring.run import monitor_recording

Indices = np.ndarray[Any, np.dtype[np.int64]]

LAG = 16
"""Samples between which the model's error must have changed to be distinguished from noise."""

WANDER = 0.01
"""Least change of the model's error in a step, in standard deviations of the noise: no model is exact, and 10,000 samples of an
error that wanders by one standard deviation are no fault."""

SPREAD = 0.6745
"""Median of the magnitude of a standard normal number."""

FINEST = 1e-9
"""Least noise, as a share of the samples' spread, for recordings without noise."""


def healthy(y: Floats, predicted: Floats, dt: float) -> Floats:
    """Return the probability of each sample that its sensor is healthy, by the learner of the monitor.

    The model's error is a random walk that all sensors of the output share. Its change in a step and the noise of each sensor
    are estimated from the residuals' differences, by medians, which faults in fewer than half of the samples hardly move. From
    the onset of an alarm on, samples have the probability 0: the learner has seen the fault only later.

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
        Probabilities; 0 where there is no sample.
    """
    step = rational_step(dt)
    present = [np.flatnonzero(column) for column in np.isfinite(y).T]
    weights = np.zeros(y.shape)
    used = [i for i, there in enumerate(present) if len(there) > LAG]
    if not used:
        return np.asarray(np.isfinite(y).astype(float))
    y, present = y[:, used], [present[i] for i in used]
    resolution = [find_resolution(column) for column in y.T]
    walks, noises = zip(*map(_walk_and_noise, y.T, present, [predicted] * len(used), resolution), strict=True)
    recording = Recording(
        start=0.0,
        dt=step,
        sensors=tuple(f"sensor {i}" for i in used),
        y=y,
        u=np.diff(predicted, append=predicted[-1:])[:, None],
        loss=tuple(expected_loss(np.asarray(there * float(step)), step) for there in present),
        resolution=tuple(resolution),
        replaced=(0,) * len(used),
        units=("",) * len(used),
    )
    model = LinearModel([[1.0]], [[1.0]], [[1.0]] * len(used), min(walks), np.diag(noises), dt=step)
    first = predicted[0] + np.nanmedian((y - predicted[:, None])[:LAG])
    monitored = monitor_recording(recording, model, initial_mean=float(first), initial_covariance=[[max(noises)]])
    probability = monitored.mode_probability[:, :, 0].copy()
    for event in monitored.events:
        if event.onset is not None:
            hidden = (monitored.time >= event.onset) & (monitored.time < event.start)
            probability[hidden, recording.sensors.index(event.sensor)] = 0.0
    weights[:, used] = np.where(np.isfinite(y), probability, 0.0)
    return weights


def _walk_and_noise(samples: Floats, there: Indices, predicted: Floats, resolution: float) -> tuple[float, float]:
    """Return the variances of the change of the model's error in a step, and of the sensor's noise.

    The difference of residuals over k samples of a random walk (variance Q a sample) with noise (R) has the variance k Q + 2 R.
    """
    error = (samples - predicted)[there]
    near, far = ((np.median(np.abs(error[lag:] - error[:-lag])) / SPREAD) ** 2 for lag in (1, LAG))
    walk = max((far - near) / (LAG - 1), 0.0)
    least = max(resolution**2 / 12, (FINEST * np.ptp(samples[there])) ** 2, np.finfo(float).tiny)
    noise = max((near - walk) / 2, least)
    return max(float(walk) / float(np.median(np.diff(there))), WANDER**2 * noise), float(noise)
