"""What a run shows of faults: alarms with kind, time and size, alarms that are none, and faults that never began."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, pairwise, zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.judging.alarms import judge_alarms
from bayesftc.cosim.judging.metrics import false_alarm_rate, figures, periods
from bayesftc.cosim.judging.signals import (
    ALARM,
    REMEMBERED,
    ActuatorSignals,
    Flags,
    LoopSignals,
    QuantitySignals,
    SensorSignals,
)
from bayesftc.cosim.run.result import ESTIMATE_A_LOAD
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

HOLD, HOLD_SAMPLES, MOST_HOLD_SAMPLES = 1.0, 10, 200
"""Seconds below the threshold after which an alarm ends; at least, and at most so many samples."""
LASTING = 1 / 8
"""Share of an alarm by which a change of its kind must be more probable than none.

With a smaller share, an offset that is called a drift only once it has grown is two faults. The same time as for the end of an
alarm is the least, because a learner distinguishes offset, drift and jump only some samples after the begin.
"""
SURE_ONSET = ("Frozen",)
"""Kinds whose onset is certain when they are found, from equal samples: later estimates only forget it."""

OFFSETS = ("Offset", "Drifting", "Ramping")
"""Kinds whose size is the present offset of the sensor."""

PLAIN = ("DroppedOut",)
"""Kinds that the samples show by themselves: a change to them counts from `HOLD_SAMPLES` on."""
UNITS = {"noise": "x noise", "distance": "x noise from the belief", "effect": "of the effect"}
"""Units of sizes that are not in the unit of the sensor or the control."""

AT_ONCE = 20
"""Number of samples within which an alarm begins with the run."""

AGREE = 1.5
"""Largest root mean square of the difference of two sensors that agree, in multiples of its noise."""

LEAST = 10
"""Least number of samples, one after the other, with an alarm of all sensors."""

MOST = 100
"""Number of samples from the begin of the alarms in which they must agree; one may fail later."""

MANY_FALSE_ALARMS = 0.05
"""Share of a sensor's fault-free time in alarm from which a run has a note."""

LOUDER = 1.5
"""Ratio of the noise of sensors to the expected one from which this is the reason why all of them are blamed."""

LOOK_AT_MODEL = (
    "Look at the model first. The plant may have another gain, time constant or delay, or an input that the model lacks. The "
    "plant's noise may be larger than the model says, many times smaller, or act elsewhere (process_covariance; noise in "
    "design). The sensors' noise may be larger (sensor_covariance; sensor_std in design). Other sensors may have an offset, or "
    "an error that they share (with_sensor_errors). After a longer run without faults, controllers.diagnose(result, controller) "
    f"may name the error. {ESTIMATE_A_LOAD}"
)
"""What to do where a healthy sensor is blamed often, and nothing else says why."""

QUIET = 0.7
"""Ratio of the distance of samples from the belief to its standard deviation, below which the plant moves less than stated."""


@dataclass(frozen=True)
class Finding:
    """A fault that the controller infers or detects: one alarm, or a part of one whose kind changed for good.

    Attributes
    ----------
    where : str
        The sensor, the actuator, or ``"process"``.
    kind : str
        Kind of fault with the largest mean probability; empty if the learner distinguishes none.
    onset : float or None
        Estimated time of the fault's begin in seconds, never after `start`, nor before the end of an earlier alarm of the same
        device; None if it is not estimated.
    start, end : float
        Times of the first and the last sample, in seconds.
    size : float or None
        Size of the fault at the end; None if it is not estimated.
    unit : str
        Unit of the size; ``"x noise"`` for multiples of the sensor's noise, ``"x noise from the belief"`` for the distance of the
        samples from the belief in these (about 1 for a healthy sensor), ``"of the effect"`` for the share that is lost.
    probability : float or None
        Largest fault probability; None for a detection without probabilities.
    alarms : int
        Number of alarms, with short pauses between them: often one for a fault that lasts, many for single outliers.
    """

    where: str
    kind: str
    onset: float | None
    start: float
    end: float
    size: float | None
    unit: str
    probability: float | None
    alarms: int = 1


