"""Step functions on one hypothesis of a bank: prediction, merging two into one, and a sample of one sensor.

A hypothesis is in ``memory`` from ``at`` on: its `PROBABILITY`, the mean `OFFSET_AGE` in samples, from `STATE` on the mean of
z = [deviation of the state from the controller's prediction (n), offset c, its change b per sample], then z's covariance (a table
of n + 2), then the values of each sensor (``sensor_kernels.py``). The hypothesis without an offset does not change c and b.
"""

from typing import NamedTuple

from bayesftc.controllers.estimation.filter import MEAN_CAP
from bayesftc.controllers.switching.mode_kernels import WEIGHT
from bayesftc.controllers.switching.sensor_kernels import HEALTHY, LEAST
from bayesftc.cosim.ops import absolute, both, maximum, select, sqrt
from bayesftc.cosim.types import Floats

PROBABILITY, OFFSET_AGE, STATE = 0, 1, 2

FADED = 100.0
"""Largest variance up to which a belief fades: of a reading in units of the noise variance, else unseen states would diverge;
and of a state in units of its variance without any sample (`most_variances`)."""

VAGUE = 2.0
"""Variance of a reading, in units of another hypothesis's variance of the sample, from which on a belief is `vague` beside it."""


class Onset(NamedTuple):
    """Mean of an offset at its onset, covariance of it and its slope, and variance of its random walk per sample."""

    c: float
    cc: float
    cb: float
    bb: float
    walk: float


NO_OFFSET = Onset(0.0, 0.0, 0.0, 0.0, 0.0)


class Moving(NamedTuple):
    """The model's matrices A and Q, the belief before the ``first`` sample, and the ``largest`` variance of a belief."""

    A: Floats
    Q: Floats
    first: bool
    covariance: Floats
    largest: float


class Places(NamedTuple):
    """Places in memory of the offset's effect on the state, of its other inputs, and of scratch space."""

    couples: int
    shift: int
    scratch: int


def move(memory, at, n, offset, slides, onset, moving, places):
    """Predict a hypothesis one sample ahead: the state by the model, the offset by its slope if it ``slides``.

    The offset moves the state by the values at ``couples``, all else by those at ``shift``. Before the ``first`` sample the
    belief is the controller's ``covariance``, and so after a loss: a variance above the ``largest`` or below zero. The offset is
    then that of its onset: ``c`` and the covariance ``cc``, ``cb``, ``bb``.
    """
    c, cc, cb, bb, walk = onset
    A, Q, first, covariance, largest = moving
    couples, shift, scratch = places
    N, used = n + 2, n + 2 * offset
    z, P = at + STATE, at + STATE + n + 2
    for a in range(n):
        total = memory[shift + a]
        for s in range(n):
            total = total + A[a, s] * memory[z + s]
        if offset:
            total = total + memory[couples + a] * memory[z + n]
        memory[scratch + a] = total
    for a in range(n):
        memory[z + a] = select(first, 0.0, memory[scratch + a])
    if offset and slides:
        memory[z + n] = memory[z + n] + memory[z + n + 1]
    for a in range(used):
        for b in range(used):
            if a < n:
                total = 0.0 * walk
                for s in range(n):
                    total = total + A[a, s] * memory[P + s * N + b]
                if offset:
                    total = total + memory[couples + a] * memory[P + n * N + b]
            elif a == n and slides:
                total = memory[P + n * N + b] + memory[P + (n + 1) * N + b]
            else:
                total = memory[P + a * N + b]
            memory[scratch + a * N + b] = total
    for a in range(used):
        for b in range(a + 1):
            if b < n:
                total = 0.0 * walk
                for s in range(n):
                    total = total + A[b, s] * memory[scratch + a * N + s]
                if offset:
                    total = total + memory[couples + b] * memory[scratch + a * N + n]
            elif b == n and slides:
                total = memory[scratch + a * N + n] + memory[scratch + a * N + n + 1]
            else:
                total = memory[scratch + a * N + b]
            if a < n:
                total = select(first, covariance[a, b], total + Q[a, b])
            elif a == n and b == n:
                total = total + walk
            memory[P + a * N + b] = total
            memory[P + b * N + a] = total
    # If absurd samples have moved the means so far apart that rounding destroys the covariance, the hypothesis is reset.
    sound = absolute(memory[z]) <= MEAN_CAP
    for a in range(used):
        sound = both(sound, both(memory[P + a * N + a] >= 0.0, memory[P + a * N + a] <= largest))
        sound = both(sound, absolute(memory[z + a]) <= MEAN_CAP)
        for b in range(a):
            between, most = memory[P + a * N + b], memory[P + a * N + a] * memory[P + b * N + b]
            sound = both(sound, between * between <= most * (1.0 + 1e-6))
    for a in range(used):
        memory[z + a] = select(sound, memory[z + a], c if a == n else 0.0)
        for b in range(used):
            anew = 0.0 * largest
            if a < n and b < n:
                anew = anew + covariance[a, b]
            elif a == n and b == n:
                anew = anew + cc
            elif a > n and b > n:
                anew = anew + bb
            elif a >= n and b >= n:
                anew = anew + cb
            memory[P + a * N + b] = select(sound, memory[P + a * N + b], anew)


