"""Conditioning of a bank of hypotheses on a sample of one sensor.

Each part of the computation runs for all hypotheses before the next part. The processor computes several hypotheses at once, as
none depends on another. The weights of modes, most of the work with many sensors, are computed in vectors of hypotheses.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import correct, expect
from bayesftc.controllers.switching.bank.layout import BY_COURSE, BY_MODES, Layout
from bayesftc.controllers.switching.mode_kernels import WEIGHT, log_density, wider
from bayesftc.controllers.switching.sensor_kernels import (
    DENSITY,
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LAST,
    LEAST,
    MODE_ARRIVES,
    MODE_MISSING,
    NOISE,
    NOISE_SHAPE,
    TRUSTED,
    WIDTH,
    held,
)
from bayesftc.cosim.ops import absolute, exp, independent, log, maximum, minimum, select

ABSURD = 1e12
"""Largest ratio of an innovation's variance to the sensor's up to which larger innovations are learned from; beyond, hypotheses
would move each other away."""

MOST_GAIN = 30.0
"""Largest logarithm of the factor by which a sensor is judged healthier given the others."""

OWN_SHARE = 1e-9
"""Least ratio of a reading's posterior variance to that of its sensor's noise; with less, rounding would decide."""

SPREAD, TOTAL, ERROR, DIRECTION = range(4)
"""Places in a reading: its variance without and with the sensor's noise, its error, and its covariance with the hypothesis."""


@cache
def make_condition(
    layout: Layout, weigh_alone: Callable[..., float], weigh_other: Callable[..., float]
) -> Callable[..., None]:
    """Return the step function that conditions all hypotheses on the sample of a sensor, the k-th in each one's `order`.

    It updates the density of the samples under each hypothesis: a logarithm, and a factor that includes its probability.

    Parameters
    ----------
    layout : Layout
        Places in memory and settings.
    weigh_alone, weigh_other : function
        Weights of a sensor's modes where no sensor has an offset, and of the other sensors where one has.
    """
    m, H, none, stride = layout.m, layout.hypotheses, layout.first, layout.length
    logp, factor = layout.grow + H, layout.grow + 2 * H
    without, with_offset, order = layout.without_offset, layout.with_offset or (0,), layout.order
    K, process = len(layout.kinds), layout.process
    # Besides the one without any fault: unmodelled courses and ends of common offsets; common offsets and actuators. The modes of
    # a process and the K offsets of one sensor follow each other in memory. The latter have one order, and judge all sensors but
    # their own by their modes: `weigh_modes` needs no choice, and is computed for several of them at once.
    others, further = tuple(h for h in without[1:] if h < process), with_offset[m * K : H - len(without)]
    other_count, further_count = len(others), len(further)
    others, further = others or (0,), further or (0,)
    # Separate functions, so that the compiler has constant loop lengths.
    expect_plain, expect_offset = (make_expect(layout, offset) for offset in (0, 1))
    weigh_first, weigh_plain = (make_weigh_reading(layout, weigh, 0) for weigh in (weigh_alone, weigh_other))
    weigh_offset, weigh_modes = make_weigh_reading(layout, weigh_other, 1), make_weigh_modes(layout, weigh_other)
    learn_plain, learn_offset = (make_learn(layout, offset) for offset in (0, 1))

    def condition(k, sample, C, memory, settings):
        for x in range(len(without)):
            expect_plain(without[x], k, sample, C, memory)
        for x in range(H - len(without)):
            h = with_offset[x]
            expect_offset(h, order[h * m + k], sample, C, memory)
        weigh_first(0, k, sample, memory, settings)
        for x in range(other_count):
            weigh_plain(others[x], k, sample, memory, settings)
        for h in independent(process, H):
            weigh_modes(h, k, sample, memory, settings)
        for j in range(m):
            first = 1 + j * K
            i = order[first * m + k]
            if i == j:
                for q in range(K):
                    weigh_offset(first + q, i, sample, memory, settings)
            else:
                for q in independent(K):
                    weigh_modes(first + q, i, sample, memory, settings)
        for x in range(further_count):
            h = further[x]
            weigh_offset(h, order[h * m + k], sample, memory, settings)
        for x in range(len(without)):
            learn_plain(without[x], k, sample, C, memory)
        for x in range(H - len(without)):
            h = with_offset[x]
            learn_offset(h, order[h * m + k], sample, C, memory)
        if k % 2 == 1 and k < m - 1:  # avoids underflow of the product of many small factors
            for h in independent(H):
                memory[logp + h] = memory[logp + h] + log(memory[factor + h])
                memory[factor + h] = 1.0 + 0.0 * memory[none + h * stride]

    return condition