def findings(signals: LoopSignals, threshold: float = ALARM, hold: float | None = None) -> list[Finding]:
    """Return the alarms of a run in the order of their begin, those whose kind changed for good in parts.

    Parameters
    ----------
    signals : LoopSignals
        The signals of the run.
    threshold : float
        Least fault probability of an alarm.
    hold : float, optional
        Seconds below the threshold after which an alarm ends; by default 1 s, but at least 10 and at most 200 samples.
        A shorter pause ends it as well if the kind before the pause is another than that after it.
    """
    time = signals.time
    found: list[Finding] = []
    for sensor in signals.sensors:
        found += _of(sensor, signals.sensor_name(sensor.index), time, threshold, hold)
    for actuator in signals.actuators:
        found += _of(actuator, f"actuator {actuator.name}", time, threshold, hold)
    if (moved := signals.moved) is not None:
        found += _of(moved, moved.name, time, threshold, hold)
    return sorted(found, key=lambda each: each.start)


def plain_findings(signals: LoopSignals) -> list[dict[str, Any]] | None:
    """Return the findings as plain data; None if no fault probability and no detection is recorded."""
    devices: tuple[SensorSignals | ActuatorSignals, ...] = (*signals.sensors, *signals.actuators)
    inferred = any(device.probability is not None and np.isfinite(device.probability).any() for device in devices)
    if not inferred and all(sensor.detected is None for sensor in signals.sensors):
        return None
    return [asdict(each) for each in findings(signals)]


def _moves(quantity: QuantitySignals) -> bool:
    """Return whether a quantity's reference changes, or is not recorded although there is one."""
    reference = quantity.reference
    return quantity.has_goal if reference is None else len(np.unique(reference[np.isfinite(reference)])) > 1


def numbers_of(signals: LoopSignals) -> dict[str, Any]:
    """Return the figures of a run, the controller's lag, units, and findings, as plain data for `tables_of` and files."""
    units = {q.name: q.unit for q in signals.quantities}
    step = float(signals.time[1] - signals.time[0]) if len(signals.time) > 1 else None
    return {
        "law": signals.lag if any(map(_moves, signals.quantities)) else "",
        "units": units,
        "step": step,
        "hold": step and usual_hold(step),
        **figures(signals).to_dict(),
        "findings": plain_findings(signals),
        "alarms": _alarms_of(signals, step),
    }


def _alarms_of(signals: LoopSignals, step: float | None) -> dict[str, Any] | None:
    """Return the figures of the alarms of all sensors, as those of `judge_alarms`; None where faults or alarms are not known."""
    scores, faulty = [], []
    for sensor in signals.sensors:
        if sensor.alarm is not None and sensor.faulty is not None:
            scores.append(sensor.alarm.astype(float) if sensor.probability is None else sensor.probability)
            faulty.append(sensor.faulty)
    if not scores or step is None:
        return None
    return judge_alarms(np.transpose(scores), np.transpose(faulty), threshold=ALARM, step=step).to_dict()


def findings_frame(found: Sequence[Finding]) -> pd.DataFrame:
    """Return findings as a table of pandas."""
    import pandas as pd

    columns = {
        "where": "where",
        "kind": "kind",
        "onset": "onset",
        "start": "from",
        "end": "until",
        "size": "size",
        "unit": "unit",
        "probability": "probability",
        "alarms": "alarms",
    }
    frame = pd.DataFrame([asdict(each) for each in found], columns=list(columns)).rename(columns=columns)
    return frame.astype(dict.fromkeys(("onset", "from", "until", "size", "probability"), float))


