"""Read the signals of a closed loop from a result by their role, for the metrics and the figure of a run."""

from __future__ import annotations

from collections.abc import Iterable
from math import prod

import numpy as np

from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.roles import InputRole, LoopRoles, Place, QuantityRole, SensorRole, find_roles
from bayesftc.cosim.judging.signals import (
    ActuatorSignals,
    ControlSignals,
    Flags,
    InputSignals,
    LoopSignals,
    QuantitySignals,
    SensorSignals,
    any_of,
)
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

DRAWN = (".P", "mode_probability")
"""Ends of the names of signals that only figures need."""

Table = np.ndarray[tuple[int, int], np.dtype[np.bool_]]
"""Flags with a row for each step and a column for each sensor."""


def loop_signals(diagram: Diagram, result: Result, *, drawn: bool = True) -> LoopSignals:
    """Find the signals of a closed loop by the blocks' kinds and connections.

    Parameters
    ----------
    diagram : Diagram
        A diagram with one `Sensors` block and one controller, a block with inputs ``y`` and ``goal`` and the output ``u``: from
        `closed_loop`, or connected by hand in the same way. Or one `StateEstimator` and a law that is no such block.
    result : Result
        A run of it. Signals that were not recorded become None.
    drawn : bool
        Whether to also read signals that only the figure of a run needs. A campaign records all signals that are read.

    Raises
    ------
    ModelError
        If the diagram is not such a loop.
    """
    return signals_of(find_roles(diagram), result, drawn=drawn)


def signals_of(roles: LoopRoles, result: Result, *, drawn: bool = True) -> LoopSignals:
    """Return the signals of a closed loop with the given roles, as `loop_signals` does."""
    reader = _Reader(result, roles.controller)
    active = {name: reader.active(name) for sensor in roles.sensors for name in sensor.faults}
    count = len(roles.sensors)
    precision, beta, probability, detected = (
        reader.columns(name, count) for name in ("precision", "beta", "fault_probability", "detected")
    )
    kind, size, onset = (
        reader.columns(f"fault_{name}", count) if drawn else [None] * count for name in ("kind", "size", "onset")
    )
    chances = reader.tables("mode_probability", count) if drawn else [None] * count
    sensors = tuple(
        SensorSignals(
            i,
            reader.samples(role),
            reader.faulty(role.faults),
            precision[i],
            beta[i],
            probability[i],
            None if (values := detected[i]) is None else values > 0.5,
            kind[i],
            roles.fault_kinds,
            role.unit,
            size[i],
            onset[i],
            roles.fault_sizes,
            roles.corrected_kinds,
            chances[i],
        )
        for i, role in enumerate(roles.sensors)
    )
    faults: dict[str, tuple[int, Flags]] = {}
    for i, role in enumerate(roles.sensors):
        for name in role.faults:
            if (flags := active[name]) is not None:
                faults.setdefault(name, (i, flags))  # a fault of two sensors counts for the first
    return LoopSignals(
        result.time,
        tuple(_quantity(reader, role, drawn) for role in roles.quantities),
        sensors,
        faults,
        tuple(_input(reader, role) for role in roles.inputs),
        _actuators(reader, roles, drawn),
        _controls(reader, roles),
        _process(reader) if drawn else None,
        roles.lag,
        tuple(reader.unrecorded),
    )


def true_faults(roles: LoopRoles, result: Result) -> tuple[Table, Table]:
    """Return whether each sensor had a fault, and whether its sample was missing, both of shape (rows, sensors).

    The active faults and the samples must be recorded. A sensor that the controller does not receive has no missing samples.
    """
    reader = _Reader(result, roles.controller)
    sensors = [
        SensorSignals(i, reader.samples(role), reader.faulty(role.faults), None, None, None)
        for i, role in enumerate(roles.sensors)
    ]
    faulty, missing = np.zeros((2, len(result.time), len(sensors)), dtype=bool)
    for sensor in sensors:
        faulty[:, sensor.index] = sensor.faulty
        missing[:, sensor.index] = sensor.missing if sensor.missing is not None else False
    return faulty, missing


