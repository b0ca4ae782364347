"""What the page shows of a desk: the strips of signals, the devices that can fail, and the forms of faults, as plain data."""

from __future__ import annotations

from dataclasses import MISSING, fields
from inspect import getdoc
from math import isfinite
from typing import Any

import numpy as np

from bayesftc.console.desk.actions import SENSORS, free_inputs, goals_of, time_of, words_of
from bayesftc.console.desk.desk import Desk
from bayesftc.console.desk.lane import Lane
from bayesftc.console.desk.live import LiveLane
from bayesftc.cosim.blocks.faults.base import COMMON
from bayesftc.cosim.blocks.faults.kinds import FAULTS, Dropout, Fault, RandomFaults
from bayesftc.cosim.diagram.roles import Place
from bayesftc.cosim.ports import labels

AnyLane = Lane | LiveLane

MADE = tuple(fault for fault in FAULTS if fault is not RandomFaults)
"""The kinds of faults with a form. A mixture has no form of its own: its kinds have."""


def label_of(lane: AnyLane, place: Place | None) -> str | None:
    """Return the name of the column of a signal's element; None if it is not recorded."""
    if place is None or place[0] not in lane.shapes:
        return None
    return labels(place[0], lane.shapes[place[0]])[place[1]]


def layout(desk: Desk) -> dict[str, Any]:
    """Return the properties of a desk that change only by a command."""
    branch, step = desk.branch, desk.step
    lane = branch.lanes[0]
    return {
        "type": "layout",
        "epoch": desk.epoch,
        "scenario": desk.name,
        "step": float(step),
        "lanes": [{"name": each.name, "columns": each.columns, "branch": branch.name} for each in branch.lanes]
        + ([_compared(desk)] if desk.compared else []),
        "units": units_of(lane),
        "strips": strips(lane),
        "devices": devices(lane),
        "goals": _goals(lane),
        "inputs": [
            {"name": n, "value": v[0], "parameter": v[1]} for n, v in sorted(free_inputs(desk.scenario).items())
        ],
        "kinds": [_form(fault) for fault in MADE],
        "branches": [
            {
                "name": b.name,
                "parent": b.parent,
                "since": time_of(b.since, step),
                "furthest": time_of(b.furthest, step),
                "actions": len(b.actions),
                "active": b is branch,
                "compared": b is desk.compared,
            }
            for b in desk.branches.values()
        ],
        "furthest": branch.furthest,
        "faults": [
            {
                "target": target,
                "name": name,
                "kind": str(table.get("kind")),
                "sensor": table.get("sensor", 0),
                "words": _window(table),
                "stop": _stop(table),
            }
            for target, name, table in desk.faults()
        ],
        "actions": [
            {"t": time_of(a.k, step), "words": words_of(a), "later": a not in desk.actions} for a in branch.actions
        ],
    }


def _compared(desk: Desk) -> dict[str, Any]:
    assert desk.compared is not None
    lane = desk.compared.lanes[0]
    return {"name": lane.name, "columns": lane.columns, "branch": desk.compared.name}


def units_of(lane: AnyLane) -> dict[str, str]:
    """Return the unit of each column that has one."""
    return {label: unit for name, unit in lane.units.items() for label in labels(name, lane.shapes.get(name, ()))}


def strips(lane: AnyLane) -> list[dict[str, Any]]:
    """Return the strips of a loop: each quantity, the fault probabilities, and each control."""
    roles = lane.roles
    found: list[dict[str, Any]] = []
    for quantity in roles.quantities:
        truth = (
            quantity.truth[0][1] if quantity.truth and len(quantity.truth) == 1 and quantity.truth[0][0] == 1 else None
        )
        series = [_series(lane, quantity.reference, "reference", "reference")]
        series += [
            _series(lane, roles.sensors[i].samples, lane.sensors[i], "sensor", device=f"sensor:{i}", number=i)
            for i in quantity.sensors
        ]
        series.append(_series(lane, truth, "true value", "truth"))
        if quantity.belief is not None:
            weights = [(j, w) for j, w in enumerate(quantity.belief) if w]
            place = (f"{roles.controller}.x_hat", weights[0][0]) if len(weights) == 1 else None
            series.append({**s, "scale": weights[0][1]} if (s := _series(lane, place, "belief", "belief")) else None)
        kept = [each for each in series if each]
        if kept:
            found.append({"title": quantity.name, "unit": quantity.unit or "", "series": kept})
    name = roles.controller
    chances = [
        _series(lane, (f"{name}.fault_probability", i), lane.sensors[i], "sensor", device=f"sensor:{i}", number=i)
        for i in range(len(roles.sensors))
    ]
    chances += [
        _series(lane, (f"{name}.actuator_fault_probability", j), f"actuator {role.name}", "actuator", number=j)
        for j, role in enumerate(roles.controls)
    ]
    if any(chances):
        found.append(
            {"title": "fault probability", "unit": "", "range": [0, 1], "series": [each for each in chances if each]}
        )
    for j, control in enumerate(roles.controls):
        received = next((label_of(lane, i.received) for i in roles.inputs if i.control == j), None)
        series = [_series(lane, (f"{name}.u", j), "control", "control")]
        if received:
            series.append({"label": "after faults", "look": "received", "column": received})
        if kept := [each for each in series if each]:
            found.append({"title": control.name, "unit": control.unit or "", "series": kept})
    return found