def alarms(probability: Floats, threshold: float, hold: int) -> list[tuple[int, int]]:
    """Return the first step of each alarm and the step after its last. Gaps of at most `hold` steps do not end it."""
    above = np.flatnonzero(probability >= threshold)
    if not len(above):
        return []
    breaks = np.flatnonzero(np.diff(above) > hold + 1)
    first, last = np.concatenate([[0], breaks + 1]), np.concatenate([breaks, [len(above) - 1]])
    return [(int(above[a]), int(above[b]) + 1) for a, b in zip(first, last, strict=True)]


def onset_of_alarm(onset: float | None, begin: float, earlier: float | None) -> float | None:
    """Return the onset that an alarm shows: not after its begin, and not before the end of an earlier alarm of the device.

    Between the two alarms the device counted as healthy. The learner may know better later on, but the two would then overlap.

    Parameters
    ----------
    onset : float or None
        The learner's estimate in seconds; None if there is none.
    begin : float
        Begin of the alarm.
    earlier : float or None
        End of the alarm before; None for the first.
    """
    if onset is None:
        return None
    return min(onset if earlier is None else max(onset, earlier), begin)


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
    score = _score(device)
    if score is None:
        return []
    span = float(time[-1] - time[0]) if len(time) > 1 else 0.0
    step = span / (len(time) - 1) if span else 1.0
    most = round(min(usual_hold(step) if hold is None else hold, span) / step)
    return parts_of_alarms(score, _chances(device), threshold, most, step, plain_kinds(device.kinds))


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


def _of(
    device: SensorSignals | ActuatorSignals, where: str, time: Floats, threshold: float, hold: float | None
) -> Iterator[Finding]:
    """Give the alarms of a sensor or an actuator, in parts."""
    score = _score(device)
    p = device.probability if score is device.probability else None
    earlier: float | None = None
    for part, following in zip_longest(found := parts_of_device(device, time, threshold, hold), found[1:]):
        begin, end, kind = part.begin, part.end, part.kind
        size = size_at_end(getattr(device, "size", None), device.kind, part, device.kinds)
        sure = _name(device.kinds, kind) in SURE_ONSET
        onset = onset_of_kind(getattr(device, "onset", None), device.kind, part, first=sure)
        scale = device.sizes[kind - 1] if 0 < kind <= len(device.sizes) else "unit"
        if kind > len(device.sizes):  # a file of an earlier version does not say what its size is
            size = None
        yield Finding(
            where,
            _name(device.kinds, kind),
            onset_of_alarm(onset, float(time[begin]), earlier),
            float(time[begin]),
            float(time[end - 1]),
            size,
            "" if size is None else UNITS.get(scale, device.unit or ""),
            None if p is None else float(np.nanmax(p[begin:end])),
            len(periods(np.asarray(score)[begin:end] >= threshold)),
        )
        if following is None or following.alarm != part.alarm:
            earlier = float(time[end - 1])


def _score(device: SensorSignals | ActuatorSignals) -> Floats | None:
    """Return the fault probability of a device, or its explicit detections; None without both."""
    if device.probability is not None and not np.isnan(device.probability).all():
        return device.probability
    detected: Flags | None = getattr(device, "detected", None)
    return None if detected is None else detected.astype(np.float64)


def _chances(device: SensorSignals | ActuatorSignals) -> Floats | None:
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


def onset_of_kind(values: Floats | None, most: Floats | None, part: Part, *, first: bool = False) -> float | None:
    """Return the onset of a part: the last one of its kind, or the first one, or None without any.

    Parameters
    ----------
    values : ndarray or None
        The learner's estimate at each step, which is that of the most probable mode of all, healthy included.
    most : ndarray or None
        The number of that mode at each step.
    part : Part
        The part.
    first : bool
        Whether to return the first one; see `SURE_ONSET`.
    """
    if values is None or most is None:
        return None
    rows = part.begin + np.flatnonzero(most[part.begin : part.end] == part.kind)
    row = 0 if first else -1
    return float(values[rows[row]]) if len(rows) and np.isfinite(values[rows[row]]) else None


