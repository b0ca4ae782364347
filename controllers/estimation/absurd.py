"""The screen for absurd samples: they count as missing, and their sensor as faulty at that sample.

A sample is absurd if its innovation exceeds a million standard deviations: 1e20, the largest integer or float of a device, a
value in other units. Weights can be capped, but such an innovation would still move belief and learner for minutes. Learner and
update therefore get a missing sample.

If the belief is wrong, every sample is absurd. A sensor confirms its absurd samples by further ones that are near the one before
but do not repeat it, because a failed device repeats one value. A repetition confirms half a sample if the sensor has sent no
ordinary sample yet: a healthy sensor at rest repeats itself, and the initial mean may be wrong. Nothing is confirmed while
another sensor of the same quantity sends ordinary samples, or beyond `CREDIBLE`. After `PATIENCE` the belief counts as lost: it
is widened until the sample is an ordinary one. A belief without a covariance accepts the samples after the same time.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.precision.base import NAN
from bayesftc.cosim.base.invalid import invalid_values
from bayesftc.cosim.ops import absolute, both, either, maximum, select, sqrt

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.controllers.precision.base import Learner
    from bayesftc.cosim.types import Floats, Kernel

EXPLICABLE = 1e12
"""Largest squared innovation, in units of its variance, that a fault explains: a million standard deviations."""

CREDIBLE = 1e30
"""Largest squared sample, in the same units, that can confirm another; a larger double does not resolve the noise."""

NEAR = 0.1
"""Largest change, in units of the innovation, with which a sample confirms the one before."""

PATIENCE = 0.5
"""Seconds for which a sensor must confirm its absurd samples until the belief counts as lost."""

LEAST_SAMPLES = 10
"""Least number of samples in that time, for long sample times."""

ALIKE = 0.99
"""Least squared cosine between the rows of two sensors that measure the same quantity."""

REPEATED = 0.5
"""Samples that a repetition confirms, for a sensor without an ordinary sample yet."""

COUNT, LAST, ORDINARY, ABSURD = range(4)
"""Rows of ``doubts``, with a column for each sensor: samples in a row that confirm each other, the last sample, whether there
has been an ordinary sample, and whether the present one is absurd."""


class Reading(NamedTuple):
    """Samples of the m sensors, the belief's predictions of them, and the reported innovation (NaN: no sample)."""

    y: Floats
    expected: Floats
    innovation: Floats


class Screen(NamedTuple):
    """Parameters and state of the screen for absurd samples.

    Attributes
    ----------
    plant : ndarray of n
        1 for states of the plant, 0 for disturbances and sensors' errors.
    invalid : ndarray, m x any
        Values that mark a missing sample of each sensor.
    witnesses : ndarray, m x m
        1 for other sensors of the same quantity, else 0.
    patience : ndarray of 1
        Samples for which a sensor must confirm its absurd ones.
    certain : ndarray of 1
        Fault probability of a sensor with an absurd sample.
    doubts : ndarray, 4 x m
        The state: rows `COUNT`, `LAST`, `ORDINARY`, `ABSURD`.
    widening : ndarray of 1
        Factor of the belief's standard deviations at the next sample.
    """

    plant: Floats
    invalid: Floats
    witnesses: Floats
    patience: Floats
    certain: Floats
    doubts: Floats
    widening: Floats


def widen(covariance, screen):
    """Multiply the standard deviations of the plant's states; leave those of disturbances and sensors' errors."""
    n = covariance.shape[0]
    for i in range(n):
        factor = 1.0 + screen.plant[i] * (screen.widening[0] - 1.0)
        for j in range(n):
            covariance[i, j] = covariance[i, j] * (factor * (1.0 + screen.plant[j] * (screen.widening[0] - 1.0)))


def screen_samples(reading, sample, screen):
    """Write the samples with NaN for each one that is absurd or has an ``invalid`` value.

    When the belief has just been widened, the unconfirmed samples of sensors that were absurd remain absurd at that step, because
    the wide belief would explain them as well.
    """
    for i in range(reading.y.shape[0]):
        value = reading.y[i]
        for s in range(screen.invalid.shape[1]):
            value = select(reading.y[i] == screen.invalid[i, s], NAN, value)
        d = value - reading.expected[i]
        unconfirmed = both(
            screen.widening[0] > 1.0,
            both(screen.doubts[ABSURD, i] > 0.5, screen.doubts[COUNT, i] <= screen.patience[0]),
        )
        absurd = either(d * d > EXPLICABLE * (sample.spread[i, i] + sample.nominal[i, i]), unconfirmed)
        absurd = both(d - d == 0.0, absurd)
        screen.doubts[ABSURD, i] = select(absurd, 1.0, 0.0)
        sample.y[i] = select(absurd, NAN, value)


