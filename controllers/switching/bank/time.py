"""The step of a bank of hypotheses between two samples: predictions, onsets and ends of faults, merges."""

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
)
from bayesftc.controllers.switching.bank.merges import (
    make_become,
    make_collect,
    make_describe,
    make_receive,
    make_witnessed,
)
from bayesftc.controllers.switching.bank.onsets import make_begin, make_merge_onsets
from bayesftc.controllers.switching.bank.starts import make_settle
from bayesftc.controllers.switching.mode_kernels import expected_jump
from bayesftc.controllers.switching.sensor_kernels import (
    BEGINS,
    ENDS,
    FIRST_SETTINGS,
    HEALTHY,
    LASTS,
    LEAST,
    OWN_SETTINGS,
    held,
)
from bayesftc.cosim.ops import maximum, minimum, select

EXPIRES = 0.02
"""Probability per sample that a drift without a witness ends, because it may be the state's motion."""

TELLING = 9.0
"""Squared common offset, in units of its variance, from which on it counts as an offset."""


def alone(settings, row):
    """Return the probability that no other fault begins on a sensor with a fault of this row.

    A hypothesis of two faults of one sensor would be too improbable to follow, but as often true as of one on a healthy sensor.
    """
    return settings[row + LASTS] + settings[row + ENDS]


