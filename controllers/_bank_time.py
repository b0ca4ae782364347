"""What time does to a bank of hypotheses between two samples: all move, faults begin and end, beliefs are merged."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers._bank_kernels import (
    OFFSET_AGE,
    STATE,
    blend,
    blend_between,
    blend_healthy,
    blend_sensor,
    inflate,
    move,
)
from bayesftc.controllers._bank_layout import (
    ABSOLUTE,
    ACTUATOR_SETTINGS,
    BEGIN,
    END,
    FOLLOWS,
    LOAD,
    MEAN,
    MORE,
    PROCESS_SETTINGS,
    RELATIVE,
    STARTS,
    STOPS,
    TAKES,
    VARIANCE,
    WALK,
    WORKS,
    Layout,
)  # fmt: skip
from bayesftc.controllers._mode_kernels import AGE, OWN, SIZE, WEIGHT, expected_jump
from bayesftc.controllers._switching_kernels import (
    BEGINS,
    ENDS,
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LEAST,
    OWN_SETTINGS,
    held,
)  # fmt: skip
from bayesftc.cosim.ops import maximum, minimum

EXPIRES = 0.02
"""Probability per sample with which a drift ends that no other sensor bears witness to: it may as well be the state's motion."""

SETTLES = 0.02
"""Probability per sample with which a mode of the process that has ended is taken for over: until then that it was there is a
hypothesis of its own, for often only the samples after a kick tell of it."""


