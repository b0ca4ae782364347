"""A bank of hypotheses about offsets, each with its own belief about state and offset together: the joint form of switching.

One hypothesis has no offset; each other one has an offset of one kind on one sensor, which is estimated together with the state,
so that a drift of one sensor is told from the state's own motion. All that needs no moments together with the state (frozen,
noisier, dropped out, and the offsets of *further* sensors) each hypothesis keeps sensor by sensor, as the per-sensor form does.
So there are 1 + m K of them for K kinds of offsets, however many sensors fail at once.

At each sample every hypothesis moves; then offsets begin and end. What has ended is merged first (the pool) and goes on from
there: to no offset, or to the offset that a further sensor has meanwhile. Beliefs that arrive at the same hypothesis are merged
by moments, as in an interacting-multiple-model filter (Blom and Bar-Shalom 1988). Then each hypothesis is conditioned on the
sensors one after the other, and gets the probability of what they said.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from bayesftc.controllers._bank_kernels import (
    OFFSET_AGE,
    PROBABILITY,
    STATE,
    blend,
    blend_healthy,
    blend_sensor,
    correct,
    expect,
    length_of,
    move,
)  # fmt: skip
from bayesftc.controllers._mode_kernels import AGE, LOG_2_PI, OWN, SIZE, TRUST, WEIGHT
from bayesftc.controllers._switching_kernels import (
    BEGINS,
    ENDS,
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LAST,
    LEAST,
    LEAST_TRUST,
    MODE_ARRIVES,
    MODE_MISSING,
    OWN_SETTINGS,
    TRUSTED,
    failed,
    held,
    share_of,
    use_trust,
)  # fmt: skip
from bayesftc.cosim.block import Floats
from bayesftc.cosim.ops import log, maximum, minimum, select

EXPIRES = 0.02
"""Probability per sample with which a drift ends that no other sensor bears witness to: it may as well be the state's motion."""

ABSURD = 1e12
"""Largest variance of an innovation, in the sensor's own, up to which a larger innovation is learned from: beyond it hypotheses
would carry each other away."""


def start_bank(n: int, m: int, kinds: int, sensors: Floats) -> Floats:
    """Return what a bank keeps before the first sample: no offset, and of each sensor what the per-sensor form keeps.

    Parameters
    ----------
    n, m, kinds : int
        Numbers of states, sensors and kinds of offsets.
    sensors : ndarray
        What the per-sensor form keeps of all sensors.
    """
    hypothesis = np.zeros(length_of(n, len(sensors)))
    hypothesis[len(hypothesis) - len(sensors) :] = sensors
    hypotheses = np.tile(hypothesis, (2 + m * kinds, 1))  # the last one is the pool
    hypotheses[:, PROBABILITY] = [1.0, *[LEAST] * (1 + m * kinds)]
    scratch = (n + 2) ** 2 + m * kinds + 1 + m * kinds
    return np.concatenate([hypotheses.ravel(), np.zeros(scratch)])


