"""What begins in a bank of hypotheses between two samples: how probable that is, and where it arrives."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import blend, blend_sensor, inflate, measurable
from bayesftc.controllers.switching.bank.layout import (
    ACTUATOR_SETTINGS,
    BEGIN,
    FADES,
    FOLLOWS,
    MEAN,
    MORE,
    PROCESS_SETTINGS,
    STARTS,
    VARIANCE,
    Layout,
)  # fmt: skip
from bayesftc.controllers.switching.bank.merges import make_receive, make_witnessed
from bayesftc.controllers.switching.mode_kernels import AGE, OWN, SIZE, WEIGHT, expected_jump
from bayesftc.controllers.switching.sensor_kernels import (
    BEGINS,
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LEAST,
    OWN_SETTINGS,
    held,
)  # fmt: skip
from bayesftc.cosim.ops import maximum


@cache
def make_begin(layout: Layout) -> Callable[..., None]:
    """Return the step function that notes how probable it is that each hypothesis begins, before time passes."""
    m, p, K, L, G = layout.m, layout.p, len(layout.kinds), layout.actuator_modes, layout.process_modes
    kinds, slow, begins_here = layout.kinds or (0,), layout.slow or (0,), layout.begins_here or (False,)
    row_length, width_of_settings, sensor, kept = layout.row, layout.width_of_settings, layout.sensor, layout.kept
    none, grow, first_actuator, process = layout.first, layout.grow, layout.first_actuator, layout.process
    of_actuators, of_process, witnessed = layout.actuator_settings, layout.process_settings, make_witnessed(layout)
    first_lost, U, lost = layout.first_lost, len(layout.lost), layout.lost or (0,)
    groups, first_common, of_groups = len(layout.groups), layout.first_common, layout.common_settings

    def begin_all(memory, settings):
        for i in range(m):
            seen = witnessed(memory, none + kept, i)
            for q in range(K):
                begin = (
                    begins_here[q] * settings[i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + BEGINS]
                )
                healthy = memory[none + kept + i * sensor + HEALTHY]
                memory[grow + 1 + i * K + q] = memory[none] * healthy * begin * (seen if slow[q] else 1.0)
            for u in range(U):
                begin = settings[i * row_length + FIRST_SETTINGS + lost[u] * width_of_settings + BEGINS]
                memory[grow + first_lost + i * U + u] = (
                    memory[none] * memory[none + kept + i * sensor + HEALTHY] * begin
                )
        for g in range(groups):
            memory[grow + first_common + g] = memory[none] * settings[of_groups + g]
        for j in range(p):
            for q in range(L):
                begin = settings[of_actuators + (j * L + q) * ACTUATOR_SETTINGS + BEGIN]
                memory[grow + first_actuator + j * L + q] = memory[none] * begin
        for q in range(G):
            memory[grow + process + q] = memory[none] * settings[of_process + q * PROCESS_SETTINGS + STARTS]

    return begin_all


@cache
def make_arrive(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges what has begun into each hypothesis, once all have moved.

    What is in the pool goes on alone: as an offset that was known sensor by sensor, or as nothing.
    """
    n, plant, m, p = layout.n, layout.plant, layout.m, layout.p
    K, L, G = len(layout.kinds), layout.actuator_modes, layout.process_modes
    kinds, alone = layout.kinds or (0,), layout.alone
    fresh, begins_here = layout.fresh or (False,), layout.begins_here or (False,)
    row_length, width, width_of_settings, sensor = layout.row, layout.width, layout.width_of_settings, layout.sensor
    none, stride, kept, pool, grow = layout.first, layout.length, layout.kept, layout.pool, layout.grow
    first_actuator, process, first_lost, U = layout.first_actuator, layout.process, layout.first_lost, len(layout.lost)
    courses, course, first_common = layout.courses, layout.course, layout.first_common
    groups, firsts = len(layout.groups), tuple(group[0] for group in layout.groups) or (0,)
    kick = layout.process_settings + layout.kick * PROCESS_SETTINGS
    of_actuators, of_process, receive = layout.actuator_settings, layout.process_settings, make_receive(layout)

    def arrive_offsets(e, nominal, memory, settings, stays, left):
        """Return what stays without any fault, and what is left of the pool."""
        for i in range(m):
            whole = left
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
                came = whole * memory[block + WEIGHT]
                left = maximum(left - came, 0.0)
                b, bb = memory[block + OWN], memory[block + OWN + 3]
                cb = memory[block + OWN + 2] + bb
                cc = memory[block + OWN + 1] + memory[block + OWN + 2] + cb + walk
                receive(memory, at, came, pool, i, memory[block + AGE], memory[block + SIZE] + b, b, cc, cb, bb)
        return stays, left

    def arrive_lost(memory, stays):
        for i in range(m):
            for u in range(U):
                at, came = none + (first_lost + i * U + u) * stride, memory[grow + first_lost + i * U + u]
                stays = stays - came
                memory[courses + (i * U + u) * course] = came / (memory[at] + came)
                receive(memory, at, came, none, i, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return stays

    def arrive_common(C, Q, memory, settings, stays):
        """Return what stays; an offset of all sensors of a group is as large as what a kick does to their readings."""
        for g in range(groups):
            at, came = none + (first_common + g) * stride, memory[grow + first_common + g]
            stays = stays - came
            i, total = firsts[g], 0.0 * came
            for a in range(plant):
                for b in range(plant):
                    total = total + C[i, a] * Q[a, b] * C[i, b]
            receive(memory, at, came, none, -1, 0.0, 0.0, 0.0, settings[kick + MORE] * total, 0.0, 0.0)
        return stays

    def arrive_actuators(applied, memory, settings, stays):
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                own = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                came = memory[grow + first_actuator + j * L + q]
                stays = stays - came
                c = settings[own + MEAN] + settings[own + FOLLOWS] * applied[j]
                receive(memory, at, came, none, -1, 0.0, c, 0.0, settings[own + VARIANCE], 0.0, 0.0)
        return stays

    def arrive_process(sampled, C, Q, nominal, memory, settings, stays):
        for q in range(G):
            at, own = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
            came = memory[grow + process + q]
            stays = stays - came
            part = came / (memory[at] + came)
            receive(memory, at, came, none, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            fades = part * sampled * settings[own + FADES] * measurable(memory, at, n, C, nominal)
            inflate(memory, at, n, plant, part * settings[own + MORE], fades, Q)
        return stays

    def go_on(memory, stays, left):
        """Merge what is left of the pool into the hypothesis without any fault."""
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

    def arrive(e, sampled, C, Q, nominal, applied, memory, settings):
        stays, left = arrive_offsets(e, nominal, memory, settings, memory[none], memory[pool])
        stays = arrive_common(C, Q, memory, settings, arrive_lost(memory, stays))
        stays = arrive_actuators(applied, memory, settings, stays)
        stays = arrive_process(sampled, C, Q, nominal, memory, settings, stays)
        go_on(memory, maximum(stays, LEAST), maximum(left, LEAST))

    return arrive