@cache
def make_pass_sensor(layout: Layout, pass_other: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances a sensor in a hypothesis of another fault, in which some modes are not followed.

    That none of these begins counts against the hypothesis, as it does against that without a fault, where they are followed.
    """
    kept, sensor, row_length, width_of_settings = layout.kept, layout.sensor, layout.row, layout.width_of_settings
    left_out = tuple(k for k, of in enumerate(layout.other) if of == 0 and layout.faults[k] > 0)
    count, left_out = len(left_out), left_out or (0,)

    def pass_sensor(memory, at, i, settings):
        begins = 0.0 * memory[at]
        for k in range(count):
            begins = begins + settings[i * row_length + FIRST_SETTINGS + left_out[k] * width_of_settings + BEGINS]
        memory[at] = memory[at] * (1.0 - minimum(memory[at + kept + i * sensor + HEALTHY], 1.0) * begins)
        pass_other(memory, at + kept + i * sensor, settings, i * row_length)

    return pass_sensor


@cache
def make_pass_time(
    layout: Layout, pass_alone: Callable[..., None], pass_other: Callable[..., None]
) -> Callable[..., None]:
    """Return the step function that advances a bank by one sample.

    Parameters
    ----------
    layout : Layout
        Places in memory and settings.
    pass_alone, pass_other : function
        Transitions of a sensor's modes where no sensor has an offset, and of the other sensors where one has.
    """
    begin, prepare = make_begin(layout), make_prepare(layout)
    pass_sensor = make_pass_sensor(layout, pass_other)
    move_offsets, move_actuators = make_move_offsets(layout, pass_sensor), make_move_actuators(layout, pass_sensor)
    move_process, merge_onsets = make_move_process(layout, pass_sensor), make_merge_onsets(layout)
    move_lost, move_common = make_move_lost(layout, pass_sensor), make_move_common(layout, pass_sensor)
    n, m, none, kept, sensor, row_length = layout.n, layout.m, layout.first, layout.kept, layout.sensor, layout.row
    places = Places(layout.couples, layout.shift, layout.scratch)

    def pass_time(sample, model, start, covariance, largest, applied, memory, settings):
        _, e, present, _, nominal = sample
        A, B, C, Q = model
        sampled = 0.0 * memory[none]
        for i in range(m):
            sampled = maximum(sampled, present[i])
        begin(memory, settings)
        prepare(B, applied, memory)
        for i in range(m):
            pass_alone(memory, none + kept + i * sensor, settings, i * row_length)
        moving = Moving(A, Q, start, covariance, largest)
        move(memory, none, n, 0, 0, NO_OFFSET, moving, places)
        move_offsets(e, C, nominal, moving, memory, settings)
        move_lost(C, nominal, moving, memory, settings)
        move_common(nominal, moving, memory, settings)
        move_actuators(B, applied, moving, memory, settings)
        move_process(e, present, sampled, C, nominal, moving, memory, settings)
        merge_onsets(e, sampled, C, Q, nominal, applied, memory, settings)

    return pass_time


@cache
def make_prepare(layout: Layout) -> Callable[..., None]:
    """Return the step function that prepares the inputs of the state, and empties the pool.

    The prediction uses the expected effect of the actuators; a hypothesis differs from it by its own actuator fault.
    """
    n, p, none, pool, couples, shift = layout.n, layout.p, layout.first, layout.pool, layout.couples, layout.shift
    actuators, actuator = layout.actuators, layout.actuator

    def prepare(B, applied, memory):
        for a in range(n):
            memory[couples + a] = 0.0 * memory[none]
            total = 0.0 * memory[none]
            for j in range(p):
                works, load = memory[actuators + j * actuator + WORKS], memory[actuators + j * actuator + LOAD]
                total = total + B[a, j] * (applied[j] - (works * applied[j] + load))
            memory[shift + a] = total
        memory[pool] = 0.0 * memory[none]

    return prepare


@cache
def make_move_offsets(layout: Layout, pass_sensor: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances the hypotheses of an offset, with ends and first samples.

    Young offsets end sooner than old ones while the state is `measurable`. Without the sensor an unmeasurable state is nearly
    unknown; then even a small ended part would spoil the belief of the hypothesis without a fault.
    """
    n, m, K = layout.n, layout.m, len(layout.kinds)
    kinds, becomes, slow = layout.kinds or (0,), layout.becomes or (0,), layout.slow or (0,)
    fresh, jumps, haste = layout.fresh or (False,), layout.jumps or (False,), layout.haste
    row_length, width_of_settings, kept = layout.row, layout.width_of_settings, layout.kept
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    witnessed, collect, become = make_witnessed(layout), make_collect(layout), make_become(layout)
    describe, joined = make_describe(layout), layout.joined or (False,)

    def move_offsets(e, C, nominal, moving, memory, settings):
        for i in range(m):
            for q in range(K):
                at = none + (1 + i * K + q) * stride
                row = i * row_length + FIRST_SETTINGS + kinds[q] * width_of_settings
                mode_row = row + OWN_SETTINGS
                witness = witnessed(memory, at + kept, i)
                for j in range(m):
                    if j != i:
                        pass_sensor(memory, at, j, settings)
                jump = expected_jump(
                    held(e[i], nominal[i, i]), settings[mode_row], settings[mode_row + 3], nominal[i, i]
                )
                slope, walk = settings[mode_row + 1] * nominal[i, i], settings[mode_row + 2] * nominal[i, i]
                if joined[q]:
                    describe(memory, at, i, kinds[q])
                move(memory, at, n, 1, 1, Onset(0.0, jump + slope, slope, slope, walk), moving, places)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                memory[at] = memory[at] * alone(settings, row)
                ends = settings[row + ENDS]
                if jumps[q]:
                    early = settings[haste] * measurable(memory, at, n, C, nominal)
                    ends = ended(ends, memory[at + OFFSET_AGE], early)
                collect(memory, at, minimum(ends + ((1.0 - witness) * EXPIRES if slow[q] else 0.0), 1.0), i)
                if fresh[q]:
                    become(memory, none + (1 + i * K + becomes[q]) * stride, at, i)

    return move_offsets


@cache
def make_move_lost(layout: Layout, pass_sensor: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances the hypotheses of an unmodelled course, with ends as for offsets."""
    n, m, U, lost = layout.n, layout.m, len(layout.lost), layout.lost or (0,)
    row_length, width_of_settings = layout.row, layout.width_of_settings
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    first_lost, haste, collect = layout.first_lost, layout.haste, make_collect(layout)

    def move_lost(C, nominal, moving, memory, settings):
        for i in range(m):
            for u in range(U):
                at = none + (first_lost + i * U + u) * stride
                row = i * row_length + FIRST_SETTINGS + lost[u] * width_of_settings
                for j in range(m):
                    if j != i:
                        pass_sensor(memory, at, j, settings)
                move(memory, at, n, 0, 0, NO_OFFSET, moving, places)
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                memory[at] = memory[at] * alone(settings, row)
                early = settings[haste] * measurable(memory, at, n, C, nominal)
                collect(memory, at, ended(settings[row + ENDS], memory[at + OFFSET_AGE], early), i)

    return move_lost


@cache
def make_move_common(layout: Layout, pass_sensor: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances the hypotheses of a common offset of a group, with ends.

    The end at this sample is a separate hypothesis. Merged at once with that of a kicked plant, whose state differs, it would
    spoil that belief. An offset that is not `TELLING` ends as well, or it would be merged with one that jumps.
    """
    n, m, groups, judged = layout.n, layout.m, len(layout.groups), layout.judged
    first_common, first_ended = layout.first_common, layout.first_ended
    firsts = tuple(group[0] for group in layout.groups) or (0,)
    row_length, N = layout.row, layout.n + 2
    none, length, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    common, collect = FIRST_SETTINGS + layout.common * layout.width_of_settings, make_collect(layout)

    def move_common(nominal, moving, memory, settings):
        for g in range(groups):
            i, h = firsts[g], first_common + g
            at, after, row = none + h * length, none + (first_ended + g) * length, i * row_length + common
            for j in range(m):
                if judged[h * m + j] == BY_MODES:
                    pass_sensor(memory, at, j, settings)
                else:
                    memory[at] = memory[at] * alone(settings, j * row_length + common)
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
def make_move_actuators(layout: Layout, pass_sensor: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances the hypotheses of an actuator's mode, with ends."""
    n, m, p, L, first_actuator = layout.n, layout.m, layout.p, layout.actuator_modes, layout.first_actuator
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    couples, shift = layout.couples, layout.shift
    of_actuators, collect = layout.actuator_settings, make_collect(layout)

    def move_actuators(B, applied, moving, memory, settings):
        for j in range(p):
            for q in range(L):
                at = none + (first_actuator + j * L + q) * stride
                mode_row = of_actuators + (j * L + q) * ACTUATOR_SETTINGS
                for i in range(m):
                    pass_sensor(memory, at, i, settings)
                for a in range(n):
                    memory[couples + a] = B[a, j] * (
                        settings[mode_row + ABSOLUTE] + settings[mode_row + RELATIVE] * applied[j]
                    )
                    memory[shift + a] = memory[shift + a] + B[a, j] * settings[mode_row + TAKES] * applied[j]
                mean = settings[mode_row + MEAN] + settings[mode_row + FOLLOWS] * applied[j]
                onset = Onset(mean, settings[mode_row + VARIANCE], 0.0, 0.0, settings[mode_row + WALK])
                move(memory, at, n, 1, 0, onset, moving, places)
                for a in range(n):
                    memory[shift + a] = memory[shift + a] - B[a, j] * settings[mode_row + TAKES] * applied[j]
                memory[at + OFFSET_AGE] = memory[at + OFFSET_AGE] + 1.0
                collect(memory, at, settings[mode_row + END], -1)

    return move_actuators


@cache
def make_move_process(layout: Layout, pass_sensor: Callable[..., None]) -> Callable[..., None]:
    """Return the step function that advances the hypotheses of process modes, and the one of such a mode's end.

    A belief fades only if a sensor was ``sampled`` (1, else 0) and the state is `measurable`, or it would grow without bound.
    """
    n, plant, m, H, G = layout.n, layout.plant, layout.m, layout.hypotheses, layout.process_modes
    process = layout.process
    none, stride, places = layout.first, layout.length, Places(layout.couples, layout.shift, layout.scratch)
    of_process, settle, receive = layout.process_settings, make_settle(layout), make_receive(layout)
    most = layout.most

    def move_process(e, present, sampled, C, nominal, moving, memory, settings):
        for q in range(H - process):
            at = none + (process + q) * stride
            for i in range(m):
                pass_sensor(memory, at, i, settings)
            move(memory, at, n, 0, 0, NO_OFFSET, moving, places)
        if G > 0:
            after = none + (process + G) * stride
            settle(e, present, C, nominal, memory, settings, after)
            for q in range(G):
                at, mode_row = none + (process + q) * stride, of_process + q * PROCESS_SETTINGS
                ended = memory[at] * settings[mode_row + STOPS]
                memory[at] = maximum(memory[at] - ended, LEAST)
                receive(memory, after, ended, at, -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                fades = sampled * settings[mode_row + FADES] * measurable(memory, at, n, C, nominal)
                inflate(memory, at, n, plant, settings[mode_row + MORE], fades, moving.Q, settings, most)

    return move_process
