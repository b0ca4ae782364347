"""Alarms of a fault probability, and their parts: an alarm has several where the kind of fault changes for good."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bayesftc.cosim.judging.signals import ALARM, ActuatorSignals, Flags, SensorSignals
from bayesftc.cosim.types import Floats

HOLD, HOLD_SAMPLES, MOST_HOLD_SAMPLES = 1.0, 10, 200
"""Seconds below the threshold after which an alarm ends; at least, and at most so many samples."""

LASTING = 1 / 8
"""Share of an alarm by which a change of its kind must be more probable than none.

With a smaller share, an offset that is called a drift only once it has grown is two faults. The same time as for the end of an
alarm is the least, because a learner distinguishes offset, drift and jump only some samples after the begin.
"""

PLAIN = ("DroppedOut",)
"""Kinds that the samples show by themselves: a change to them counts from `HOLD_SAMPLES` on."""


def alarms(probability: Floats, threshold: float, hold: int) -> list[tuple[int, int]]:
    """Return the first step of each alarm and the step after its last. Gaps of at most `hold` steps do not end it."""
    above = np.flatnonzero(probability >= threshold)
    if not len(above):
        return []
    breaks = np.flatnonzero(np.diff(above) > hold + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(above) - 1]])
    return [(int(above[a]), int(above[b]) + 1) for a, b in zip(first, last, strict=True)]


class Part(NamedTuple):
    """A part of an alarm with one kind of fault (0: unknown), and the begin of the alarm: steps, the end being that after."""

    alarm: int
    begin: int
    end: int
    kind: int


def parts_of_device(
    device: SensorSignals | ActuatorSignals, time: Floats, threshold: float = ALARM, hold: float | None = None
) -> list[Part]:
    """Return the parts of all alarms of a sensor or an actuator.

    Parameters
    ----------
    device : SensorSignals or ActuatorSignals
        The device.
    time : ndarray, shape (steps,)
        Times of the steps in seconds.
    threshold, hold
        As for `findings`.
    """
    score = score_of(device)
    if score is None:
        return []
    span = float(time[-1] - time[0]) if len(time) > 1 else 0.0
    step = span / (len(time) - 1) if span else 1.0
    most = round(min(usual_hold(step) if hold is None else hold, span) / step)
    return parts_of_alarms(score, chances_of(device), threshold, most, step, plain_kinds(device.kinds))


def plain_kinds(kinds: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of the kinds that are `PLAIN`."""
    return tuple(k for k, name in enumerate(kinds) if name in PLAIN)


def parts_of_alarms(
    score: Floats, chances: Floats | None, threshold: float, hold: int, step: float, plain: Sequence[int] = ()
) -> list[Part]:
    """Return the parts of all alarms of a fault probability; see `alarms` and `parts`.

    Where the kind changes over a pause, an alarm ends before the pause and another one begins after it.
    """
    found = []
    for begin, end in alarms(score, threshold, hold):
        listed = [(begin, end, 0)] if chances is None else parts(chances, begin, end, step, score >= threshold, plain)
        alarm = before = begin
        for a, b, kind in listed:
            alarm = alarm if a == before else a
            found.append(Part(alarm, a, b, kind))
            before = b
    return found


def usual_hold(step: float) -> float:
    """Return the seconds below the threshold after which an alarm ends by default, for samples that are `step` seconds apart."""
    return max(min(HOLD, MOST_HOLD_SAMPLES * step), HOLD_SAMPLES * step)


def parts(
    chances: Floats, begin: int, end: int, step: float, above: Flags | None = None, plain: Sequence[int] = ()
) -> list[tuple[int, int, int]]:
    """Return the parts of an alarm with one kind of fault each: first step, step after the last, number of the kind.

    Within a part its kind has the largest mean probability of all kinds. There is a further part only where its kind is more
    probable than that before for so many samples that this is no flicker; see `LASTING`.

    Parameters
    ----------
    chances : ndarray, shape (steps, kinds)
        Probability of each kind of fault.
    begin, end : int
        First step of the alarm, and the step after its last.
    step : float
        Seconds between two steps.
    above : ndarray of bool, shape (steps,), optional
        Where the fault probability is at least the threshold; by default everywhere. The others are the pauses of the alarm: no
        part begins or ends in one, and a pause over which the kind changes belongs to no part.
    plain : sequence of int
        Indices of the kinds that are `PLAIN`.

    Returns
    -------
    list of tuple of int
        The kinds count from 1; 0 is an unknown kind, where all probabilities are 0.
    """
    p, pause = np.nan_to_num(chances[begin:end]), np.zeros(end - begin, bool) if above is None else ~above[begin:end]
    likeliest = p.argmax(axis=1)
    edges = np.concatenate([[0], np.flatnonzero((np.diff(likeliest) != 0) | (np.diff(pause) != 0)) + 1])
    sums = np.add.reduceat(p, edges)
    ends = [*(begin + edges[1:]).tolist(), end]
    return [
        (begin + int(edges[a]), ends[b - 1], kind + 1 if sums[a:b, kind].any() else 0)
        for a, b, kind in sections(sums, pause[edges], end - begin, step, plain)
    ]