def count_doubts(reading, sample, screen):
    """Count how long each sensor has confirmed its absurd samples, and compute the widening of the belief.

    ``widening`` is a factor of standard deviations, 1 while no sensor has confirmed its samples for longer than ``patience``.
    """
    screen.widening[0] = 1.0 + 0.0 * screen.patience[0]
    for i in range(reading.y.shape[0]):
        absurd, present = screen.doubts[ABSURD, i] > 0.5, sample.y[i] - sample.y[i] == 0.0
        contradicted = 0.0 * screen.patience[0]
        for j in range(reading.y.shape[0]):
            contradicted = select(
                sample.y[j] - sample.y[j] == 0.0, maximum(contradicted, screen.witnesses[i, j]), contradicted
            )
        count, last, error = (
            screen.doubts[COUNT, i],
            screen.doubts[LAST, i],
            absolute(reading.y[i] - reading.expected[i]),
        )
        change = absolute(reading.y[i] - last)
        repeated = count + select(screen.doubts[ORDINARY, i] > 0.5, 0.0, REPEATED)
        confirmed = select(change == 0.0, repeated, select(change <= NEAR * error, count + 1.0, 1.0))
        credible = reading.y[i] * reading.y[i] <= CREDIBLE * (sample.spread[i, i] + sample.nominal[i, i])
        confirmed = select(both(credible, contradicted < 0.5), confirmed, 0.0)
        screen.doubts[COUNT, i] = select(absurd, confirmed, select(present, 0.0, count))
        screen.doubts[LAST, i] = select(either(present, absurd), reading.y[i], last)
        screen.doubts[ORDINARY, i] = select(present, 1.0, screen.doubts[ORDINARY, i])
        lost = both(absurd, both(confirmed > screen.patience[0], sample.spread[i, i] > 0.0))
        screen.widening[0] = maximum(
            screen.widening[0], select(lost, error / sqrt(select(lost, sample.spread[i, i], 1.0)), 1.0)
        )


def accept_confirmed(reading, sample, screen):
    """Accept samples that were confirmed for longer than ``patience``, for a belief without a covariance."""
    for i in range(reading.y.shape[0]):
        confirmed = both(screen.doubts[ABSURD, i] > 0.5, screen.doubts[COUNT, i] > screen.patience[0])
        sample.y[i] = select(confirmed, reading.y[i], sample.y[i])
        screen.doubts[ABSURD, i] = select(confirmed, 0.0, screen.doubts[ABSURD, i])


def mark_absurd(screen, fault_probability):
    """Set the fault probability of sensors with absurd samples to ``certain``: 1, or NaN for a learner without probabilities."""
    for i in range(fault_probability.shape[0]):
        fault_probability[i] = select(screen.doubts[ABSURD, i] > 0.5, screen.certain[0], fault_probability[i])


def raise_no_alarm(doubts, outputs):
    """Leave the outputs as they are, for a learner without detection."""


@cache
def _make_alarm(first: int) -> Kernel:
    def raise_alarm(doubts, outputs):
        """Set the detection of sensors with absurd samples."""
        for i in range(doubts.shape[1]):
            outputs[first + i] = select(doubts[ABSURD, i] > 0.5, 1.0, outputs[first + i])

    return raise_alarm


def alarm_of(learner: Learner, first: int) -> Kernel:
    """Return the step function that sets the learner's output ``detected``, if it exists, for absurd samples.

    Parameters
    ----------
    learner : Learner
        The learner of the block.
    first : int
        Index of its first output among all outputs.
    """
    for port in learner.ports:
        if port.name == "detected":
            return _make_alarm(first)
        first += port.size
    return raise_no_alarm


def screening(block: Any, model: LinearModel) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return state and parameters of the screen.

    Parameters
    ----------
    block : controller or estimator
        It has the settings ``precision`` and ``invalid``.
    model : LinearModel
        The model of the sensors; for a nonlinear model its linearisation.
    """
    m = model.sensors
    doubts = np.zeros((4, m))
    state = {"doubts": doubts, "widening": 1.0}
    plant = model.states - model.disturbances
    parameters = {
        "plant": (np.arange(model.states) < plant).astype(np.float64),
        "invalid": invalid_values(type(block).__name__, block.invalid, m),
        "witnesses": _witnesses(model.quantities[:, :plant]),
        "patience": float(max(math.ceil(PATIENCE / model.step), LEAST_SAMPLES)),
        "certain": 1.0 if block.precision.why_no_probability is None else NAN,
    }
    return state, parameters


def _witnesses(rows: Floats) -> Floats:
    """Return for each pair of sensors whether they measure the same quantity (1 or 0), from their rows of C."""
    lengths = np.linalg.norm(rows, axis=1)
    alike = (rows @ rows.T) ** 2 >= ALIKE * np.outer(lengths, lengths) ** 2
    nonzero = np.outer(lengths, lengths) > 0
    np.fill_diagonal(alike, False)
    return np.asarray(alike & nonzero, dtype=np.float64)