@cache
def make_expect(layout: Layout, offset: int) -> Callable[..., None]:
    """Return the step function that writes a hypothesis's reading of a sensor, unless the sensor is on an unmodelled course."""
    n, m, none, stride, judged = layout.n, layout.m, layout.first, layout.length, layout.judged
    sensor, readings, reading = layout.sensor, layout.readings, layout.reading

    def expect_reading(h, i, sample, C, memory):
        at, here, by = none + h * stride, readings + h * reading, judged[h * m + i]
        variance = sample.nominal[i, i] * memory[i * sensor + NOISE]
        if by != BY_COURSE:
            spread, expected = expect(memory, at, n, offset, by >= 0 if offset else 0, i, C, here + DIRECTION)
            total = spread + variance
            memory[here + SPREAD] = spread
            memory[here + TOTAL] = total
            memory[here + ERROR] = held(sample.e[i] - expected, minimum(total, ABSURD * variance))

    return expect_reading


@cache
def make_weigh_modes(layout: Layout, weigh_sensor: Callable[..., float]) -> Callable[..., None]:
    """Return the step function that weighs a sensor's modes in a hypothesis, by ``weigh_sensor``."""
    sensor, row_length, none, stride, kept = layout.sensor, layout.row, layout.first, layout.length, layout.kept
    m, readings, reading, repeated = layout.m, layout.readings, layout.reading, layout.repeated
    H, judgements = layout.hypotheses, layout.judgements
    logp, factor = layout.grow + H, layout.grow + 2 * H

    def weigh_modes(h, i, sample, memory, settings):
        here, place = readings + h * reading, none + h * stride + kept + i * sensor
        density = weigh_sensor(
            memory[here + ERROR],
            sample.present[i],
            memory[here + TOTAL],
            sample.nominal[i, i] * memory[i * sensor + NOISE],
            0.5 / memory[i * sensor + NOISE_SHAPE],
            sample.y[i] - memory[i * sensor + LAST],
            memory[repeated + 2 * m + i],
            memory[repeated + m + i],
            memory,
            place,
            settings,
            i * row_length,
        )
        memory[logp + h] = memory[logp + h] + density
        memory[factor + h] = memory[factor + h] * memory[place + DENSITY]
        memory[judgements + i * H + h] = memory[here + ERROR] * memory[here + ERROR]
        memory[judgements + (m + i) * H + h] = memory[here + TOTAL]

    return weigh_modes


@cache
def make_weigh_reading(layout: Layout, weigh_sensor: Callable[..., float], offset: int) -> Callable[..., None]:
    """Return the step function that weighs a reading, and by ``weigh_sensor`` the modes of a sensor that is judged by them."""
    m, row_length, width_of_settings, judged = layout.m, layout.row, layout.width_of_settings, layout.judged
    readings, reading, weigh_modes = layout.readings, layout.reading, make_weigh_modes(layout, weigh_sensor)
    logp, factor = layout.grow + layout.hypotheses, layout.grow + 2 * layout.hypotheses

    def weigh_reading(h, i, sample, memory, settings):
        here, by = readings + h * reading, judged[h * m + i]
        if by == BY_MODES:
            weigh_modes(h, i, sample, memory, settings)
        elif offset and by >= 0:
            place, error = i * row_length + FIRST_SETTINGS + by * width_of_settings, memory[here + ERROR]
            density = select(sample.present[i] > 0.5, log_density(error * error, memory[here + TOTAL]), 0.0)
            times = select(sample.present[i] > 0.5, settings[place + MODE_ARRIVES], settings[place + MODE_MISSING])
            memory[logp + h] = memory[logp + h] + density
            memory[factor + h] = memory[factor + h] * times

    return weigh_reading


@cache
def make_learn(layout: Layout, offset: int) -> Callable[..., None]:
    """Return the step function that corrects a hypothesis by a reading."""
    n, m, sensor, judged = layout.n, layout.m, layout.sensor, layout.judged
    none, stride, kept, readings, reading = (
        layout.first,
        layout.length,
        layout.kept,
        layout.readings,
        layout.reading,
    )

    def learn(h, i, sample, C, memory):
        at, here, by = none + h * stride, readings + h * reading, judged[h * m + i]
        variance, present = sample.nominal[i, i] * memory[i * sensor + NOISE], sample.present[i]
        if by != BY_COURSE:
            spread, total, error = memory[here + SPREAD], memory[here + TOTAL], memory[here + ERROR]
            if by == BY_MODES:
                noise = variance / memory[at + kept + i * sensor + TRUSTED]
                correct(memory, at, n, offset, 0, i, C, here + DIRECTION, error, spread + noise, noise, present)
            elif offset:
                correct(memory, at, n, 1, 1, i, C, here + DIRECTION, error, total, variance, present)

    return learn