def _series(lane: AnyLane, place: Place | None, label: str, look: str, **more: Any) -> dict[str, Any] | None:
    if place is not None and place[1] >= int(np.prod(lane.shapes.get(place[0], ()))):
        return None
    column = label_of(lane, place)
    return None if column is None else {"label": label, "look": look, "column": column, **more}


def devices(lane: Lane) -> list[dict[str, Any]]:
    """Return the sensors and actuators, each with its place in a scenario file and the size of its usual faults."""
    roles, found = lane.roles, []
    deviations = np.broadcast_to(getattr(lane.scenario.sensors, "std", 0.0) or 0.0, (len(roles.sensors),))
    for i, sensor in enumerate(roles.sensors):
        quantity = next((q.name for q in roles.quantities if i in q.sensors), "")
        scale = 5.0 * float(deviations[i]) or 1.0
        found.append(
            {
                "id": f"sensor:{i}",
                "name": lane.sensors[i],
                "of": quantity,
                "unit": sensor.unit or "",
                "target": SENSORS,
                "channel": i,
                "scale": scale,
                "column": label_of(lane, sensor.samples),
                "kinds": [k.__name__ for k in MADE],
            }
        )
    control = lane.scenario.wiring.control
    sizes = {port.name: port.size for port in lane.scenario.plant.inputs}
    number = 0
    for name in [control] if isinstance(control, str) else control:
        for channel in range(sizes.get(name, 1)):
            if number == len(roles.controls):
                break
            role = roles.controls[number]
            limits = [abs(v) for v in (role.low, role.high) if v is not None and isfinite(v)]
            found.append(
                {
                    "id": f"actuator:{number}",
                    "name": f"actuator {role.name}",
                    "of": "",
                    "unit": role.unit or "",
                    "target": name,
                    "channel": channel,
                    "scale": max(limits, default=0.0) or None,
                    "column": label_of(lane, (f"{roles.controller}.u", number)),
                    "kinds": [k.__name__ for k in MADE if k is not Dropout],
                }
            )
            number += 1
    return found


def _goals(lane: Lane) -> list[dict[str, Any]]:
    names = {q.goal: (q.name, q.unit, label_of(lane, q.reference)) for q in lane.roles.quantities if q.goal is not None}
    return [
        {"name": names[i][0], "unit": names[i][1] or "", "column": names[i][2], "target": str(i)}
        if i in names
        else {"name": f"goal {i}", "unit": "", "column": None, "target": str(i)}
        for i in range(goals_of(lane.scenario))
    ]


def _form(fault: type[Fault]) -> dict[str, Any]:
    """Return the settings of a kind of fault, for its form."""
    settings = []
    for each in fields(fault):
        if each.name not in COMMON:
            default = None if each.default is MISSING else each.default
            kind = "flag" if isinstance(default, bool) else "number"
            finite = default if isinstance(default, bool | int | float) and isfinite(default) else None
            unit = str(each.metadata.get("unit", ""))
            settings.append(
                {"name": each.name, "unit": unit, "default": finite, "type": kind, "required": each.default is MISSING}
            )
    return {"kind": fault.__name__, "words": (getdoc(fault) or "").split("\n")[0], "settings": settings}


def _window(table: dict[str, Any]) -> str:
    """Return the period of a fault in words."""
    start, stop, duration = table.get("start", 0.0), table.get("stop"), table.get("duration")
    if isinstance(start, dict):
        words = f"when {start.get('signal')} {start.get('relation')} {start.get('value'):g}"
    else:
        words = f"when {start}" if isinstance(start, str) else f"from {start:g} s"
    if isinstance(stop, int | float) and isfinite(stop):
        words += f" to {stop:g} s"
    elif isinstance(stop, str):
        words += f" until {stop}"
    if isinstance(duration, int | float) and isfinite(duration):
        words += f", for {duration:g} s"
    return words


def _stop(table: dict[str, Any]) -> float | None:
    """Return the time at which a fault ends for good; None if that is not known ahead."""
    start, stop, duration = table.get("start", 0.0), table.get("stop"), table.get("duration")
    ends = [float(stop)] if isinstance(stop, int | float) else []
    if isinstance(start, int | float) and isinstance(duration, int | float):
        ends.append(start + duration)
    return min((end for end in ends if isfinite(end)), default=None)


__all__ = ["MADE", "AnyLane", "devices", "label_of", "layout", "strips", "units_of"]
