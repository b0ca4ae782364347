"""What a run shows of faults: alarms with kind, time and size, and faults that never began."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.judging.alarms import judge_alarms
from bayesftc.cosim.judging.metrics import figures, periods
from bayesftc.cosim.judging.parts import Part, parts_of_device, score_of, usual_hold
from bayesftc.cosim.judging.signals import ALARM, ActuatorSignals, LoopSignals, QuantitySignals, SensorSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    import pandas as pd

SURE_ONSET = ("Frozen",)
"""Kinds whose onset is certain when they are found, from equal samples: later estimates only forget it."""

OFFSETS = ("Offset", "Drifting", "Ramping")
"""Kinds whose size is the present offset of the sensor."""

UNITS = {"noise": "x noise", "distance": "x noise from the belief", "effect": "of the effect"}
"""Units of sizes that are not in the unit of the sensor or the control."""


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
            score = sensor.alarm.astype(float) if sensor.probability is None else sensor.probability
            if sensor.missing is not None:
                # A missing sample blames no sensor. The alarm of a dropout begins in its fault, and may outlast it.
                score = np.where(sensor.missing & ~sensor.pauses & ~sensor.faulty, np.nan, score)
            scores.append(score)
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


def _of(
    device: SensorSignals | ActuatorSignals, where: str, time: Floats, threshold: float, hold: float | None
) -> Iterator[Finding]:
    """Give the alarms of a sensor or an actuator, in parts."""
    score = score_of(device)
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
    "Finding",
    "findings",
    "findings_frame",
    "never_began",
    "numbers_of",
    "onset_of_alarm",
    "onset_of_kind",
    "plain_findings",
    "size_at_end",
]