@cache
def make_pass_time(
    layout: Layout, pass_alone: Callable[..., None], pass_other: Callable[..., None]
) -> Callable[..., None]:
    """Return the step function by which the time of one sample passes.

    Parameters
    ----------
    layout : Layout
        Where everything stands.
    pass_alone, pass_other : function
        Time passing for a sensor's modes where no sensor has an offset, and for the other sensors where one has.
    """
    n, plant, m, p, K, L = layout.n, layout.plant, layout.m, layout.p, len(layout.kinds), layout.actuator_modes
    kinds, becomes, slow = layout.kinds or (0,), layout.becomes or (0,), layout.slow or (0,)
    fresh, begins_here = layout.fresh, layout.begins_here
    alone, other, modes = layout.alone, layout.other, layout.modes
    sensor, row_length, actuator = layout.sensor, layout.row, layout.actuator
    width, width_of_settings = layout.width, layout.width_of_settings
    none, stride, kept, pool, grow = layout.first, layout.length, layout.kept, layout.pool, layout.grow
    couples = layout.couples
    shift, scratch = couples + n + 2, couples + 2 * (n + 2)
    actuators, of_actuators = layout.actuators, m * layout.row + 1
    first_actuator, process, G = 1 + m * K, layout.process, layout.process_modes
    H, N = layout.hypotheses, n + 2
    of_process = of_actuators + p * L * ACTUATOR_SETTINGS

    def witnessed(memory, sensors, i):
        """Return the probability that a sensor other than ``i`` is healthy."""
        nobody = 1.0 + 0.0 * memory[sensors + HEALTHY]
        for j in range(m):
            if j != i:
                nobody = nobody * (1.0 - minimum(memory[sensors + j * sensor + HEALTHY], 1.0))
        return 1.0 - nobody

    def collect(memory, at, end, i):
        """Merge into the pool what ends of a hypothesis, in which sensor ``i``, if it is one, had an offset."""
        ended = memory[at] * end
        memory[at] = maximum(memory[at] - ended, LEAST)
        both = maximum(memory[pool] + ended, LEAST * LEAST)
        part = ended / both
        memory[pool] = both
        blend(memory, pool, part, at, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(m):
            if j == i:
                blend_healthy(memory, pool + kept + j * sensor, part, FIRST, width, modes)
            else:
                blend_sensor(memory, pool + kept + j * sensor, part, at + kept + j * sensor, 1.0, FIRST, width, other)

    def receive(memory, at, came, source, i, age, c, b, cc, cb, bb):
        """Merge into a hypothesis what comes from another one, with an offset of this mean, slope and covariance."""
        part = came / (memory[at] + came)
        memory[at] = memory[at] + came
        blend(memory, at, part, source, n, 1, c, b, cc, cb, bb)
        memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + part * (age - memory[at + OFFSET_AGE])
        for j in range(m):
            if j != i:
                blend_sensor(memory, at + kept + j * sensor, part, source + kept + j * sensor, 1.0, FIRST, width, other)

    def become(memory, at, source, i):
        """Merge all of a hypothesis into another one with an offset of the same sensor."""
        c, cc, came = source + STATE + n, source + STATE + N + n * N + n, memory[source]
        part = came / (memory[at] + came)
        receive(
            memory, at, came, source, i, memory[source + OFFSET_AGE], memory[c], memory[c + 1],
            memory[cc], memory[cc + 1], memory[cc + N + 1],
        )  # fmt: skip
        blend_between(memory, at, part, source, n)
        memory[source] = LEAST + 0.0 * came

    def pass_time(e, A, B, Q, nominal, start, covariance, largest, applied, memory, settings):
        # What begins, by the probabilities before time passes.
        for i in range(m):
            seen = witnessed(memory, none + kept, i)
            for q in range(K):
                begin = (
                    begins_here[q] * settings[i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + BEGINS]
                )
                healthy = memory[none + kept + i * sensor + HEALTHY]
                memory[grow + 1 + i * K + q] = memory[none] * healthy * begin * (seen if slow[q] else 1.0)
        for j in range(p):
            for q in range(L):
                begin = settings[of_actuators + (j * L + q) * ACTUATOR_SETTINGS + BEGIN]
                memory[grow + first_actuator + j * L + q] = memory[none] * begin
        for q in range(G):
            memory[grow + process + q] = memory[none] * settings[of_process + q * PROCESS_SETTINGS + STARTS]

        # The prediction counts on what is believed of the actuators; a hypothesis departs from it by what it believes of them.
        for a in range(n):
            memory[couples + a] = 0.0 * memory[none]
            total = 0.0 * memory[none]
            for j in range(p):
                works, load = memory[actuators + j * actuator + WORKS], memory[actuators + j * actuator + LOAD]
                total = total + B[a, j] * (applied[j] - (works * applied[j] + load))
            memory[shift + a] = total
        memory[pool] = 0.0 * memory[none]
        for i in range(m):
            pass_alone(memory, none + kept + i * sensor, settings, i * row_length)
        move(
            memory, none, n, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, A, Q, start, covariance, largest, couples, shift, scratch
        )  # fmt: skip
        for i in range(m):
            for q in range(K):
                at = none + (1 + i * K + q) * stride
                row = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings
                own = row + OWN_SETTINGS
                seen = witnessed(memory, at + kept, i)
                for j in range(m):
                    if j != i:
                        pass_other(memory, at + kept + j * sensor, settings, j * row_length)
                jump = expected_jump(held(e[i], nominal[i, i]), settings[own], settings[own + 3], nominal[i, i])
                slope, walk = settings[own + 1] * nominal[i, i], settings[own + 2] * nominal[i, i]
                move(
                    memory, at, n, 1, 1, 0.0, jump + slope, slope, slope, walk,
                    A, Q, start, covariance, largest, couples, shift, scratch,
                )  # fmt: skip
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                collect(
                    memory, at, minimum(settings[row + ENDS] + ((1.0 - seen) * EXPIRES if slow[q] else 0.0), 1.0), i
                )
                if fresh[q]:
                    become(memory, none + (1 + i * K + becomes[q]) * stride, at, i)
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                own = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                for i in range(m):
                    pass_other(memory, at + kept + i * sensor, settings, i * row_length)
                for a in range(n):
                    memory[couples + a] = B[a, j] * (settings[own + ABSOLUTE] + settings[own + RELATIVE] * applied[j])
                    memory[shift + a] = memory[shift + a] + B[a, j] * settings[own + TAKES] * applied[j]
                move(
                    memory, at, n, 1, 0, settings[own + MEAN] + settings[own + FOLLOWS] * applied[j],
                    settings[own + VARIANCE], 0.0, 0.0, settings[own + WALK],
                    A, Q, start, covariance, largest, couples, shift, scratch,
                )  # fmt: skip
                for a in range(n):
                    memory[shift + a] = memory[shift + a] - B[a, j] * settings[own + TAKES] * applied[j]
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                collect(memory, at, settings[own + END], -1)
        for q in range(H - process):
            at = none + (process + q) * stride
            for i in range(m):
                pass_other(memory, at + kept + i * sensor, settings, i * row_length)
            move(
                memory, at, n, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, A, Q, start, covariance, largest, couples, shift, scratch
            )  # fmt: skip
        if G > 0:
            after = none + (process + G) * stride
            collect(memory, after, SETTLES, -1)
            for q in range(G):
                at, own = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
                ended = memory[at] * settings[own + STOPS]
                memory[at] = maximum(memory[at] - ended, LEAST)
                receive(memory, after, ended, at, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                inflate(memory, at, n, plant, settings[own + MORE], Q)

        # What has begun, and what goes on alone after the end of another: an offset that was known sensor by sensor.
        stays, left = memory[none], memory[pool]
        for i in range(m):
            for q in range(K):
                at = none + (1 + i * K + q) * stride
                own = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + OWN_SETTINGS
                jump = expected_jump(held(e[i], nominal[i, i]), settings[own], settings[own + 3], nominal[i, i])
                slope, walk = settings[own + 1] * nominal[i, i], settings[own + 2] * nominal[i, i]
                if begins_here[q]:
                    came = memory[grow + 1 + i * K + q]
                    stays = stays - came
                    receive(memory, at, came, none, i, 0.0, 0.0, 0.0, jump + slope, slope, slope)
                if fresh[q]:
                    continue
                block = pool + kept + i * sensor + FIRST + kinds[q] * width
                came = left * memory[block + WEIGHT]
                left = left - came
                b, bb = memory[block + OWN], memory[block + OWN + 3]
                cb = memory[block + OWN + 2] + bb
                cc = memory[block + OWN + 1] + memory[block + OWN + 2] + cb + walk
                receive(memory, at, came, pool, i, memory[block + AGE], memory[block + SIZE] + b, b, cc, cb, bb)
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                own = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                came = memory[grow + first_actuator + j * L + q]
                stays = stays - came
                c = settings[own + MEAN] + settings[own + FOLLOWS] * applied[j]
                receive(memory, at, came, none, -1, 0.0, c, 0.0, settings[own + VARIANCE], 0.0, 0.0)
        for q in range(G):
            at, own = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
            came = memory[grow + process + q]
            stays = stays - came
            part = came / (memory[at] + came)
            receive(memory, at, came, none, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            inflate(memory, at, n, plant, part * settings[own + MORE], Q)
        stays, left = maximum(stays, LEAST), maximum(left, LEAST)
        part = left / (stays + left)
        memory[none] = stays + left
        blend(memory, none, part, pool, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(m):
            of_pool = pool + kept + j * sensor
            rest = 1.0 + 0.0 * left
            for q in range(K):
                if not fresh[q]:
                    rest = rest - memory[of_pool + FIRST + kinds[q] * width + WEIGHT]
            scale = 1.0 / maximum(rest, 1e-3)
            blend_sensor(memory, none + kept + j * sensor, part, of_pool, scale, FIRST, width, alone)

    return pass_time
