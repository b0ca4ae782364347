"""The description of a campaign in its store, by which a resumption is distinguished from another campaign."""

from __future__ import annotations

import re
from typing import Any

from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.runs.metrics import Metric, OfResult
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.roles import known_roles


def described(job: Job) -> dict[str, Any]:
    """Return the duration, the blocks of the first point with their settings, and the metrics.

    The time limit is left out, because a resumption may change it.
    """
    diagram = job.diagram(0)
    return {
        "duration": f"{job.steps * job.step} s",
        "step": f"{job.step} s",
        "decimation": job.decimation,
        "blocks": {node.name: _text_of(node.block) for node in diagram.nodes},
        "metrics": [_settings(metric) for metric in job.metrics],
        "roles": _roles(diagram),
    }


def _settings(metric: Metric) -> dict[str, Any]:
    """Return the kind and the settings of a metric, as in a campaign file; of functions their names, without units."""
    shown = {"unit"} if isinstance(metric, OfResult) else set()
    settings = {name: _setting(value) for name, value in vars(metric).items() if name not in shown}
    return {"kind": type(metric).__name__, **settings}


def _setting(value: Any) -> Any:
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', _text_of(value))}"
    return value if isinstance(value, bool | int | float | str | None) else _text_of(value)


def _roles(diagram: Diagram) -> dict[str, Any]:
    """Return the name of a closed loop's controller, and the faults of each sensor; empty for other diagrams."""
    roles = known_roles(diagram)
    if roles is None:
        return {}
    return {"controller": roles.controller, "faults_of_sensors": [list(sensor.faults) for sensor in roles.sensors]}


def _text_of(value: Any) -> str:
    """Return the text of a value, without its address in the memory of this process."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value))


__all__ = ["described"]
