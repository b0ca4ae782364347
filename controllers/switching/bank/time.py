"""What time does to a bank of hypotheses between two samples: all move, faults begin and end, beliefs are merged."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.hypothesis import (
    NO_OFFSET,
    OFFSET_AGE,
    STATE,
    Moving,
    Onset,
    Places,
    ended,
    inflate,
    measurable,
    move,
)
from bayesftc.controllers.switching.bank.layout import (
    ABSOLUTE,
    ACTUATOR_SETTINGS,
    BY_MODES,
    END,
    FADES,
    FOLLOWS,
    LOAD,
    MEAN,
    MORE,
    PROCESS_SETTINGS,
    RELATIVE,
    STOPS,
    TAKES,
    VARIANCE,
    WALK,
    WORKS,
    Layout,
)  # fmt: skip
from bayesftc.controllers.switching.bank.merges import make_become, make_collect, make_receive, make_witnessed
from bayesftc.controllers.switching.bank.onsets import make_arrive, make_begin
from bayesftc.controllers.switching.mode_kernels import expected_jump
from bayesftc.controllers.switching.sensor_kernels import ENDS, FIRST_SETTINGS, LEAST, OWN_SETTINGS, held
from bayesftc.cosim.ops import maximum, minimum, select

EXPIRES = 0.02
"""Probability per sample with which a drift ends that no other sensor bears witness to: it may as well be the state's motion."""

SETTLES = 0.02
"""Probability per sample with which a mode of the process that has ended is taken for over: until then that it was there is a
hypothesis of its own, for often only the samples after a kick tell of it."""

TELLING = 9.0
"""Squared offset of all sensors of a group, in its variance, from which on it is one."""


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
    begin, set_out = make_begin(layout), make_set_out(layout)
    move_offsets, move_actuators = make_move_offsets(layout, pass_other), make_move_actuators(layout, pass_other)
    move_process, arrive = make_move_process(layout, pass_other), make_arrive(layout)
    move_lost, move_common = make_move_lost(layout, pass_other), make_move_common(layout, pass_other)
    n, m, none, kept, sensor, row_length = layout.n, layout.m, layout.first, layout.kept, layout.sensor, layout.row
    places = Places(layout.couples, layout.shift, layout.scratch)

    def pass_time(sample, model, start, covariance, largest, applied, memory, settings):
        _, e, present, _, nominal = sample
        A, B, C, Q = model
        sampled = 0.0 * memory[none]
        for i in range(m):
            sampled = maximum(sampled, present[i])
        begin(memory, settings)
        set_out(B, applied, memory)
        for i in range(m):
            pass_alone(memory, none + kept + i * sensor, settings, i * row_length)
        moving = Moving(A, Q, start, covariance, largest)
        move(memory, none, n, 0, 0, NO_OFFSET, moving, places)
        move_offsets(e, C, nominal, moving, memory, settings)
        move_lost(C, nominal, moving, memory, settings)
        move_common(nominal, moving, memory, settings)
        move_actuators(B, applied, moving, memory, settings)
        move_process(sampled, C, nominal, moving, memory, settings)
        arrive(e, sampled, C, Q, nominal, applied, memory, settings)

    return pass_time


@cache
def make_set_out(layout: Layout) -> Callable[..., None]:
    """Return the step function that says what moves the state beside the prediction, and empties the pool.

    The prediction counts on what is believed of the actuators; a hypothesis departs from it by what it believes of them.
    """
    n, p, none, pool, couples, shift = layout.n, layout.p, layout.first, layout.pool, layout.couples, layout.shift
    actuators, actuator = layout.actuators, layout.actuator

    def set_out(B, applied, memory):
        for a in range(n):
            memory[couples + a] = 0.0 * memory[none]
            total = 0.0 * memory[none]
            for j in range(p):
                works, load = memory[actuators + j * actuator + WORKS], memory[actuators + j * actuator + LOAD]
                total = total + B[a, j] * (applied[j] - (works * applied[j] + load))
            memory[shift + a] = total
        memory[pool] = 0.0 * memory[none]

    return set_out