def sections(
    sums: Floats, pauses: Sequence[bool] | Flags, samples: int, step: float, plain: Sequence[int] = ()
) -> list[tuple[int, int, int]]:
    """Return the parts of an alarm as `parts` does, from the sum of the probabilities over each stretch with one likeliest kind.

    Parameters
    ----------
    sums : ndarray, shape (stretches, kinds)
        The sums.
    pauses : sequence of bool
        Whether each stretch is in a pause of the alarm.
    samples : int
        Number of samples of the alarm.
    step : float
        Seconds between two samples.
    plain : sequence of int
        Indices of the kinds that are `PLAIN`.

    Returns
    -------
    list of tuple of int
        First stretch, the one after the last, and the index of the kind.
    """
    every = np.arange(sums.shape[1])
    # Of a change from one kind (row) to another, in samples with a probability of 1.
    cost = np.full((len(every), len(every)), max(usual_hold(step) / step, LASTING * samples))
    cost[:, list(plain)] = HOLD_SAMPLES  # not from one: two kinds would be cheap to change by way of it
    best, before = sums[0], []
    for each in sums[1:]:  # the largest sum of probabilities minus costs (Viterbi's algorithm)
        changed = best[:, np.newaxis] - cost
        other = changed.argmax(axis=0)
        changes = best < changed.max(axis=0)
        before.append(np.where(changes, other, every))
        best = np.where(changes, changed.max(axis=0), best) + each
    kinds = [int(best.argmax())]
    for origin in reversed(before):
        kinds.append(int(origin[kinds[-1]]))
    kinds.reverse()
    edges = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist(), len(kinds)]
    for n, (a, b) in enumerate(pairwise(edges[:-1]), start=1):
        edges[n] = _at_pause(sums[:, kinds[a]] - sums[:, kinds[b]], pauses, a, b, cost[kinds[a], kinds[b]])
    listed: list[tuple[int, int, int]] = []
    for a, b in pairwise(edges):
        own = np.flatnonzero(sums[a:b].argmax(axis=1) == kinds[b - 1])
        end = a + int(own[-1]) + 1 if kinds[b - 1] in plain and len(own) else b
        rest = sums[end:b].sum(axis=0)
        back = rest.sum() >= HOLD_SAMPLES  # the samples are back
        listed += [(a, end, kinds[b - 1]), (end, b, int(rest.argmax()))] if back else [(a, b, kinds[b - 1])]
    return [(*span, kind) for a, b, kind in listed if (span := _without_pauses(pauses, a, b))]


def _at_pause(better: Floats, pauses: Sequence[bool] | Flags, first: int, after: int, cost: float) -> int:
    """Return the first stretch of the next part: after the last pause of a part if what follows the pause is no kind of its own.

    The learner distinguishes kinds only some samples after a fault begins, and then these have the kind of the fault before.
    """
    begin = max((k + 1 for k in range(first, after) if pauses[k]), default=after)
    return begin if better[begin:after].sum() < cost else after


def _without_pauses(pauses: Sequence[bool] | Flags, first: int, after: int) -> tuple[int, int] | None:
    """Return the first stretch and the one after the last without pauses at either end; None if nothing is left."""
    alarmed = [k for k in range(first, after) if not pauses[k]]
    return (alarmed[0], alarmed[-1] + 1) if alarmed else None


def score_of(device: SensorSignals | ActuatorSignals) -> Floats | None:
    """Return the fault probability of a device, or its explicit detections; None without both."""
    if device.probability is not None and not np.isnan(device.probability).all():
        return device.probability
    detected: Flags | None = getattr(device, "detected", None)
    return None if detected is None else detected.astype(np.float64)


def chances_of(device: SensorSignals | ActuatorSignals) -> Floats | None:
    """Return the probability of each kind of fault of a device, 0 for harmless kinds; None if it has no kinds.

    If only the most probable kind was recorded, its probability is 1.
    """
    if device.kind is None:
        return None
    if device.chances is not None:
        chances = np.array(device.chances[:, 1:])
    else:
        number = np.nan_to_num(device.kind)
        chances = (number[:, None] == np.arange(1, 1 + max(len(device.kinds), int(number.max()), 1))).astype(np.float64)
    chances[:, [number for number, scale in enumerate(device.sizes) if not scale]] = 0.0
    if isinstance(device, SensorSignals) and device.samples is not None:  # a slow sensor is silent between its samples
        for k in plain_kinds(device.kinds):
            chances[device.pauses, k] = 0.0
    return chances


__all__ = [
    "Part",
    "alarms",
    "chances_of",
    "parts",
    "parts_of_alarms",
    "parts_of_device",
    "plain_kinds",
    "score_of",
    "sections",
    "usual_hold",
]