def ended(end, age, haste):
    """Return the probability that a fault of this ``age`` ends with a sample; ``end`` is the inverse of the mean duration.

    Both are counted in samples. The duration has a Lomax distribution of shape 1 + 1 / haste, whose hazard decreases with the
    age. With a haste of 0 it is exponential, and the age has no effect.
    """
    return end * (1.0 + haste) / (1.0 + haste * age * end)


def blend(memory, at, part, other, n, offset, c, b, cc, cb, bb):
    """Merge another belief about the state into a hypothesis, with its ``part`` of the probability, by moments.

    With an ``offset``, its mean, slope and their covariance are merged as well, independent of the state.
    """
    N = n + 2
    z, P, y, R = at + STATE, at + STATE + N, other + STATE, other + STATE + N
    around = part * (1.0 - part)
    if offset:
        dc, db = c - memory[z + n], b - memory[z + n + 1]
        for a in range(n):
            da = memory[y + a] - memory[z + a]
            memory[P + a * N + n] = (1.0 - part) * memory[P + a * N + n] + around * da * dc
            memory[P + a * N + n + 1] = (1.0 - part) * memory[P + a * N + n + 1] + around * da * db
            memory[P + n * N + a] = memory[P + a * N + n]
            memory[P + (n + 1) * N + a] = memory[P + a * N + n + 1]
        at_c, at_b = P + n * N + n, P + (n + 1) * N + n + 1
        memory[at_c] = memory[at_c] + part * (cc - memory[at_c]) + around * dc * dc
        memory[at_c + 1] = memory[at_c + 1] + part * (cb - memory[at_c + 1]) + around * dc * db
        memory[at_b - 1] = memory[at_c + 1]
        memory[at_b] = memory[at_b] + part * (bb - memory[at_b]) + around * db * db
        memory[z + n] = memory[z + n] + part * dc
        memory[z + n + 1] = memory[z + n + 1] + part * db
    for a in range(n):
        da = memory[y + a] - memory[z + a]
        for s in range(a + 1):
            ds = memory[y + s] - memory[z + s]
            healthy = P + a * N + s
            memory[healthy] = memory[healthy] + part * (memory[R + a * N + s] - memory[healthy]) + around * da * ds
            memory[P + s * N + a] = memory[healthy]
    for a in range(n):
        memory[z + a] = memory[z + a] + part * (memory[y + a] - memory[z + a])


def blend_between(memory, at, part, other, n):
    """Merge the covariance of the other's offset and slope with the state as well."""
    N = n + 2
    P, R = at + STATE + N, other + STATE + N
    for a in range(n):
        for b in range(n, N):
            memory[P + a * N + b] = memory[P + a * N + b] + part * memory[R + a * N + b]
            memory[P + b * N + a] = memory[P + a * N + b]


def blend_healthy(memory, at, part, first, width, spans):
    """Merge a healthy sensor into a hypothesis's values of a sensor; modes of span 0 keep their probability."""
    memory[at + HEALTHY] = memory[at + HEALTHY] + part * (1.0 - memory[at + HEALTHY])
    for k in range(len(spans)):
        if spans[k] > 0:
            weight = at + first + k * width + WEIGHT
            memory[weight] = maximum((1.0 - part) * memory[weight], LEAST)