class _Reader:
    """Reads signals of a result; None for signals that were not recorded."""

    def __init__(self, result: Result, controller: str):
        self.result, self.controller = result, controller
        self.names = frozenset(result)
        self.others: frozenset[str] = getattr(result, "unrecorded", frozenset())  # a campaign reads pieces of runs
        self.unrecorded: dict[str, None] = {}
        """Signals of the loop that were looked for and not recorded."""

    def signal(self, name: str) -> Floats | None:
        if name in self.names:
            return self.result[name]
        if name in self.others and not name.endswith(DRAWN):
            self.unrecorded[name] = None
        return None

    def active(self, fault: str) -> Flags | None:
        values = self.signal(f"{fault}.active")
        return None if values is None else values > 0.5  # type: ignore[return-value]

    def faulty(self, faults: Iterable[str]) -> Flags | None:
        """Return when any of these faults was present: never without a fault; None if one was not recorded."""
        none: Flags = np.zeros(len(self.result.time), dtype=bool)
        return any_of([none, *map(self.active, faults)])

    def output(self, name: str) -> Floats | None:
        """Return an output of the controller."""
        return self.signal(f"{self.controller}.{name}")

    def columns(self, name: str, count: int) -> list[Floats | None]:
        """Return the elements of an output of the controller; None for each if their number is not `count`."""
        values = self.output(name)
        elements: list[Floats | None] = [] if values is None else list(_flat(values).T)
        return elements if len(elements) == count else [None] * count

    def tables(self, name: str, count: int) -> list[Floats | None]:
        """Return for each of the `count` devices its rows of an output of the controller; None for each if it has none."""
        values = self.output(name)
        fits = values is not None and values.ndim == 3 and values.shape[1] == count
        return [values[:, i] for i in range(count)] if values is not None and fits else [None] * count

    def at(self, place: Place | None) -> Floats | None:
        values = None if place is None else self.signal(place[0])
        return None if values is None or place is None else _flat(values)[:, place[1]]

    def samples(self, sensor: SensorRole) -> Floats | None:
        """Return the samples of a sensor; NaN also where it sent an invalid value, such as -9999."""
        values = self.at(sensor.samples)
        return (
            values
            if values is None or not sensor.invalid
            else np.where(np.isin(values, sensor.invalid), np.nan, values)
        )


def _flat(values: Floats) -> Floats:
    """Return a signal with one column for each scalar; it may have no rows, after a run that stopped at its first step."""
    return values.reshape(len(values), prod(values.shape[1:]))


def _input(reader: _Reader, role: InputRole) -> InputSignals:
    faults = {name: reader.active(name) for name in role.faults}
    return InputSignals(role.name, role.unit, reader.at(role.sent), reader.at(role.received), faults, role.control)


def _actuators(reader: _Reader, roles: LoopRoles, drawn: bool) -> tuple[ActuatorSignals, ...]:
    """Return the controller's inference about its actuators; empty if there is none, or if not recorded."""
    probability, kind, size = (
        reader.columns(f"actuator_fault_{name}", len(roles.controls)) for name in ("probability", "kind", "size")
    )
    chances = reader.tables("actuator_mode_probability", len(roles.controls)) if drawn else [None] * len(roles.controls)
    return tuple(
        ActuatorSignals(
            role.name,
            role.unit,
            reader.faulty(role.faults),
            values,
            kind[j],
            size[j],
            roles.actuator_kinds,
            roles.actuator_sizes,
            chances[j],
        )
        for j, (role, values) in enumerate(zip(roles.controls, probability, strict=True))
        if values is not None
    )


def _controls(reader: _Reader, roles: LoopRoles) -> tuple[ControlSignals, ...]:
    """Return the controls that were recorded."""
    own: list[Floats | None] = [None] * len(roles.controls)
    if any(role.sent is None for role in roles.controls):  # else it may be an input, as of an estimator
        own = reader.columns("u", len(roles.controls))
    sent = [
        values if role.sent is None else reader.at(role.sent) for role, values in zip(roles.controls, own, strict=True)
    ]
    return tuple(
        ControlSignals(role.name, role.unit, values, role.low, role.high, role.rate, role.dt)
        for role, values in zip(roles.controls, sent, strict=True)
        if values is not None
    )


def _process(reader: _Reader) -> Floats | None:
    """Return the probability of any process mode: all but the first, healthy, and the last, a mode that has just ended."""
    p = reader.output("process_mode_probability")
    return None if p is None or p.ndim != 2 else np.asarray(p[:, 1:-1].sum(axis=1))


def _quantity(reader: _Reader, role: QuantityRole, drawn: bool) -> QuantitySignals:
    used = [(weight, reader.at(place)) for weight, place in role.truth or ()]
    terms = [weight * values for weight, values in used if values is not None]
    truth = np.sum(terms, axis=0) if terms and len(terms) == len(used) else None
    row = None if role.belief is None else np.array(role.belief)
    x_hat, P = reader.output("x_hat"), reader.output("P") if drawn else None
    belief = None if x_hat is None or row is None else x_hat @ row
    spread = None
    if belief is not None and P is not None and row is not None and P.shape[1:] == (len(row), len(row)):
        spread = np.sqrt(np.maximum(row @ P @ row, 0.0))
    return QuantitySignals(
        role.name,
        role.unit,
        role.sensors,
        truth,
        reader.at(role.reference),
        belief,
        role.goal is not None,
        role.belief is not None,
        spread,
        role.goal is not None and role.reference is None,
    )


__all__ = ["loop_signals", "signals_of", "true_faults"]
