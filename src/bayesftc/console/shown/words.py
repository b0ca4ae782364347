"""What the controller infers about each sensor and actuator, and what it does about it, in plain words."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from bayesftc.console.shown.layout import AnyLane
from bayesftc.cosim.base.units import behind
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.cosim.types import Floats

SUSPECT = 0.1
"""The lowest fault probability of a suspicion."""

PAST = {
    "Frozen": "frozen",
    "Offset": "offset",
    "Drifting": "drifting",
    "Ramping": "ramping",
    "DroppedOut": "no samples",
    "Noisier": "noisier",
    "Unmodelled": "of no known kind",
    "Burst": "a burst",
    "InputOffset": "offset",
    "LostEffect": "lost effect",
    "StuckActuator": "stuck",
}
NOISES = ("Noisier", "Burst")
CERTAIN = 0.95
"""The lowest fault probability at which the rest of the belief is too little to mention."""
LEAST_WEIGHT = 0.01
"""The lowest weight at which a sensor is still in use."""


def cards(lane: AnyLane) -> list[dict[str, Any]]:
    """Return for each sensor and actuator the probability of a fault, its kind, size and onset, and a sentence."""
    rows = lane.rows
    row, t = rows.newest, rows.last * float(lane.step)
    if row is None:
        return []
    found = [_sensor(lane, row, i, t) for i in range(len(lane.roles.sensors))]
    return found + [_actuator(lane, row, j, t) for j in range(len(lane.roles.controls))]


def _sensor(lane: AnyLane, row: Floats, i: int, t: float) -> dict[str, Any]:
    name, role = lane.roles.controller, lane.roles.sensors[i]

    def value(output: str) -> float | None:
        return _value(lane, row, f"{name}.{output}[{i}]")

    chance, onset, size = value("fault_probability"), value("fault_onset"), value("fault_size")
    kind = _kind(lane, row, i, "")
    since = onset if onset is not None else _alarm_since(lane, "sensor", i)
    detected = value("detected")
    card: dict[str, Any] = {
        "id": f"sensor:{i}",
        "p": chance,
        "present": _present(lane, row, role.faults),
        "kind": "",
        "size": None,
        "since": None,
        "weight": _weight(lane, row, i),
    }
    device = lane.sensors[i]
    share = _share(card["weight"])
    if chance is None and detected is not None:
        return {**card, **_detected(device, detected, since, card["weight"])}
    if chance is None and not lane.inference.has_probability:
        words = f"using {device}{share}: {lane.inference.learner} gives no fault probability"
        return {**card, "state": "unknown", "words": words}
    if chance is None and f"{name}.fault_probability[{i}]" in lane.place:
        return {**card, "state": "unknown", "words": "nothing is inferred yet: not enough samples"}
    if chance is None:
        return {**card, "state": "unknown", "words": f"using {device} as always: this controller infers no faults"}
    if chance < SUSPECT:
        return {**card, "state": "healthy", "words": f"using {device}{share}"}
    if chance < ALARM:
        return {**card, "state": "suspect", "words": f"watching {device}: probability {_chance(chance)}"}
    unit = behind(role.unit)
    when = "" if since is None else f" since {since:.4g} s"
    card |= {"state": "faulty", "kind": PAST.get(kind, kind), "since": since}
    if kind in lane.inference.offset_kinds and size is not None:
        card["size"] = f"{size:+.3g}{unit}"
        correction = f"correcting {device} by {-size:+.3g}{unit}"
        words = f"{correction if lane.inference.corrects else _ignoring(device, chance, card['weight'])}{when}"
    elif kind in NOISES:
        card["size"] = None if size is None else f"{size:.3g} times the noise"
        words = f"trusting {device} less{when}"
    else:
        words = f"{_ignoring(device, chance, card['weight'])}{when}"
    what = f"{card['kind']}, " if card["kind"] else ""
    return {**card, "words": f"{words}: {what}probability {_chance(chance)}"}


def _detected(device: str, detected: float, since: float | None, weight: float | None) -> dict[str, Any]:
    """Return what the page shows of an explicit detection, which is a decision without a probability."""
    if not detected:
        return {"state": "healthy", "words": f"using {device}{_share(weight)}: nothing is detected"}
    when = "" if since is None else f" since {since:.4g} s"
    words = f"{_ignoring(device, 0.0, weight)}{when}: a fault is detected, without a probability"
    return {"state": "faulty", "since": since, "words": words}


def _actuator(lane: AnyLane, row: Floats, j: int, t: float) -> dict[str, Any]:
    name, role = lane.roles.controller, lane.roles.controls[j]
    chance = _value(lane, row, f"{name}.actuator_fault_probability[{j}]")
    card: dict[str, Any] = {
        "id": f"actuator:{j}",
        "p": chance,
        "present": _present(lane, row, role.faults),
        "kind": "",
        "size": None,
        "since": None,
        "weight": None,
    }
    device = f"actuator {role.name}"
    if chance is None:
        return {**card, "state": "unknown", "words": f"{device}: this controller infers no faults of actuators"}
    if chance < ALARM:
        state = "healthy" if chance < SUSPECT else "suspect"
        words = f"using {device}" if state == "healthy" else f"watching {device}: probability {_chance(chance)}"
        return {**card, "state": state, "words": words}
    kind = _kind(lane, row, j, "actuator_")
    size = _value(lane, row, f"{name}.actuator_fault_size[{j}]")
    since = _alarm_since(lane, "actuator", j)
    when = "" if since is None else f" since {since:.4g} s"
    card |= {"state": "faulty", "kind": PAST.get(kind, kind), "since": since}
    card["size"] = None if size is None else f"{size:.3g}"
    what = f"{card['kind']}, " if card["kind"] else ""
    # No control compensates a stuck actuator, and a monitor compensates nothing: their models take the fault into account.
    compensates = lane.inference.controls and kind != "StuckActuator"
    words = f"{'compensating' if compensates else 'allowing for'} the fault of {device}{when}"
    return {**card, "words": f"{words}: {what}probability {_chance(chance)}"}


def _share(weight: float | None) -> str:
    return "" if weight is None else f", weight {100 * weight:.0f} %"


def _ignoring(device: str, chance: float, weight: float | None) -> str:
    """Return whether a sensor is ignored, or still used with the weight that it has."""
    used = chance < CERTAIN if weight is None else weight >= LEAST_WEIGHT
    share = "" if weight is None else f" (weight {100 * weight:.0f} %)"
    return f"trusting {device} less{share}" if used else f"ignoring {device}"


def _value(lane: AnyLane, row: Floats, label: str) -> float | None:
    place = lane.place.get(label)
    if place is None:
        return None
    value = float(row[place])
    return value if isfinite(value) else None


def _weight(lane: AnyLane, row: Floats, i: int) -> float | None:
    """Return the share of a sensor in the precision of all sensors of its quantity.

    None beside a sensor that is corrected: its samples still inform, which its precision does not show. None for a faulty sensor
    beside another faulty one, too: a large share of little trust is no trust.
    """
    name = f"{lane.roles.controller}.precision"
    group = next((q.sensors for q in lane.roles.quantities if i in q.sensors), (i,))
    others = [j for j in group if j != i]
    if not others or any(_is_corrected(lane, row, j) for j in others):
        return None
    if _is_faulty(lane, row, i) and any(_is_faulty(lane, row, j) for j in others):
        return None
    values = [_value(lane, row, f"{name}[{j}]") for j in group]
    if any(v is None for v in values):
        return None
    total = float(np.sum(values))  # type: ignore[arg-type]
    return values[group.index(i)] / total if total > 0 else None  # type: ignore[operator]


def _is_corrected(lane: AnyLane, row: Floats, i: int) -> bool:
    """Return whether the samples of a sensor are used without its inferred offset."""
    offset = _kind(lane, row, i, "") in lane.inference.offset_kinds
    return lane.inference.corrects and offset and _is_faulty(lane, row, i)


def _is_faulty(lane: AnyLane, row: Floats, i: int) -> bool:
    """Return whether there is an alarm of a sensor."""
    values = [
        _value(lane, row, f"{lane.roles.controller}.{output}[{i}]") for output in ("fault_probability", "detected")
    ]
    return any(value is not None and value >= ALARM for value in values)


def _present(lane: AnyLane, row: Floats, faults: tuple[str, ...]) -> list[str]:
    """Return the names of the faults that are present: the truth, which the controller does not know."""
    return [name for name in faults if (_value(lane, row, f"{name}.active") or 0.0) > 0.5]


def _kind(lane: AnyLane, row: Floats, i: int, of: str) -> str:
    """Return the kind of a fault: a controller has it as an output, a monitor has the probability of each."""
    name, kinds = lane.roles.controller, lane.roles.actuator_kinds if of else lane.roles.fault_kinds
    number = _value(lane, row, f"{name}.{of}fault_kind[{i}]")
    if number is None:
        chances = [_value(lane, row, f"{name}.{of}mode_probability[{i},{m}]") for m in range(1, len(kinds) + 1)]
        known = [chance for chance in chances if chance is not None]
        number = 1 + known.index(max(known)) if known and len(known) == len(kinds) else 0
    return kinds[int(number) - 1] if 1 <= number <= len(kinds) else ""


def _alarm_since(lane: AnyLane, device: str, number: int) -> float | None:
    last = [a for a in lane.alarms if (a.device, a.number) == (device, number)][-1:]
    return last[0].k * float(lane.step) if last and last[0].begins else None


def _chance(p: float) -> str:
    """Return a probability without a leading zero: ``.997``, never rounded to 1."""
    return "above .999" if p >= 0.9995 else f"{p:.3f}"[1:]


__all__ = ["cards"]