def size_at_end(values: Floats | None, most: Floats | None, part: Part, kinds: Sequence[str]) -> float | None:
    """Return the last size of a part, of its kind or of one whose size means the same; None without any.

    A slow drift may be Drifting and Ramping in turns. Both know its offset, and that of its own kind may be hours old.

    Parameters
    ----------
    values, most, part
        As for `onset_of_kind`.
    kinds : sequence of str
        The names of the kinds.
    """
    if values is None or most is None:
        return None
    offsets = [number for number, kind in enumerate(kinds, 1) if kind in OFFSETS]
    same = offsets if part.kind in offsets else [part.kind]
    within = slice(part.begin, part.end)
    sizes = values[within][np.isin(most[within], same) & np.isfinite(values[within])]
    return float(sizes[-1]) if len(sizes) else None


def _name(kinds: Sequence[str], number: int) -> str:
    return "" if number == 0 else kinds[number - 1] if number <= len(kinds) else f"kind {number}"


def blamed_together(signals: LoopSignals, decimation: int = 1) -> dict[str, list[str]]:
    """Return notes on quantities of which all sensors, or all but one, have an alarm, without a fault, although they agree.

    The reason is named (``"named"``) if all are called noisier, or if the alarms begin with the run, and no fault of an input has
    begun: then it is the belief at the start; or if one sensor is believed against the others. Else it is some error of the model
    (``"model"``).
    """
    notes: dict[str, list[str]] = {"named": [], "model": []}
    begun = [int(i.faulty.argmax()) for i in signals.inputs if i.faulty is not None and i.faulty.any()]
    for quantity in signals.quantities:
        if not quantity.sensors:
            continue
        group = [signals.sensors[i] for i in quantity.sensors]
        alarms = [s.alarm & ~s.faulty for s in group if s.alarm is not None and s.faulty is not None]
        samples = [s.samples for s in group if s.samples is not None]
        if len(samples) < len(group) or len(alarms) < len(group):
            continue
        first = alarms_of_all(samples, alarms)
        if first is None:
            for of, note in _outvoted(quantity, signals, samples, alarms, decimation):
                notes[of].append(note)
            continue
        of, wrong = "model", _unlike(signals, first, decimation)
        sensors, t = "both" if len(group) == 2 else f"all {len(group)}", signals.time[first]
        noise = float(np.median([_noise(one - other) for one, other in combinations(samples, 2)]))
        if all(_noisier(s, first, noise) for s in group):
            notes["named"].append(
                f"{sensors} sensors of {quantity.name} are blamed from t = {t:g} s because they are noisier than the model says: "
                f"by their differences, each has noise with a standard deviation of about {noise:.2g}{behind(quantity.unit)}. "
                "State that in the controller's model (sensor_std in design, or sensor_covariance)"
            )
            continue
        if first * decimation < AT_ONCE and min(begun, default=first + 1) > first:
            of, wrong = (
                "named",
                "the controller's belief at the start (initial_mean, initial_spread) or its model is wrong",
            )
        notes[of].append(f"{sensors} sensors of {quantity.name} agree but are blamed from t = {t:g} s: {wrong}")
    return notes


def _outvoted(
    quantity: QuantitySignals,
    signals: LoopSignals,
    samples: Sequence[Floats],
    alarms: Sequence[Flags],
    decimation: int,
) -> Iterator[tuple[str, str]]:
    """Yield a note where all sensors of a quantity but one are blamed though they agree, two or more, with what it is about.

    The other one is believed, or it is faulty as well, and the model alone is believed.
    """
    for k, other in enumerate(quantity.sensors):
        first = alarms_of_all(*([*each[:k], *each[k + 1 :]] for each in (samples, alarms)))
        if first is None:
            continue
        *most, last = (str(i) for i in quantity.sensors if i != other)
        who = f"sensors {', '.join(most)} and {last} of {quantity.name} agree but are blamed from t = {signals.time[first]:g} s"
        if _missed(signals, other)[first : first + MOST].mean() > 0.5:
            yield (
                "named",
                f"{who}, and sensor {other}, which has a fault, is believed: where the model is not exact, a slow fault of the "
                "most accurate sensor may look like one of the others. Improve the model (docs/explanation/wrong-models.md)",
            )
        else:
            yield "model", f"{who}: {_unlike(signals, first, decimation)}"
        return


