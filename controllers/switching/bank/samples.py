"""Conditioning of a bank of hypotheses on samples, and the estimate of all hypotheses together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.precision.base import NAN
from bayesftc.controllers.switching.bank.calm import make_credit, make_notice
from bayesftc.controllers.switching.bank.conditioning import ABSURD, make_condition, make_review
from bayesftc.controllers.switching.bank.hypothesis import OFFSET_AGE, STATE, expect
from bayesftc.controllers.switching.bank.layout import (
    ABSOLUTE,
    ACTUATOR_SETTINGS,
    BY_COURSE,
    BY_MODES,
    LOAD,
    OF_MODES,
    PUSHES,
    RELATIVE,
    STEERS,
    TAKES,
    WORKS,
    Layout,
)
from bayesftc.controllers.switching.course import follow, misfit, repeats_share, stuck
from bayesftc.controllers.switching.mode_kernels import AGE, SIZE, TRUST, WEIGHT, log_density
from bayesftc.controllers.switching.sensor_kernels import (
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LAST,
    LEAST,
    LEAST_TRUST,
    MODE_ARRIVES,
    MODE_MISSING,
    NOISE,
    OWN_SETTINGS,
    TRUSTED,
    WIDTH,
    as_coarse,
    at_rest,
    held,
    indifferent,
    is_fine,
    learn_noise,
    learn_repeats,
    not_less,
    repetition,
    share_of,
)
from bayesftc.cosim.ops import absolute, both, independent, log, maximum, minimum, select, sqrt

LEAST_EFFECT, MOST_EFFECT = 0.1, 2.0
"""Least and largest effectiveness that the control law uses; a smaller one would require impossible controls."""

LOUD = 1.5
"""Learned variance of a sensor's noise, in nominal ones, from which on a course quieter than that is no sign of a fault. What was
learned while the belief was wrong would otherwise make a healthy sensor unmodelled, and be forgotten no more."""


@cache
def make_weigh(
    layout: Layout, weigh_alone: Callable[..., float], weigh_other: Callable[..., float]
) -> Callable[..., None]:
    """Return the step function that conditions each hypothesis on the samples and computes its probability.

    Parameters
    ----------
    layout : Layout
        Places in memory and settings.
    weigh_alone, weigh_other : function
        Weights of a sensor's modes where no sensor has an offset, and of the other sensors where one has.
    """
    m, H = layout.m, layout.hypotheses
    sensor, row_length, width_of_settings = layout.sensor, layout.row, layout.width_of_settings
    n, none, stride, first_lost = layout.n, layout.first, layout.length, layout.first_lost
    logp, factor, scratch = layout.grow + H, layout.grow + 2 * H, layout.scratch
    U, lost = len(layout.lost), layout.lost or (0,)
    courses, course, repeated, quantity = layout.courses, layout.course, layout.repeated, layout.quantity
    condition, review = make_condition(layout, weigh_alone, weigh_other), make_review(layout)
    notice, credit = make_notice(layout), make_credit(layout)

    def weigh(sample, C, memory, settings):
        for h in range(H):
            memory[logp + h] = 0.0 * memory[none + h * stride]
            memory[factor + h] = memory[none + h * stride]
        for i in range(m):
            place, change = i * sensor, sample.y[i] - memory[i * sensor + LAST]
            row, nominal = i * row_length, sample.nominal[i, i]
            presumed = 1.0 + 0.0 * nominal
            for j in range(m):
                if quantity[j] == quantity[i]:  # beside a fine one like it, a sensor is not presumed to be coarse
                    like = select(sample.nominal[j, j] == nominal, 1.0, 0.0)
                    presumed = presumed * (1.0 - like * is_fine(sample.nominal[j, j], memory, j * sensor))
            memory[repeated + i] = repetition(change, nominal, presumed, memory, place, settings, row)
            coarse = indifferent(change, nominal, presumed, memory, place, settings, row)
            memory[repeated + m + i] = coarse
            once = at_rest(coarse, nominal, memory, place, settings, row)
            memory[repeated + 2 * m + i] = select(coarse > 0.0, 1.0 / once, memory[repeated + i])
        for i in range(m):
            condition(i, sample, C, memory, settings)
            if U > 0:
                notice(i, sample.present[i], sample.nominal[i, i], memory)
        review(sample, C, memory, settings)
        for i in range(m):
            for u in range(U):
                h, k = first_lost + i * U + u, FIRST_SETTINGS + lost[u] * width_of_settings
                at, place, variance = none + h * stride, i * row_length + k, sample.nominal[i, i]
                spread, expected = expect(memory, at, n, 0, 0, i, C, scratch)
                error = held(sample.e[i] - expected, minimum(spread + variance, ABSURD * variance))
                deviation, begun, noise = sqrt(variance), courses + (i * U + u) * course, memory[i * sensor + NOISE]
                change = sample.y[i] - memory[i * sensor + LAST]
                density = follow(
                    error / deviation,
                    change / deviation,
                    sample.present[i],
                    memory[begun],
                    memory,
                    begun + 1,
                    scratch,
                    settings,
                    place + OWN_SETTINGS,
                    select(noise > LOUD, noise, 0.0),
                ) - log(deviation)
                density = credit(density, error * error, spread + variance * noise, i, sample.present[i], memory)
                width = settings[i * row_length + WIDTH]
                equal = select(absolute(change) <= 0.5 * width, 1.0, 0.0)
                share = repeats_share(
                    equal, sample.present[i], memory[begun], memory, begun + 1, settings, place + OWN_SETTINGS
                )
                coarse, total = memory[repeated + m + i], spread + variance * noise
                healthy = log_density(error * error, total)
                repeats = as_coarse(healthy, healthy, error, total, coarse)
                density = select(coarse > 0.0, repeats, select(equal > 0.5, 0.0, density))
                density = select(sample.present[i] > 0.5, density, 0.0)
                alike = select(coarse > 0.0, share, share * memory[repeated + i] / width)
                likely = select(equal > 0.5, alike, 1.0 - share)
                times = select(
                    sample.present[i] > 0.5, settings[place + MODE_ARRIVES] * likely, settings[place + MODE_MISSING]
                )
                memory[logp + h] = memory[logp + h] + density
                memory[factor + h] = memory[factor + h] * times
        most = memory[logp]
        for h in range(1, H):
            most = maximum(most, memory[logp + h])
        for h in independent(H):
            memory[none + h * stride] = memory[factor + h] * share_of(memory[logp + h], most)
        total = 0.0 * most
        for h in range(H):
            total = total + memory[none + h * stride]
        for h in range(H):
            memory[none + h * stride] = maximum(memory[none + h * stride] / total, LEAST)
        factors = memory[repeated]
        for i in range(1, m):
            factors = factors * memory[repeated + i]
        memory[m * sensor + 1] = most + log(total / factors)

    return weigh


@cache
def make_learn_sensors(layout: Layout) -> Callable[..., None]:
    """Return the step function that learns each sensor's noise and repetitions, from hypotheses in which it is healthy.

    An offset does not change the noise.
    """
    m, H, none, stride, kept = layout.m, layout.hypotheses, layout.first, layout.length, layout.kept
    sensor, row, squares, judged = layout.sensor, layout.row, layout.squares, layout.judged
    coarse = layout.repeated + m

    def learn_sensors(sample, memory, settings):
        for i in range(m):
            sound, squared = LEAST + 0.0 * memory[none], 0.0 * memory[none]
            for h in range(H):
                at, by = none + h * stride, judged[h * m + i]
                if by != BY_COURSE:
                    part = memory[at]
                    if by == BY_MODES:
                        part = part * memory[at + kept + i * sensor + HEALTHY]
                    sound = sound + part
                    squared = squared + part * memory[squares + h * m + i]
            nominal = sample.nominal[i, i]
            squared = not_less(squared / (sound * nominal), memory[coarse + i], nominal)
            learn_noise(squared, sample.present[i] * sound, memory, i * sensor, settings, i * row)
            change = sample.y[i] - memory[i * sensor + LAST]
            sound = sample.present[i] * memory[i * sensor + HEALTHY]
            learn_repeats(change, sound, nominal, memory, i * sensor, settings, i * row)
            memory[i * sensor + LAST] = select(sample.present[i] > 0.5, sample.y[i], memory[i * sensor + LAST])

    return learn_sensors


@cache
def make_conclude(layout: Layout) -> Callable[..., None]:
    """Return the step function for the state estimate of all hypotheses together.

    The hypotheses' means become deviations from the estimate. If absurd samples leave values that are not finite, the prediction
    remains. The estimate is the mean of all hypotheses, except those of a common offset: their weight is 0 as long as they are at
    most as probable as all others together. The estimate therefore follows a plant that may have been kicked. As far as a belief
    fades, the estimate's gain on the deviation is limited by the settings. The covariance is the mean squared distance from the
    estimate, by the probabilities themselves.
    """
    n, H, N = layout.n, layout.hypotheses, layout.n + 2
    none, stride, scratch, counts = layout.first, layout.length, layout.couples, layout.grow + layout.hypotheses
    first_common, first_ended = layout.first_common, layout.first_ended
    G, process, fading, gain_share = layout.process_modes, layout.process, layout.fades or (0,), layout.gain_share

    def conclude(belief, memory, settings):
        mean, covariance, x_hat, P = belief
        remaining = 0.0 * memory[none]
        for h in range(H):
            memory[counts + h] = memory[none + h * stride]
            if not first_common <= h < first_ended:
                remaining = remaining + memory[counts + h]
        whole = remaining
        for h in range(first_common, first_ended):
            memory[counts + h] = maximum(memory[counts + h] - remaining, 0.0)
            whole = whole + memory[counts + h]
        for h in range(H):
            memory[counts + h] = memory[counts + h] / whole
        fades = 0.0 * remaining
        for q in range(G):
            if fading[q] > 0:
                fades = fades + memory[counts + process + q]
        part = 1.0 - fades * (1.0 - settings[gain_share])
        for a in range(n):
            total = 0.0 * mean[a]
            for h in range(H):
                total = total + memory[counts + h] * memory[none + h * stride + STATE + a]
            memory[scratch + a] = part * total
            x_hat[a] = mean[a] + memory[scratch + a]
        for h in range(H):
            for a in range(n):
                z = none + h * stride + STATE + a
                memory[z] = memory[z] - memory[scratch + a]
        for a in range(n):
            for b in range(a + 1):
                total = 0.0 * mean[a]
                for h in range(H):
                    z = none + h * stride + STATE
                    apart = memory[z + a] * memory[z + b]
                    total = total + memory[none + h * stride] * (memory[z + N + a * N + b] + apart)
                P[a, b] = total
        good = x_hat[0] - x_hat[0] == 0.0
        for a in range(n):
            good = both(good, both(x_hat[a] - x_hat[a] == 0.0, both(P[a, a] >= 0.0, P[a, a] - P[a, a] == 0.0)))
            for b in range(a):
                good = both(good, P[a, b] * P[a, b] <= P[a, a] * P[b, b] * (1.0 + 1e-6))
        for a in range(n):
            x_hat[a] = select(good, x_hat[a], mean[a])
            for b in range(a + 1):
                P[a, b] = select(good, P[a, b], covariance[a, b])
                P[b, a] = P[a, b]

    return conclude


@cache
def make_summarise(layout: Layout) -> Callable[..., None]:
    """Return the step function that writes the per-sensor form's values of each sensor, and the values of each actuator.

    For an actuator these are the expected effect of the control u on the plant, ``works u + load``, and the effect that minimises
    the expected squared distance from the goal. In the latter a hypothesis counts as far as the control is effective in it, so
    that a stuck actuator gets no control.
    """
    repeats, row_length, width_of_settings = layout.repeats, layout.row, layout.width_of_settings
    n, m, p, H, L, judged = layout.n, layout.m, layout.p, layout.hypotheses, layout.actuator_modes, layout.judged
    sensor, modes, width = layout.sensor, layout.modes, layout.width
    none, stride, kept, N = layout.first, layout.length, layout.kept, layout.n + 2
    first_lost, U, lost, courses, course = (
        layout.first_lost,
        len(layout.lost),
        layout.lost or (0,),
        layout.courses,
        layout.course,
    )
    K, groups, first_common, alone, other = (
        len(layout.kinds),
        len(layout.groups),
        layout.first_common,
        layout.alone,
        layout.other,
    )
    actuators, actuator, of_actuators = layout.actuators, layout.actuator, layout.actuator_settings
    first_actuator = layout.first_actuator

    def summarise(memory, settings):
        for i in range(m):
            place = i * sensor
            healthy, trust = 0.0 * memory[none], 0.0 * memory[none]
            for h in range(H):
                if judged[h * m + i] == BY_MODES:
                    at = none + h * stride
                    healthy = healthy + memory[at] * memory[at + kept + place + HEALTHY]
                    trust = trust + memory[at] * memory[at + kept + place + TRUSTED]
            memory[place + HEALTHY] = healthy
            memory[place + TRUSTED] = maximum(minimum(trust, 1.0), LEAST_TRUST)
            for k in range(modes):
                block = place + FIRST + k * width
                weight, trusted = 0.0 * memory[none], 0.0 * memory[none]
                size, age = 0.0 * memory[none], 0.0 * memory[none]
                for h in range(H if alone[k] + other[k] > 0 else 0):
                    if judged[h * m + i] == BY_MODES:
                        here = none + h * stride + kept + block
                        part = memory[none + h * stride] * memory[here + WEIGHT]
                        size = size + part * memory[here + SIZE]
                        age = age + part * memory[here + AGE]
                        trusted = trusted + part * memory[here + TRUST]
                        weight = weight + part
                for q in range(K + groups):
                    h = 1 + i * K + q if q < K else first_common + q - K
                    if judged[h * m + i] == k:
                        at = none + h * stride
                        size = size + memory[at] * memory[at + STATE + n]
                        age = age + memory[at] * memory[at + OFFSET_AGE]
                        weight = weight + memory[at]
                for u in range(U):
                    if lost[u] == k or repeats == k:
                        at, taken = none + (first_lost + i * U + u) * stride, courses + (i * U + u) * course + 1
                        part = memory[at]
                        if repeats >= 0:
                            place_of = i * row_length + FIRST_SETTINGS + lost[u] * width_of_settings + OWN_SETTINGS
                            freeze = stuck(memory, taken, settings, place_of)
                            part = part * freeze if repeats == k else part * (1.0 - freeze)
                        size = size + part * misfit(memory, taken)
                        age = age + part * memory[at + OFFSET_AGE]
                        weight = weight + part
                weight = maximum(weight, LEAST)
                memory[block + WEIGHT] = weight
                memory[block + SIZE] = size / weight
                memory[block + AGE] = age / weight
                memory[block + TRUST] = trusted / weight
        for j in range(p):
            place = actuators + j * actuator
            healthy = 1.0 + 0.0 * memory[none]
            works, load = 0.0 * healthy, 0.0 * healthy
            squared, pushed = 0.0 * healthy, 0.0 * healthy
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                row = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                c = memory[at + STATE + n]
                through = maximum(1.0 + settings[row + TAKES] + settings[row + RELATIVE] * c, 0.0)
                added = settings[row + ABSOLUTE] * c
                part = memory[at] * through
                healthy = healthy - memory[at]
                works, load = works + part, load + memory[at] * added
                spread = settings[row + RELATIVE] * settings[row + RELATIVE] * memory[at + STATE + N + n * N + n]
                squared, pushed = squared + part * through + memory[at] * spread, pushed + part * added
                memory[place + OF_MODES + 2 * q] = memory[at]
                memory[place + OF_MODES + 2 * q + 1] = c
            healthy = maximum(healthy, LEAST)
            memory[place + WORKS], memory[place + LOAD] = works + healthy, load
            part = 1.0 / (works + healthy)
            memory[place + STEERS] = maximum(minimum((squared + healthy) * part, MOST_EFFECT), LEAST_EFFECT)
            memory[place + PUSHES] = pushed * part

    return summarise


def report_process(memory, at, stride, modes, first, outputs):
    """Write the probabilities of the process modes, healthy first, last the end of one; they are in memory from ``at`` on."""
    healthy = 1.0 + 0.0 * memory[at]
    for k in range(modes + 1):
        outputs[first + 1 + k] = memory[at + k * stride]
        healthy = healthy - memory[at + k * stride]
    outputs[first] = maximum(healthy, 0.0)


def report_actuators(memory, at, modes, actuators, first, outputs):
    """Write each actuator's mode probabilities; then for all the probability of a fault, the most probable mode, its size.

    They are in ``outputs`` from ``first`` on; the actuators' values are in ``memory`` from ``at`` on.
    """
    later = first + actuators * (modes + 1)
    for j in range(actuators):
        place = at + j * (OF_MODES + 2 * modes) + OF_MODES
        total = 0.0 * memory[place]
        for k in range(modes):
            total = total + memory[place + 2 * k]
        best = maximum(1.0 - total, 0.0)
        outputs[first + j * (modes + 1)] = best
        kind, size = 0.0 * best, NAN + 0.0 * best
        for k in range(modes):
            p = memory[place + 2 * k]
            outputs[first + j * (modes + 1) + 1 + k] = p
            likelier = p > best
            kind = select(likelier, k + 1.0, kind)
            size = select(likelier, memory[place + 2 * k + 1], size)
            best = maximum(best, p)
        outputs[later + j] = minimum(total, 1.0)
        outputs[later + actuators + j] = kind
        outputs[later + 2 * actuators + j] = size