@cache
def make_infer(
    pass_alone: Callable[..., None], weigh_alone: Callable[..., float],
    pass_other: Callable[..., None], weigh_other: Callable[..., float],
    kinds: tuple[int, ...], slow: tuple[int, ...], alone: tuple[int, ...], other: tuple[int, ...], faults: tuple[int, ...],
    width: int, width_of_settings: int,
) -> Callable[..., None]:  # fmt: skip
    """Return the step function that infers state and faults together.

    Parameters
    ----------
    pass_alone, weigh_alone : function
        Time passing and weighing of a sensor's modes where no sensor has an offset.
    pass_other, weigh_other : function
        The same of the other sensors where one has an offset.
    kinds : tuple of int
        Which of the modes are offsets.
    slow : tuple of int
        For each of these, whether other sensors must bear witness (1 or 0).
    alone, other : tuple of int
        For each mode how much of its block counts where no sensor has an offset, and of the other sensors where one has; 0 if it
        takes no part.
    faults : tuple of int
        For each mode whether it is a fault (1 or 0).
    width, width_of_settings : int
        Widths of the blocks of modes.
    """
    K, modes = len(kinds), len(alone)
    length, row_length = FIRST + modes * width, FIRST_SETTINGS + modes * width_of_settings

    def witnessed(memory, sensors, m, i):
        """Return the probability that a sensor other than ``i`` is healthy."""
        none = 1.0 + 0.0 * memory[sensors + HEALTHY]
        for j in range(m):
            if j != i:
                none = none * (1.0 - minimum(memory[sensors + j * length + HEALTHY], 1.0))
        return 1.0 - none

    def infer(
        y, e, present, nominal, A, C, Q, mean, covariance, largest, memory, settings,
        R, used, precision, beta, fault_probability, x_hat, P,
    ):  # fmt: skip
        n, m = C.shape[1], C.shape[0]
        H, N = 1 + m * K, n + 2
        first_bank = m * length + 1
        stride = length_of(n, m * length)
        kept = STATE + N + N * N  # where in a hypothesis the sensors stand
        pool = first_bank + H * stride
        scratch = pool + stride
        grow = scratch + N * N
        told = grow + m * K
        count = memory[m * length]
        start = count < 0.5

        # Time passes: what each sensor's modes do in it, how the state and the offset move, what begins and what ends.
        none = first_bank
        for i in range(m):
            seen = witnessed(memory, none + kept, m, i)
            for q in range(K):
                begin = settings[i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + BEGINS]
                healthy = memory[none + kept + i * length + HEALTHY]
                memory[grow + i * K + q] = memory[none] * healthy * begin * (seen if slow[q] else 1.0)
        for i in range(m):
            pass_alone(memory, none + kept + i * length, settings, i * row_length)
        move(memory, none, n, 0, 0.0, 0.0, 0.0, A, Q, start, covariance, largest[0], scratch)
        memory[pool + PROBABILITY] = 0.0 * count
        for i in range(m):
            for q in range(K):
                at = first_bank + (1 + i * K + q) * stride
                row = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings
                seen = witnessed(memory, at + kept, m, i)
                for j in range(m):
                    if j != i:
                        pass_other(memory, at + kept + j * length, settings, j * row_length)
                jump, slope = (
                    settings[row + OWN_SETTINGS] * nominal[i, i],
                    settings[row + OWN_SETTINGS + 1] * nominal[i, i],
                )
                walk = settings[row + OWN_SETTINGS + 2] * nominal[i, i]
                move(memory, at, n, 1, jump, slope, walk, A, Q, start, covariance, largest[0], scratch)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                end = settings[row + ENDS] + ((1.0 - seen) * EXPIRES if slow[q] else 0.0)
                ended = memory[at] * end
                memory[at] = maximum(memory[at] - ended, LEAST)
                both = memory[pool] + ended
                part = ended / both
                memory[pool] = both
                blend(memory, pool, part, at, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
                for j in range(m):
                    to = pool + kept + j * length
                    if j == i:
                        blend_healthy(memory, to, part, FIRST, width, modes)
                    else:
                        blend_sensor(memory, to, part, at + kept + j * length, 1.0, FIRST, width, other)
        stays = memory[none]
        left = memory[pool]
        for i in range(m):
            for q in range(K):
                at = first_bank + (1 + i * K + q) * stride
                row = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings
                jump, slope = (
                    settings[row + OWN_SETTINGS] * nominal[i, i],
                    settings[row + OWN_SETTINGS + 1] * nominal[i, i],
                )
                walk = settings[row + OWN_SETTINGS + 2] * nominal[i, i]
                came = memory[grow + i * K + q]
                stays = stays - came
                part = came / (memory[at] + came)
                memory[at] = memory[at] + came
                blend(memory, at, part, none, n, 1, 0.0, 0.0, jump + slope, slope, slope)
                memory[at + OFFSET_AGE] = (1.0 - part) * memory[at + OFFSET_AGE]
                for j in range(m):
                    if j != i:
                        own = at + kept + j * length
                        blend_sensor(memory, own, part, none + kept + j * length, 1.0, FIRST, width, other)
                # A further sensor's offset that was known sensor by sensor goes on alone.
                block = pool + kept + i * length + FIRST + kinds[q] * width
                came = memory[pool] * memory[block + WEIGHT]
                left = left - came
                part = came / (memory[at] + came)
                memory[at] = memory[at] + came
                c, b = memory[block + SIZE] + memory[block + OWN], memory[block + OWN]
                bb = memory[block + OWN + 3]
                cb = memory[block + OWN + 2] + bb
                cc = memory[block + OWN + 1] + memory[block + OWN + 2] + cb + walk
                blend(memory, at, part, pool, n, 1, c, b, cc, cb, bb)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + part * (
                    memory[block + AGE] - memory[at + OFFSET_AGE]
                )
                for j in range(m):
                    if j != i:
                        own = at + kept + j * length
                        blend_sensor(memory, own, part, pool + kept + j * length, 1.0, FIRST, width, other)
        stays, left = maximum(stays, LEAST), maximum(left, LEAST)
        part = left / (stays + left)
        memory[none] = stays + left
        blend(memory, none, part, pool, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(m):
            of_pool = pool + kept + j * length
            rest = 1.0 + 0.0 * left
            for q in range(K):
                rest = rest - memory[of_pool + FIRST + kinds[q] * width + WEIGHT]
            own = none + kept + j * length
            blend_sensor(memory, own, part, of_pool, 1.0 / maximum(rest, 1e-3), FIRST, width, alone)

        # The samples: each hypothesis is conditioned on one sensor after the other.
        for h in range(H):
            at = first_bank + h * stride
            total_told = 0.0 * count
            for i in range(m):
                error_of_none = e[i]
                change = y[i] - memory[i * length + LAST]
                variance = nominal[i, i]
                row = i * row_length
                if h > 0 and (h - 1) // K == i:
                    spread, expected = expect(memory, at, n, 1, 1, i, C, scratch)
                    total = spread + variance
                    error = held(error_of_none - expected, minimum(total, ABSURD * variance))
                    own = row + FIRST_SETTINGS + kinds[(h - 1) % K] * width_of_settings
                    density = settings[own + MODE_ARRIVES] - 0.5 * (error * error / total + log(total) + LOG_2_PI)
                    total_told = total_told + select(present[i] > 0.5, density, settings[own + MODE_MISSING])
                    correct(memory, at, n, 1, 1, i, C, scratch, error, total, variance, present[i])
                else:
                    offset = 1 if h > 0 else 0
                    spread, expected = expect(memory, at, n, offset, 0, i, C, scratch)
                    healthy = spread + variance
                    error = held(error_of_none - expected, minimum(healthy, ABSURD * variance))
                    sensor = at + kept + i * length
                    if h == 0:
                        density = weigh_alone(
                            error, present[i], healthy, variance, change, memory, sensor, settings, row
                        )
                    else:
                        density = weigh_other(
                            error, present[i], healthy, variance, change, memory, sensor, settings, row
                        )
                    total_told = total_told + density
                    noise = variance / memory[sensor + TRUSTED]
                    correct(memory, at, n, offset, 0, i, C, scratch, error, spread + noise, noise, present[i])
            memory[told + h] = total_told

        # Probabilities of the hypotheses, and the belief that all of them make together.
        most = memory[told]
        for h in range(1, H):
            most = maximum(most, memory[told + h])
        total = 0.0 * most
        for h in range(H):
            at = first_bank + h * stride
            memory[at] = memory[at] * share_of(memory[told + h], most)
            total = total + memory[at]
        for h in range(H):
            memory[first_bank + h * stride] = maximum(memory[first_bank + h * stride] / total, LEAST)
        for a in range(n):
            total = memory[first_bank] * memory[first_bank + STATE + a]
            for h in range(1, H):
                at = first_bank + h * stride
                total = total + memory[at] * memory[at + STATE + a]
            memory[scratch + a] = total
            x_hat[a] = mean[a] + total
        for h in range(H):
            at = first_bank + h * stride
            for a in range(n):
                memory[at + STATE + a] = memory[at + STATE + a] - memory[scratch + a]
        for a in range(n):
            for b in range(a + 1):
                total = 0.0 * count
                for h in range(H):
                    z = first_bank + h * stride + STATE
                    apart = memory[z + a] * memory[z + b]
                    total = total + memory[z - STATE] * (memory[z + N + a * N + b] + apart)
                P[a, b] = total
                P[b, a] = total

        # What they say of each sensor, kept in the places of the per-sensor form.
        for i in range(m):
            sensor = i * length
            healthy, trust = 0.0 * count, 0.0 * count
            for h in range(H):
                if h == 0 or (h - 1) // K != i:
                    at = first_bank + h * stride
                    healthy = healthy + memory[at] * memory[at + kept + sensor + HEALTHY]
                    trust = trust + memory[at] * memory[at + kept + sensor + TRUSTED]
            for k in range(modes):
                block = FIRST + k * width
                weight, trusted, size, age = 0.0 * count, 0.0 * count, 0.0 * count, 0.0 * count
                for h in range(H):
                    at = first_bank + h * stride
                    if h == 0 or (h - 1) // K != i:
                        own = at + kept + sensor + block
                        p = memory[at] * memory[own + WEIGHT]
                        size = size + p * memory[own + SIZE]
                        age = age + p * memory[own + AGE]
                        trusted = trusted + p * memory[own + TRUST]
                        weight = weight + p
                    elif kinds[(h - 1) % K] == k:
                        size = size + memory[at] * memory[at + STATE + n]
                        age = age + memory[at] * memory[at + OFFSET_AGE]
                        weight = weight + memory[at]
                own = sensor + block
                memory[own + WEIGHT] = weight
                memory[own + SIZE] = size / weight
                memory[own + AGE] = age / weight
                memory[own + TRUST] = trusted / weight
            memory[sensor + HEALTHY] = healthy
            memory[sensor + TRUSTED] = maximum(minimum(trust, 1.0), LEAST_TRUST)
            memory[sensor + LAST] = select(present[i] > 0.5, y[i], memory[sensor + LAST])
            use_trust(memory, length, i, present, nominal, R, used, precision, beta)
            fault_probability[i] = failed(memory, sensor, width, faults)
        memory[m * length] = count + 1.0

    return infer