def inflate(memory, at, n, plant, more, fades, Q, settings, most):
    """Increase the covariance of the plant's states, the first ones, in a hypothesis.

    It grows by the part ``fades`` of itself, and then by ``more`` times the process noise. A state whose variance has reached
    its value in ``settings`` from ``most`` on does not fade.
    """
    P, N, faded = at + STATE + n + 2, n + 2, sqrt(1.0 + fades)
    for a in range(plant):
        grows = select(memory[P + a * N + a] < settings[most + a], faded, 1.0)
        for b in range(n):
            memory[P + a * N + b] = memory[P + a * N + b] * grows
            memory[P + b * N + a] = memory[P + b * N + a] * grows
    for a in range(plant):
        for b in range(plant):
            memory[P + a * N + b] = memory[P + a * N + b] + more * Q[a, b]


def spread(memory, at, n, C, sensor):
    """Return the variance of a sensor's reading without its noise."""
    P, N = at + STATE + n + 2, n + 2
    variance = 0.0 * memory[P]
    for a in range(n):
        for b in range(n):
            variance = variance + C[sensor, a] * memory[P + a * N + b] * C[sensor, b]
    return variance


def measurable(memory, at, n, C, nominal):
    """Return 1 while a sample of any sensor would leave enough of a hypothesis, else 0.

    The limit is `FADED` times the variance of the sensor's noise.
    """
    fresh = 1.0 + 0.0 * memory[at + STATE + n + 2]
    for i in range(nominal.shape[0]):
        fresh = select(spread(memory, at, n, C, i) <= FADED * nominal[i, i], fresh, 0.0)
    return fresh


def vague(memory, at, other, n, C, nominal):
    """Return 1 if a belief predicts the sample of any sensor far worse than the ``other`` one, else 0."""
    worse = 0.0 * memory[at + STATE + n + 2]
    for i in range(nominal.shape[0]):
        usual = nominal[i, i] + spread(memory, other, n, C, i)
        worse = select(spread(memory, at, n, C, i) > VAGUE * usual, 1.0, worse)
    return worse


def expect(memory, at, n, offset, reads, sensor, C, direction):
    """Write the covariance of z with a sensor's reading (at ``direction``); return the variance and mean of the reading.

    With an ``offset``, it is part of the reading if the sensor ``reads`` it.
    """
    N, used = n + 2, n + 2 * offset
    z, P = at + STATE, at + STATE + n + 2
    mean = C[sensor, 0] * memory[z]
    for s in range(1, n):
        mean = mean + C[sensor, s] * memory[z + s]
    if reads:
        mean = mean + memory[z + n]
    for a in range(used):
        total = C[sensor, 0] * memory[P + a * N]
        for s in range(1, n):
            total = total + C[sensor, s] * memory[P + a * N + s]
        if reads:
            total = total + memory[P + a * N + n]
        memory[direction + a] = total
    variance = C[sensor, 0] * memory[direction]
    for s in range(1, n):
        variance = variance + C[sensor, s] * memory[direction + s]
    if reads:
        variance = variance + memory[direction + n]
    return maximum(variance, 0.0), mean


def correct(memory, at, n, offset, reads, sensor, C, direction, error, total, noise, present):
    """Condition a hypothesis on a sensor's sample, by Kalman's update in Joseph's form; ``total`` is the error's variance."""
    N, used = n + 2, n + 2 * offset
    z, P = at + STATE, at + STATE + n + 2
    gain, left = direction + N, direction + 2 * N
    part = present / total
    for a in range(used):
        memory[gain + a] = memory[direction + a] * part
        memory[z + a] = memory[z + a] + memory[gain + a] * error
    for a in range(used):
        for b in range(used):
            memory[P + a * N + b] = memory[P + a * N + b] - memory[gain + a] * memory[direction + b]
    for a in range(used):
        product = C[sensor, 0] * memory[P + a * N]
        for s in range(1, n):
            product = product + C[sensor, s] * memory[P + a * N + s]
        if reads:
            product = product + memory[P + a * N + n]
        memory[left + a] = product
    for a in range(used):
        for b in range(a + 1):
            change = (noise * memory[gain + a] - memory[left + a]) * memory[gain + b]
            memory[P + a * N + b] = memory[P + a * N + b] + change
            memory[P + b * N + a] = memory[P + a * N + b]
