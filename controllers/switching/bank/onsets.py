"""Onsets in a bank of hypotheses between two samples: their probabilities, and their merging into hypotheses."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.blends import make_blend_sensor
from bayesftc.controllers.switching.bank.hypothesis import blend, inflate, measurable, vague
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
)
from bayesftc.controllers.switching.bank.merges import make_gather, make_receive, make_receive_new, make_witnessed
from bayesftc.controllers.switching.mode_kernels import AGE, OWN, SIZE, WEIGHT, expected_jump
from bayesftc.controllers.switching.sensor_kernels import (
    BEGINS,
    FIRST,
    FIRST_SETTINGS,
    HEALTHY,
    LEAST,
    OWN_SETTINGS,
    held,
)
from bayesftc.cosim.ops import maximum, select


@cache
def make_begin(layout: Layout) -> Callable[..., None]:
    """Return the step function that stores the onset probability of each hypothesis, before the prediction."""
    m, p, K, L, G = layout.m, layout.p, len(layout.kinds), layout.actuator_modes, layout.process_modes
    kinds, slow, begins_here = layout.kinds or (0,), layout.slow or (0,), layout.begins_here or (False,)
    row_length, width_of_settings, sensor, kept = layout.row, layout.width_of_settings, layout.sensor, layout.kept
    none, grow, first_actuator, process = layout.first, layout.grow, layout.first_actuator, layout.process
    of_actuators, of_process, witnessed = layout.actuator_settings, layout.process_settings, make_witnessed(layout)
    first_lost, U, lost = layout.first_lost, len(layout.lost), layout.lost or (0,)
    groups, first_common, of_groups = len(layout.groups), layout.first_common, layout.common_settings

    def begin_all(memory, settings):
        for i in range(m):
            witness = witnessed(memory, none + kept, i)
            for q in range(K):
                begin = (
                    begins_here[q] * settings[i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + BEGINS]
                )
                healthy = memory[none + kept + i * sensor + HEALTHY]
                memory[grow + 1 + i * K + q] = memory[none] * healthy * begin * (witness if slow[q] else 1.0)
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
def make_merge_onsets(layout: Layout) -> Callable[..., None]:
    """Return the step function that merges onsets into each hypothesis, after all predictions.

    The pool is merged as well: into an offset that was inferred sensor by sensor, or into no fault.
    """
    n, plant, m, p = layout.n, layout.plant, layout.m, layout.p
    K, L, G = len(layout.kinds), layout.actuator_modes, layout.process_modes
    kinds, blend_sensor = layout.kinds or (0,), make_blend_sensor(layout.width, layout.alone)
    fresh, begins_here = layout.fresh or (False,), layout.begins_here or (False,)
    row_length, width, width_of_settings, sensor = layout.row, layout.width, layout.width_of_settings, layout.sensor
    none, stride, kept, pool, grow = layout.first, layout.length, layout.kept, layout.pool, layout.grow
    first_actuator, process, first_lost, U = layout.first_actuator, layout.process, layout.first_lost, len(layout.lost)
    courses, course, first_common = layout.courses, layout.course, layout.first_common
    groups, firsts = len(layout.groups), tuple(group[0] for group in layout.groups) or (0,)
    kick = layout.process_settings + layout.kick * PROCESS_SETTINGS
    of_actuators, of_process, receive = layout.actuator_settings, layout.process_settings, make_receive(layout)
    most = layout.most
    gather, receive_new, joined = make_gather(layout), make_receive_new(layout), layout.joined or (False,)
    any_joined = any(joined)

    def merge_offsets(e, nominal, memory, settings, stays, left):
        """Return the remaining probabilities of no fault and of the pool."""
        for i in range(m):
            whole = left
            for q in range(K):
                at = none + (1 + i * K + q) * stride
                mode_row = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings + OWN_SETTINGS
                jump = expected_jump(
                    held(e[i], nominal[i, i]), settings[mode_row], settings[mode_row + 3], nominal[i, i]
                )
                slope, walk = settings[mode_row + 1] * nominal[i, i], settings[mode_row + 2] * nominal[i, i]
                if begins_here[q]:
                    incoming = memory[grow + 1 + i * K + q]
                    stays = stays - incoming
                    receive(memory, at, incoming, none, i, 0.0, 0.0, 0.0, jump + slope, slope, slope)
                if fresh[q]:
                    continue
                block = pool + kept + i * sensor + FIRST + kinds[q] * width
                incoming = whole * memory[block + WEIGHT]
                left = maximum(left - incoming, 0.0)
                b, bb = memory[block + OWN], memory[block + OWN + 3]
                cb = memory[block + OWN + 2] + bb
                cc = memory[block + OWN + 1] + memory[block + OWN + 2] + cb + walk
                receive(memory, at, incoming, pool, i, memory[block + AGE], memory[block + SIZE] + b, b, cc, cb, bb)
        return stays, left

    def merge_lost(memory, stays):
        for i in range(m):
            for u in range(U):
                at, incoming = none + (first_lost + i * U + u) * stride, memory[grow + first_lost + i * U + u]
                stays = stays - incoming
                memory[courses + (i * U + u) * course] = incoming / (memory[at] + incoming)
                receive(memory, at, incoming, none, i, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return stays

    def merge_common(C, Q, memory, settings, stays):
        """Return the remaining probability of no fault; a common offset has the size of a kick's effect on the readings."""
        for g in range(groups):
            at, incoming = none + (first_common + g) * stride, memory[grow + first_common + g]
            stays = stays - incoming
            i, total = firsts[g], 0.0 * incoming
            for a in range(plant):
                for b in range(plant):
                    total = total + C[i, a] * Q[a, b] * C[i, b]
            receive(memory, at, incoming, none, -1, 0.0, 0.0, 0.0, settings[kick + MORE] * total, 0.0, 0.0)
        return stays

    def begun(memory, settings):
        """Return the probability that an actuator or the process begins to fail."""
        total = 0.0 * memory[none]
        for j in range(p):
            for q in range(L):
                total = total + settings[of_actuators + (j * L + q) * ACTUATOR_SETTINGS + BEGIN]
        for q in range(G):
            total = total + settings[of_process + q * PROCESS_SETTINGS + STARTS]
        return total

    def merge_actuators(applied, memory, settings, stays, offsets):
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                mode_row = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                incoming = memory[grow + first_actuator + j * L + q]
                stays = stays - incoming
                c = settings[mode_row + MEAN] + settings[mode_row + FOLLOWS] * applied[j]
                receive_new(
                    memory, at, incoming + offsets * settings[mode_row + BEGIN], c, settings[mode_row + VARIANCE]
                )
        return stays

    def merge_process(sampled, C, Q, nominal, memory, settings, stays, offsets):
        for q in range(G):
            at, mode_row = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
            stays = stays - memory[grow + process + q]
            incoming = memory[grow + process + q] + offsets * settings[mode_row + STARTS]
            part = incoming / (memory[at] + incoming)
            receive_new(memory, at, incoming, 0.0, 0.0)
            fades = part * sampled * settings[mode_row + FADES] * measurable(memory, at, n, C, nominal)
            inflate(memory, at, n, plant, part * settings[mode_row + MORE], fades, Q, settings, most)
        return stays

    def merge_pool(C, nominal, memory, stays, left):
        """Merge the rest of the pool into the hypothesis without any fault.

        The state after a fault can be nearly unknown, as without the only sensor of a quantity. Merged by moments, even a small
        part of such a `vague` belief would spoil that without a fault, and so make the fault more probable from sample to
        sample. Its share is then that of the squared probabilities.
        """
        part = left / (stays + left)
        few = left * left / (left * left + stays * stays)
        memory[none] = stays + left
        share = select(vague(memory, pool, none, n, C, nominal) > 0.5, few, part)
        blend(memory, none, share, pool, n, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(m):
            of_pool = pool + kept + j * sensor
            remaining = 1.0 + 0.0 * left
            for q in range(K):
                if not fresh[q]:
                    remaining = remaining - memory[of_pool + FIRST + kinds[q] * width + WEIGHT]
            scale = 1.0 / maximum(remaining, 1e-3)
            blend_sensor(memory, none + kept + j * sensor, part, of_pool, scale)

    def merge_onsets(e, sampled, C, Q, nominal, applied, memory, settings):
        offsets = gather(memory, settings, begun(memory, settings)) if any_joined else 0.0 * memory[none]
        stays, left = merge_offsets(e, nominal, memory, settings, memory[none], memory[pool])
        stays = merge_common(C, Q, memory, settings, merge_lost(memory, stays))
        stays = merge_actuators(applied, memory, settings, stays, offsets)
        stays = merge_process(sampled, C, Q, nominal, memory, settings, stays, offsets)
        merge_pool(C, nominal, memory, maximum(stays, LEAST), maximum(left, LEAST))

    return merge_onsets
