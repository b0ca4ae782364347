"""What the page shows of a live run."""

from __future__ import annotations

from typing import Any

from bayesftc.console.desk.live import LiveRun
from bayesftc.console.shown.broadcast import View
from bayesftc.console.shown.layout import label_of, strips, units_of
from bayesftc.console.shown.moving import Scene


def view_of_live(run: LiveRun) -> View:
    """Return the view of a live run."""
    lane, plan = run.lane, _layout(run)
    names = [series["column"] for strip in plan["strips"] for series in strip["series"]]
    names += [each["column"] for each in (*plan["devices"], *plan["goals"]) if each["column"]]
    return View(1, (lane,), plan, (Scene(lane),), tuple(dict.fromkeys(names)))


def _layout(run: LiveRun) -> dict[str, Any]:
    lane = run.lane
    return {
        "type": "layout",
        "epoch": 1,
        "only_shown": True,
        "scenario": run.name,
        "step": float(lane.step),
        "lanes": [{"name": lane.name, "columns": lane.columns, "branch": "live"}],
        "units": units_of(lane),
        "strips": strips(lane),
        "devices": _devices(run),
        "goals": _goals(run),
        "inputs": [],
        "kinds": [],
        "branches": [],
        "furthest": 0,
        "faults": [],
        "actions": [],
        "recorded": run.recording is not None,
        "drops": not run.only_shows,
        "has_loop": bool(lane.roles.controls and _goals(run)),
    }


def _devices(run: LiveRun) -> list[dict[str, Any]]:
    lane, roles = run.lane, run.lane.roles
    sensors = [
        {
            "id": f"sensor:{i}",
            "name": lane.sensors[i],
            "of": "",
            "unit": role.unit or "",
            "channel": i,
            "column": label_of(lane, role.samples),
        }
        for i, role in enumerate(roles.sensors)
    ]
    return sensors + [
        {
            "id": f"actuator:{j}",
            "name": f"actuator {role.name}",
            "of": "",
            "unit": role.unit or "",
            "channel": 0,
            "column": label_of(lane, (f"{roles.controller}.u", j)),
        }
        for j, role in enumerate(roles.controls)
    ]


def _goals(run: LiveRun) -> list[dict[str, Any]]:
    return [
        {"name": q.name, "unit": q.unit or "", "column": label_of(run.lane, q.reference), "target": str(q.goal)}
        for q in run.lane.roles.quantities
        if q.goal is not None
    ]


__all__ = ["view_of_live"]