def _unlike(signals: LoopSignals, row: int, decimation: int) -> str:
    """Return why sensors that agree may be blamed from a row on: the model, or faults of several that misled the belief."""
    before = slice(max(row - REMEMBERED // decimation, 0), row + 1)
    failed = sum(s.faulty is not None and bool(s.faulty[before].any()) for s in signals.sensors)
    misled = ", or faults of several sensors have misled the belief" if failed > 1 else ""
    return f"the plant behaves unlike the controller's model{misled}"


def _missed(signals: LoopSignals, index: int) -> Flags:
    """Return the steps at which a sensor has a sample and a fault without an alarm; none if that is not known."""
    sensor = signals.sensors[index]
    missed: Flags = np.zeros(len(signals.time), dtype=bool)
    if sensor.samples is not None and sensor.alarm is not None and sensor.faulty is not None:
        missed = sensor.faulty & ~sensor.alarm & np.isfinite(sensor.samples)
    return missed


def often_blamed(signals: LoopSignals) -> tuple[int, str] | None:
    """Return the sensor with most false alarms, and a note on it and on others with many; None if it has few."""
    rates = {sensor.index: false_alarm_rate(sensor) for sensor in signals.sensors}
    worst = max(rates, key=lambda i: np.nan_to_num(rates[i]), default=None)
    if worst is None or not rates[worst] >= MANY_FALSE_ALARMS:
        return None
    others = [i for i, rate in rates.items() if i != worst and rate >= MANY_FALSE_ALARMS]
    also = "".join(f", {signals.sensor_name(i)} for {rates[i]:.0%}" for i in others)
    return worst, f"{signals.sensor_name(worst)} is blamed for {rates[worst]:.0%} of its fault-free time{also}"


def advice_on(signals: LoopSignals, sensor: int) -> str:
    """Return what to do about a healthy sensor that is blamed often.

    Without a sensor that it blames, the belief is uncertain by the process noise. If the samples are much closer to it, that
    noise is stated too large.
    """
    of, quantity = signals.sensors[sensor], next((q for q in signals.quantities if sensor in q.sensors), None)
    if of.samples is None or of.alarm is None or of.faulty is None or quantity is None:
        return LOOK_AT_MODEL
    wrongly = of.alarm & ~of.faulty
    for i in quantity.sensors:
        if 2 * _missed(signals, i)[wrongly].sum() > wrongly.sum():
            third = "a third sensor, or " if len(quantity.sensors) == 2 else ""
            return (
                f"Meanwhile {signals.sensor_name(i)} has a fault and is not blamed. A slow fault of one sensor may look like one "
                f"of another: {third}a better model of the plant tells (docs/explanation/inference.md)."
            )
    if quantity.belief is None or quantity.spread is None:
        return LOOK_AT_MODEL
    blamed = wrongly & np.isfinite(of.samples)
    with np.errstate(over="ignore"):  # of a loop that diverges
        apart, expected = (
            float(np.sqrt(np.mean(values[blamed] ** 2))) if blamed.any() else np.nan
            for values in (of.samples - quantity.belief, quantity.spread)
        )
    if not apart < QUIET * expected:
        return LOOK_AT_MODEL
    unit = of.unit or ""
    return (
        f"While it is blamed, its samples differ from the belief by {f'{apart:.3g} {unit}'.rstrip()} (root mean square), less "
        f"than the model expects ({f'{expected:.3g} {unit}'.rstrip()} or more). The process noise of the model (noise= in "
        "design, process_covariance) is probably too large. State it as it is."
    )


def alarms_of_all(samples: Sequence[Floats], alarms: Sequence[Flags]) -> int | None:
    """Return the first sample from which on all sensors of a quantity have an alarm for a while although they agree, or None.

    Parameters
    ----------
    samples : sequence of ndarray, shape (steps,)
        The samples of each sensor; NaN is a missing one.
    alarms : sequence of ndarray of bool, shape (steps,)
        Where each sensor counts as faulty, and has no fault.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc.cosim.judging.findings import alarms_of_all
    >>> rng = np.random.default_rng(0)
    >>> first, second = 3.0 + 0.1 * rng.standard_normal((2, 100))
    >>> late = np.arange(100) >= 40
    >>> alarms_of_all([first, second], [late, late])
    40
    >>> alarms_of_all([first, second + 0.5 * late], [late, late])  # they do not agree
    """
    blamed = np.all(alarms, axis=0)
    if len(samples) < 2 or not blamed.any():
        return None
    differences = [one - other for one, other in combinations(samples, 2)]
    for begin, end in periods(blamed):
        if end - begin >= LEAST and all(_agree(d, begin, min(end, begin + MOST)) for d in differences):
            return begin
    return None


def _agree(difference: Floats, begin: int, end: int) -> bool:
    """Return whether a difference of two sensors is no more than their noise in a stretch.

    Its noise is estimated from its changes, so that offsets and drifts do not count for it.
    """
    finite = difference[np.isfinite(difference)]
    there = difference[begin:end][np.isfinite(difference[begin:end])]
    if len(there) < LEAST:
        return False
    return bool(np.sqrt(np.mean(there * there)) <= AGREE * 2.0**0.5 * _noise(finite))


def _noise(difference: Floats) -> float:
    """Return the standard deviation of the noise of each of two sensors, from the changes of their difference."""
    finite = difference[np.isfinite(difference)]
    return float(np.median(np.abs(np.diff(finite)))) * MAD / 2.0


def _noisier(sensor: SensorSignals, first: int, noise: float) -> bool:
    """Return whether a sensor is mostly called noisier while it is blamed, from a sample on, and has more noise than expected.

    Errors that all sensors share, as those of a plant that moves more than its model, do not count in their own `noise`.
    """
    if sensor.kind is None or sensor.alarm is None or sensor.precision is None or "Noisier" not in sensor.kinds:
        return False
    if not noise * noise * sensor.precision[0] > LOUDER**2:
        return False
    blamed = np.flatnonzero(sensor.alarm[first : first + MOST]) + first
    return bool(np.mean(sensor.kind[blamed] == 1 + sensor.kinds.index("Noisier")) > 0.5)


def never_began(diagram: Diagram, signals: Mapping[str, Floats]) -> Iterator[str]:
    """Yield a sentence for each fault on a condition that was absent in all recorded rows.

    Parameters
    ----------
    diagram : Diagram
        The diagram with the faults.
    signals : mapping of name to array
        The result of its run. A fault whose ``active`` is not recorded is left out.
    """
    for node in diagram.nodes:
        block, active = node.block, f"{node.name}.active"
        if (
            isinstance(block, Fault)
            and isinstance(block.start, When)
            and active in signals
            and not signals[active].any()
        ):
            begins = (
                f"on the condition {block.start}" if block.start.signal else "when its input start_signal is set to 1"
            )
            yield f"The fault {node.name!r} did not occur: it begins {begins}."


__all__ = [
    "AGREE",
    "HOLD",
    "HOLD_SAMPLES",
    "LOOK_AT_MODEL",
    "MANY_FALSE_ALARMS",
    "MOST_HOLD_SAMPLES",
    "Finding",
    "Part",
    "alarms",
    "alarms_of_all",
    "blamed_together",
    "findings",
    "findings_frame",
    "never_began",
    "numbers_of",
    "often_blamed",
    "onset_of_alarm",
    "onset_of_kind",
    "parts",
    "parts_of_alarms",
    "parts_of_device",
    "plain_findings",
    "sections",
    "size_at_end",
    "usual_hold",
]
