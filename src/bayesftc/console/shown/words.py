"""What the controller infers about each sensor and actuator, and what it does about it, in plain words."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from bayesftc.console.shown.layout import AnyLane
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
OFFSETS = ("Offset", "Drifting", "Ramping")


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
    if chance is None and (detected := value("detected")) is not None:
        chance = detected
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
    if chance is None and f"{name}.fault_probability[{i}]" in lane.place:
        return {**card, "state": "unknown", "words": "nothing is inferred yet: not enough samples"}
    if chance is None:
        return {**card, "state": "unknown", "words": f"using {device} as always: this controller infers no faults"}
    if chance < SUSPECT:
        share = "" if card["weight"] is None else f", weight {100 * card['weight']:.0f} %"
        return {**card, "state": "healthy", "words": f"using {device}{share}"}
    if chance < ALARM:
        return {**card, "state": "suspect", "words": f"watching {device}: probability {_chance(chance)}"}
    unit = f" {role.unit}" if role.unit else ""
    when = "" if since is None else f" since {since:.4g} s"
    card |= {"state": "faulty", "kind": PAST.get(kind, kind), "since": since}
    if kind in OFFSETS and size is not None:
        card["size"] = f"{size:+.3g}{unit}"
        words = f"correcting {device} by {-size:+.3g}{unit}{when}"
    elif kind == "Noisier":
        card["size"] = None if size is None else f"{size:.3g} times the noise"
        words = f"trusting {device} less{when}"
    else:
        words = f"ignoring {device}{when}"
    what = f"{card['kind']}, " if card["kind"] else ""
    return {**card, "words": f"{words}: {what}probability {_chance(chance)}"}


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
    return {**card, "words": f"compensating {device}{when}: {what}probability {_chance(chance)}"}


def _value(lane: AnyLane, row: Floats, label: str) -> float | None:
    place = lane.place.get(label)
    if place is None:
        return None
    value = float(row[place])
    return value if isfinite(value) else None


def _weight(lane: AnyLane, row: Floats, i: int) -> float | None:
    """Return the share of a sensor in the precision of all sensors of its quantity."""
    name = f"{lane.roles.controller}.precision"
    group = next((q.sensors for q in lane.roles.quantities if i in q.sensors), (i,))
    if len(group) < 2:
        return None
    values = [_value(lane, row, f"{name}[{j}]") for j in group]
    if any(v is None for v in values):
        return None
    total = float(np.sum(values))  # type: ignore[arg-type]
    return values[group.index(i)] / total if total > 0 else None  # type: ignore[operator]


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