@cache
def make_review(layout: Layout) -> Callable[..., None]:
    """Return the step function that judges each sensor anew in each hypothesis, by its reading given all other sensors.

    As the sensors come, the first one is judged without the others. After a sudden load it was therefore blamed, although the
    others agreed with it. If the sample of a healthy sensor is more probable given the others than it was, the sensor's modes get
    their probabilities given the others (`make_revise`). The belief keeps the weight with which it was corrected.

    The function also estimates the square of each sensor's noise: the exact posterior where no sample counts as a burst. With
    bursts left out, that of the first sensor was learned smaller, and the sensor believed.
    """
    m, sensor, squares, judged = layout.m, layout.sensor, layout.squares, layout.judged
    none, stride, kept, readings, reading = (
        layout.first,
        layout.length,
        layout.kept,
        layout.readings,
        layout.reading,
    )
    without, with_offset, H = layout.without_offset, layout.with_offset or (0,), layout.hypotheses
    expect_plain, expect_offset = (make_expect(layout, offset) for offset in (0, 1))
    revise = make_revise(layout)

    def write(h, i, sample, memory):
        here, by = readings + h * reading, judged[h * m + i]
        if by != BY_COURSE:
            variance = sample.nominal[i, i] * memory[i * sensor + NOISE]
            noise = variance
            if by == BY_MODES:
                noise = variance / memory[none + h * stride + kept + i * sensor + TRUSTED]
            # The reading without this sensor's own sample, by which it was corrected with this noise.
            apart = noise / maximum(noise - memory[here + SPREAD], OWN_SHARE * noise)
            spread, error = apart * memory[here + SPREAD], apart * memory[here + ERROR]
            part = variance / (spread + variance)
            memory[squares + h * m + i] = part * (part * error * error + spread)
            memory[here + ERROR], memory[here + TOTAL] = error, spread + variance

    def review(sample, C, memory, settings):
        for i in range(m):
            for x in range(len(without)):
                expect_plain(without[x], i, sample, C, memory)
                write(without[x], i, sample, memory)
            for x in range(H - len(without)):
                expect_offset(with_offset[x], i, sample, C, memory)
                write(with_offset[x], i, sample, memory)
            revise(i, sample, memory, settings)

    return review


@cache
def make_revise(layout: Layout) -> Callable[..., None]:
    """Return the step function that judges a sensor anew in all hypotheses, where it fits better to the others than it did.

    Where it fits worse, nothing changes: the others may have followed a faulty sensor. Neither does a repeated sample, which may
    be a freeze. Only the density without a fault changes: those of faults are wide, and are taken as unchanged by the others.
    """
    m, K, H, modes, width = layout.m, len(layout.kinds), layout.hypotheses, layout.modes, layout.width
    sensor, none, stride, kept, row = layout.sensor, layout.first, layout.length, layout.kept, layout.row
    readings, reading, judgements, judged = layout.readings, layout.reading, layout.judgements, layout.judged
    process, later = layout.process, 1 + m * K

    def revise_one(h, i, sample, memory, settings):
        here, place = readings + h * reading, none + h * stride + kept + i * sensor
        square, total = memory[here + ERROR] * memory[here + ERROR], memory[here + TOTAL]
        before, variance = memory[judgements + i * H + h], memory[judgements + (m + i) * H + h]
        noise, doubt = sample.nominal[i, i] * memory[i * sensor + NOISE], 0.5 / memory[i * sensor + NOISE_SHAPE]
        gain = wider(square, total, noise, doubt) - wider(before, variance, noise, doubt)
        gain = gain + 0.5 * (before / variance - square / total - log(total / variance))
        repeats = absolute(sample.y[i] - memory[i * sensor + LAST]) <= 0.5 * settings[i * row + WIDTH]
        counts = select(repeats, 0.0, sample.present[i])
        ratio = exp(minimum(maximum(gain * counts, 0.0), MOST_GAIN))
        healthy = memory[place + HEALTHY]
        part = 1.0 / (1.0 + healthy * (ratio - 1.0))
        memory[place + HEALTHY] = healthy * ratio * part
        memory[place + TRUSTED] = (memory[place + TRUSTED] + healthy * (ratio - 1.0)) * part
        for k in range(modes):
            weight = place + FIRST + k * width + WEIGHT
            memory[weight] = maximum(memory[weight] * part, LEAST)

    def revise(i, sample, memory, settings):
        revise_one(0, i, sample, memory, settings)
        for j in range(m):
            if i != j:
                for q in independent(K):
                    revise_one(1 + j * K + q, i, sample, memory, settings)
        for x in range(process - later):
            if judged[(later + x) * m + i] == BY_MODES:
                revise_one(later + x, i, sample, memory, settings)
        for h in independent(process, H):
            revise_one(h, i, sample, memory, settings)

    return revise
