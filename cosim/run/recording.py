"""Select the signals that a run keeps: from names and patterns to places in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, labels, without_brackets


@dataclass(frozen=True)
class Selection:
    """Places in memory to record, for each signal its first column and shape, and the names of all other signals."""

    places: np.ndarray[Any, np.dtype[np.int64]]
    columns: dict[str, tuple[int, tuple[int, ...]]]
    units: dict[str, str]
    others: frozenset[str] = frozenset()


def _named(name: str, signals: Mapping[str, tuple[Node, Port]]) -> list[str]:
    """Return the signal of a name; of the name of an element, the whole; of a default label of python-control, its signal."""
    whole = name.rpartition("[")[0]
    if name in signals:
        return [name]
    if whole in signals and name in labels(whole, signals[whole][1].shape):
        return [whole]
    block, _, port = name.rpartition(".")
    plain = without_brackets(port, [s.removeprefix(f"{block}.") for s in signals if s.startswith(f"{block}.")])
    return [f"{block}.{plain}"] if plain else []


def select_signals(schedule: Schedule, record: Iterable[str | PortRef] | None) -> Selection:
    """Resolve names and patterns; None means every output.

    Raises
    ------
    UnknownNameError
        If a name or pattern matches no signal.
    ModelError
        If `record` is neither names nor patterns.
    """
    if isinstance(record, str | PortRef):
        record = [record]
    if record is not None and not isinstance(record, Iterable):
        raise ModelError(
            f"record is {record!r}; it must be names of signals or patterns, such as ['plant.*'], or None for all outputs."
        )
    outputs = {f"{node.name}.{port.name}": (node, port) for node in schedule.nodes for port in node.outputs}
    inputs = {f"{node.name}.{port.name}": (node, port) for node in schedule.nodes for port in node.inputs}
    signals = {**inputs, **outputs}
    chosen: list[str] = []
    for pattern in outputs if record is None else record:
        pattern = pattern.name if isinstance(pattern, PortRef) else str(pattern)
        matches = _named(pattern, signals) or [name for name in outputs if fnmatchcase(name, pattern)]
        if not matches:
            raise UnknownNameError(f"There is no signal {pattern!r} to record; {did_you_mean(pattern, signals)}")
        chosen += [name for name in matches if name not in chosen]
    places: list[int] = []
    columns, units = {}, {}
    for name in chosen:
        node, port = signals[name]
        place = schedule.signal(node, port)
        columns[name] = (len(places), port.shape)
        places += range(place.start, place.stop)
        if port.unit:
            units[name] = port.unit
    return Selection(np.array(places, dtype=np.int64), columns, units, frozenset(signals.keys() - columns.keys()))
