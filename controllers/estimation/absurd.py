"""Samples that no fault of the model explains: they count as missing, and their sensor as faulty at that sample.

A sample is absurd if its innovation is more than a million of its standard deviations: 1e20, the largest integer or float of a
device, a value in other units. Weights can be capped, the innovation of such a sample cannot: it would move belief and learner
for minutes. So the learner, the update and all else see a missing sample.

The belief may be what is wrong, and then every sample is absurd. A sensor confirms its absurd samples by further ones that lie
near the one before, but do not repeat it: a device that has failed repeats one value. A repetition confirms half a sample for
a sensor that has sent no ordinary sample yet: a healthy sensor at rest repeats itself, and the initial mean is in doubt then.
Nothing is confirmed while another sensor of the same quantity sends ordinary samples, nor beyond what is `CREDIBLE`. After
`PATIENCE` the belief is taken for lost: it is widened until the sample is an ordinary one. A belief without a covariance takes
the samples as they are, after the same time.
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
"""Largest squared sample, in the same units, that can confirm another: a larger double does not resolve its own noise."""

NEAR = 0.1
"""Largest change since the sample before, in units of the innovation, with which a sample confirms that one."""

PATIENCE = 0.5
"""Seconds for which a sensor must confirm its absurd samples until the belief is taken for lost."""

LEAST_SAMPLES = 10
"""Least number of samples in that time: the sample time may be long."""

ALIKE = 0.99
"""Least squared cosine between the rows of two sensors that measure the same quantity."""

REPEATED = 0.5
"""What a repeated sample of a sensor confirms that has sent no ordinary one yet."""

COUNT, LAST, HEARD, ABSURD = range(4)
"""Rows of ``doubts``, with a column for each sensor: samples in a row that confirm each other, the last sample, whether there
has been an ordinary one, and whether this one is absurd."""


class Reading(NamedTuple):
    """What the m sensors deliver, what the belief expects of them, and the difference as it is reported (NaN: no sample)."""

    y: Floats
    expected: Floats
    innovation: Floats


class Screen(NamedTuple):
    """What tells absurd samples.

    Attributes
    ----------
    plant : ndarray of n
        Which states are the plant's own (1 or 0), not a disturbance or a sensor's error.
    invalid : ndarray, m x any
        Values that each device sends in place of a sample.
    witnesses : ndarray, m x m
        Which other sensors measure the same quantity (1 or 0).
    patience : ndarray of 1
        Samples for which a sensor must confirm its absurd ones.
    certain : ndarray of 1
        The probability of a fault of a sensor with an absurd sample.
    doubts : ndarray, 4 x m
        The state: rows `COUNT`, `LAST`, `HEARD`, `ABSURD`.
    widening : ndarray of 1
        Factor by which the belief's standard deviations are widened next.
    """

    plant: Floats
    invalid: Floats
    witnesses: Floats
    patience: Floats
    certain: Floats
    doubts: Floats
    widening: Floats


def widen(covariance, screen):
    """Multiply the standard deviations of the plant's states; those of disturbances and sensors' errors stay."""
    n = covariance.shape[0]
    for i in range(n):
        own = 1.0 + screen.plant[i] * (screen.widening[0] - 1.0)
        for j in range(n):
            covariance[i, j] = covariance[i, j] * (own * (1.0 + screen.plant[j] * (screen.widening[0] - 1.0)))


def screen_samples(reading, sample, screen):
    """Write the samples as they count: NaN for one that is absurd or has an ``invalid`` value.

    Once the belief has been
    widened, the samples of sensors that were absurd and have not confirmed it stay absurd at that step: a wide belief explains
    them as well.
    """
    for i in range(reading.y.shape[0]):
        told = reading.y[i]
        for s in range(screen.invalid.shape[1]):
            told = select(reading.y[i] == screen.invalid[i, s], NAN, told)
        d = told - reading.expected[i]
        unconfirmed = both(
            screen.widening[0] > 1.0,
            both(screen.doubts[ABSURD, i] > 0.5, screen.doubts[COUNT, i] <= screen.patience[0]),
        )
        absurd = either(d * d > EXPLICABLE * (sample.spread[i, i] + sample.nominal[i, i]), unconfirmed)
        absurd = both(d - d == 0.0, absurd)
        screen.doubts[ABSURD, i] = select(absurd, 1.0, 0.0)
        sample.y[i] = select(absurd, NAN, told)


def count_doubts(reading, sample, screen):
    """Count how long each sensor has confirmed its absurd samples, and compute by how much the belief is to be widened.

    ``widening`` is a factor of standard deviations, 1 while no sensor has confirmed its samples for longer than ``patience``.
    """
    screen.widening[0] = 1.0 + 0.0 * screen.patience[0]
    for i in range(reading.y.shape[0]):
        absurd, there = screen.doubts[ABSURD, i] > 0.5, sample.y[i] - sample.y[i] == 0.0
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
        repeated = count + select(screen.doubts[HEARD, i] > 0.5, 0.0, REPEATED)
        confirmed = select(change == 0.0, repeated, select(change <= NEAR * error, count + 1.0, 1.0))
        credible = reading.y[i] * reading.y[i] <= CREDIBLE * (sample.spread[i, i] + sample.nominal[i, i])
        confirmed = select(both(credible, contradicted < 0.5), confirmed, 0.0)
        screen.doubts[COUNT, i] = select(absurd, confirmed, select(there, 0.0, count))
        screen.doubts[LAST, i] = select(either(there, absurd), reading.y[i], last)
        screen.doubts[HEARD, i] = select(there, 1.0, screen.doubts[HEARD, i])
        lost = both(absurd, both(confirmed > screen.patience[0], sample.spread[i, i] > 0.0))
        screen.widening[0] = maximum(
            screen.widening[0], select(lost, error / sqrt(select(lost, sample.spread[i, i], 1.0)), 1.0)
        )


def listen(reading, sample, screen):
    """Let samples count that their sensor has confirmed for longer than ``patience``: for a belief without a covariance."""
    for i in range(reading.y.shape[0]):
        confirmed = both(screen.doubts[ABSURD, i] > 0.5, screen.doubts[COUNT, i] > screen.patience[0])
        sample.y[i] = select(confirmed, reading.y[i], sample.y[i])
        screen.doubts[ABSURD, i] = select(confirmed, 0.0, screen.doubts[ABSURD, i])


def blame(screen, fault_probability):
    """Give the sensors of absurd samples the probability ``certain``: 1, or NaN for a learner that gives no probability."""
    for i in range(fault_probability.shape[0]):
        fault_probability[i] = select(screen.doubts[ABSURD, i] > 0.5, screen.certain[0], fault_probability[i])


def raise_no_alarm(doubts, outputs):
    """Leave the outputs as they are: the learner detects nothing."""


@cache
def _make_alarm(first: int) -> Kernel:
    def raise_alarm(doubts, outputs):
        """Count the sensors of absurd samples as detected."""
        for i in range(doubts.shape[1]):
            outputs[first + i] = select(doubts[ABSURD, i] > 0.5, 1.0, outputs[first + i])

    return raise_alarm


def alarm_of(learner: Learner, first: int) -> Kernel:
    """Return the step function that sets the learner's output ``detected`` for absurd samples, if it has one.

    Parameters
    ----------
    learner : Learner
        What has the output.
    first : int
        Where its outputs begin among all outputs.
    """
    for port in learner.ports:
        if port.name == "detected":
            return _make_alarm(first)
        first += port.size
    return raise_no_alarm


def screening(block: Any, model: LinearModel) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the state and the parameters that these step functions need.

    Parameters
    ----------
    block : controller or estimator
        With the settings ``precision`` and ``invalid``.
    model : LinearModel
        Of the sensors; of a nonlinear model, where it is linearised.
    """
    m = model.sensors
    doubts = np.zeros((4, m))
    state = {"doubts": doubts, "widening": 1.0}
    plant = model.states - model.disturbances
    parameters = {
        "plant": (np.arange(model.states) < plant).astype(np.float64),
        "invalid": invalid_values(type(block).__name__, block.invalid, m),
        "witnesses": _witnesses(model.matrix("C")[:, :plant]),
        "patience": float(max(math.ceil(PATIENCE / model.step), LEAST_SAMPLES)),
        "certain": 1.0 if block.precision.why_no_probability is None else NAN,
    }
    return state, parameters


def _witnesses(rows: Floats) -> Floats:
    """Return for each sensor which other ones measure the same quantity (1 or 0), from their rows of states."""
    lengths = np.linalg.norm(rows, axis=1)
    alike = (rows @ rows.T) ** 2 >= ALIKE * np.outer(lengths, lengths) ** 2
    seen = np.outer(lengths, lengths) > 0
    np.fill_diagonal(alike, False)
    return np.asarray(alike & seen, dtype=np.float64)
