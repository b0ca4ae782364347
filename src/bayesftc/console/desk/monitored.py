"""A live monitor for the page: the roles of its signals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesftc.console.desk.inference import Inference
from bayesftc.console.desk.live import LiveLane
from bayesftc.cosim.diagram.roles import ControlRole, LoopRoles, QuantityRole, SensorRole

if TYPE_CHECKING:
    from bayesftc.monitoring import Monitor, MonitorStepper

BLOCK = "monitor"


def monitor_lane(monitor: Monitor, stepper: MonitorStepper) -> LiveLane:
    """Return the rows of a live monitor, whose stepper is prepared. Its outputs have names such as ``monitor.x_hat``."""
    precision = stepper.estimator.precision
    inputs = monitor.inputs.items() if precision.actuator_modes else ()
    roles = LoopRoles(
        BLOCK,
        tuple(SensorRole((name, 0), sensor.unit or None, ()) for name, sensor in monitor.sensors.items()),
        _quantities(monitor),
        (),
        tuple(ControlRole(name, given.unit or None, None, None, ()) for name, given in inputs),
        tuple(precision.fault_kinds),
        tuple(type(mode).__name__ for mode in precision.actuator_modes),
    )
    return LiveLane(Inference.of(stepper.estimator), stepper, roles, tuple(monitor.sensors), f"{BLOCK}.")


def _quantities(monitor: Monitor) -> tuple[QuantityRole, ...]:
    """Return what the sensors measure: those that read the same of the plant's states, in one unit, measure one quantity."""
    model = monitor.model
    groups: dict[tuple[tuple[float, ...], str], list[int]] = {}
    for i, (row, sensor) in enumerate(zip(model.quantities, monitor.sensors.values(), strict=True)):
        groups.setdefault((tuple(map(float, row)), sensor.unit or ""), []).append(i)
    names = list(monitor.sensors)
    return tuple(
        QuantityRole(
            "measured quantity" if len(groups) == 1 else ", ".join(names[i] for i in members),
            unit or None,
            tuple(members),
            None,
            None,
            row,
            None,
        )
        for (row, unit), members in groups.items()
    )


__all__ = ["monitor_lane"]
