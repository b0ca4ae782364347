"""What a campaign is, in words that stand in its store: by them a resumption is told from another campaign."""

from __future__ import annotations

import re
from typing import Any

from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.runs.metrics import Metric
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.roles import known_roles


def described(job: Job) -> dict[str, Any]:
    """Return the duration, the blocks of the first point with their settings, and the metrics.

    The time limit is not among it: a campaign may go on with another one.
    """
    diagram = job.diagram(0)
    return {
        "duration": f"{job.steps * job.step} s",
        "step": f"{job.step} s",
        "decimation": job.decimation,
        "blocks": {node.name: _said(node.block) for node in diagram.nodes},
        "metrics": [_settings(metric) for metric in job.metrics],
        "roles": _roles(diagram),
    }


def _settings(metric: Metric) -> dict[str, Any]:
    """Return the kind and the settings of a metric, as a campaign file would say them; of functions their names."""
    return {"kind": type(metric).__name__, **{name: _setting(value) for name, value in vars(metric).items()}}


def _setting(value: Any) -> Any:
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', _said(value))}"
    return value if isinstance(value, bool | int | float | str | None) else _said(value)


def _roles(diagram: Diagram) -> dict[str, Any]:
    """Return which block is the controller of a closed loop, and for each of its sensors the faults on the way; else nothing."""
    found = known_roles(diagram)
    if found is None:
        return {}
    return {"controller": found.controller, "faults_of_sensors": [list(sensor.faults) for sensor in found.sensors]}


def _said(thing: Any) -> str:
    """Return what something is, without where it lies in the memory of this process."""
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(thing))


__all__ = ["described"]