@cache
def make_move_offsets(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that moves the hypotheses of an offset, of which some end and some are no longer fresh.

    Young ones end sooner than old ones while the state is `measurable`: of one that is hardly known without the sensor each part
    that ends, small as it may be, would spoil what is believed without a fault.
    """
    n, m, K = layout.n, layout.m, len(layout.kinds)
    kinds, becomes, slow = layout.kinds or (0,), layout.becomes or (0,), layout.slow or (0,)
    fresh, jumps, haste = layout.fresh or (False,), layout.jumps or (False,), layout.haste
    row_length, width_of_settings, sensor, kept = layout.row, layout.width_of_settings, layout.sensor, layout.kept
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    witnessed, collect, become = make_witnessed(layout), make_collect(layout), make_become(layout)

    def move_offsets(e, C, nominal, moving, memory, settings):
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
                move(memory, at, n, 1, 1, Onset(0.0, jump + slope, slope, slope, walk), moving, places)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                ends = settings[row + ENDS]
                if jumps[q]:
                    early = settings[haste] * measurable(memory, at, n, C, nominal)
                    ends = ended(ends, memory[at + OFFSET_AGE], early)
                collect(memory, at, minimum(ends + ((1.0 - seen) * EXPIRES if slow[q] else 0.0), 1.0), i)
                if fresh[q]:
                    become(memory, none + (1 + i * K + becomes[q]) * stride, at, i)

    return move_offsets


@cache
def make_move_lost(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that moves the hypotheses that a sensor goes its own course, of which some end, as offsets do."""
    n, m, U, lost = layout.n, layout.m, len(layout.lost), layout.lost or (0,)
    row_length, width_of_settings, sensor, kept = layout.row, layout.width_of_settings, layout.sensor, layout.kept
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    first_lost, haste, collect = layout.first_lost, layout.haste, make_collect(layout)

    def move_lost(C, nominal, moving, memory, settings):
        for i in range(m):
            for u in range(U):
                at = none + (first_lost + i * U + u) * stride
                row = i * row_length + FIRST_SETTINGS + lost[u] * width_of_settings
                for j in range(m):
                    if j != i:
                        pass_other(memory, at + kept + j * sensor, settings, j * row_length)
                move(memory, at, n, 0, 0, NO_OFFSET, moving, places)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                early = settings[haste] * measurable(memory, at, n, C, nominal)
                collect(memory, at, ended(settings[row + ENDS], memory[at + OFFSET_AGE], early), i)

    return move_lost


@cache
def make_move_common(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that moves the hypotheses that all sensors of a group have the same offset, of which some end.

    That one ends with this sample is a hypothesis of its own: merged at once with that of a plant that was kicked, whose state
    is another one, it would spoil that. An offset that is not `TELLING` ends, too, or it would be merged with one that jumps.
    """
    n, m, groups, judged = layout.n, layout.m, len(layout.groups), layout.judged
    first_common, first_ended = layout.first_common, layout.first_ended
    firsts = tuple(group[0] for group in layout.groups) or (0,)
    row_length, sensor, kept, N = layout.row, layout.sensor, layout.kept, layout.n + 2
    none, length, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    common, collect = FIRST_SETTINGS + layout.common * layout.width_of_settings, make_collect(layout)

    def move_common(nominal, moving, memory, settings):
        for g in range(groups):
            i, h = firsts[g], first_common + g
            at, after, row = none + h * length, none + (first_ended + g) * length, i * row_length + common
            for j in range(m):
                if judged[h * m + j] == BY_MODES:
                    pass_other(memory, at + kept + j * sensor, settings, j * row_length)
            walk = settings[row + OWN_SETTINGS + 2] * nominal[i, i]
            move(memory, at, n, 1, 0, Onset(0.0, 0.0, 0.0, 0.0, walk), moving, places)
            memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
            move(memory, after, n, 0, 0, NO_OFFSET, moving, places)
            collect(memory, after, 1.0, -1)
            c, cc = memory[at + STATE + n], memory[at + STATE + N + n * N + n]
            ends = select(c * c > TELLING * cc, settings[row + ENDS], 1.0)
            for a in range(length):
                memory[after + a] = memory[at + a]
            memory[after] = maximum(memory[at] * ends, LEAST)
            memory[at] = maximum(memory[at] - memory[at] * ends, LEAST)

    return move_common


@cache
def make_move_actuators(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that moves the hypotheses of an actuator's mode, of which some end."""
    n, m, p, L = layout.n, layout.m, layout.p, layout.actuator_modes
    sensor, kept, row_length, first_actuator = layout.sensor, layout.kept, layout.row, layout.first_actuator
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    couples, shift = layout.couples, layout.shift
    of_actuators, collect = layout.actuator_settings, make_collect(layout)

    def move_actuators(B, applied, moving, memory, settings):
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                own = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                for i in range(m):
                    pass_other(memory, at + kept + i * sensor, settings, i * row_length)
                for a in range(n):
                    memory[couples + a] = B[a, j] * (settings[own + ABSOLUTE] + settings[own + RELATIVE] * applied[j])
                    memory[shift + a] = memory[shift + a] + B[a, j] * settings[own + TAKES] * applied[j]
                mean = settings[own + MEAN] + settings[own + FOLLOWS] * applied[j]
                onset = Onset(mean, settings[own + VARIANCE], 0.0, 0.0, settings[own + WALK])
                move(memory, at, n, 1, 0, onset, moving, places)
                for a in range(n):
                    memory[shift + a] = memory[shift + a] - B[a, j] * settings[own + TAKES] * applied[j]
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                collect(memory, at, settings[own + END], -1)

    return move_actuators


@cache
def make_move_process(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that moves the hypotheses of the process' modes, and the one that such a mode has ended.

    A belief fades only where a sensor was ``sampled`` (1, else 0), and while it is `measurable`: it would grow without bound.
    """
    n, plant, m, H, G = layout.n, layout.plant, layout.m, layout.hypotheses, layout.process_modes
    sensor, kept, row_length, process = layout.sensor, layout.kept, layout.row, layout.process
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    of_process, collect, receive = layout.process_settings, make_collect(layout), make_receive(layout)

    def move_process(sampled, C, nominal, moving, memory, settings):
        for q in range(H - process):
            at = none + (process + q) * stride
            for i in range(m):
                pass_other(memory, at + kept + i * sensor, settings, i * row_length)
            move(memory, at, n, 0, 0, NO_OFFSET, moving, places)
        if G > 0:
            after = none + (process + G) * stride
            collect(memory, after, SETTLES, -1)
            for q in range(G):
                at, own = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
                ended = memory[at] * settings[own + STOPS]
                memory[at] = maximum(memory[at] - ended, LEAST)
                receive(memory, after, ended, at, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                fades = sampled * settings[own + FADES] * measurable(memory, at, n, C, nominal)
                inflate(memory, at, n, plant, settings[own + MORE], fades, moving.Q)

    return move_process
