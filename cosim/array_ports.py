"""Array ports of an FMU whose variables are numbers with the names of elements: ``y[0]`` and ``y[1]``, as FMI 2 needs."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

from bayesftc.cosim.ports import Port, labels

ELEMENT = re.compile(r"(.+)\[(\d+(?:,\d+)*)\]")


def gathered(ports: Sequence[Port]) -> tuple[Port, ...]:
    """Return the ports with arrays in place of consecutive scalars that are all elements of an array, row by row.

    Elements that stand in another order, or of which some are missing, stay scalars: an array has another order in memory.
    """
    arrays = ["" if port.shape else _array(port.name) for port in ports]
    counts = Counter(arrays)
    found: list[Port] = []
    for name, several in groupby(zip(arrays, ports, strict=True), lambda pair: pair[0]):
        run = [port for _, port in several]
        shape = _shape(run[-1]) if name and len(run) == counts[name] else None
        whole = shape is not None and [port.name for port in run] == labels(name, shape)
        found += [_joined(name, shape, run)] if shape is not None and whole else run
    return tuple(found)


def scattered(requested: Sequence[str | Port], variables: Collection[str]) -> list[str | Port]:
    """Return the elements in place of each requested array that is no variable itself."""
    elements: dict[str, list[str]] = {}
    for variable in variables:
        elements.setdefault(_array(variable), []).append(variable)
    expanded: list[str | Port] = []
    for item in requested:
        name = item.name if isinstance(item, Port) else item
        if name in variables or name not in elements:
            expanded.append(item)
        elif isinstance(item, Port):
            expanded += [replace(item, name=element, shape=()) for element in elements[name]]
        else:
            expanded += elements[name]
    return expanded


def _array(variable: str) -> str:
    """Return the name of the array of which a variable is an element, or nothing."""
    match = ELEMENT.fullmatch(variable)
    return match[1] if match else ""


def _shape(last: Port) -> tuple[int, ...]:
    """Return the shape of an array of which the last element is given."""
    match = ELEMENT.fullmatch(last.name)
    return tuple(int(i) + 1 for i in match[2].split(",")) if match else ()


def _joined(name: str, shape: tuple[int, ...], elements: Sequence[Port]) -> Port:
    first = elements[0]
    same = all((port.unit, port.meaning) == (first.unit, first.meaning) for port in elements)
    unit, meaning = (first.unit, first.meaning) if same else (None, None)
    starts: list[Any] = [port.default for port in elements]
    default = None if None in starts else _nested(np.reshape(np.asarray(starts, dtype=np.float64), shape))
    feedthrough = any(port.feedthrough for port in elements)
    return replace(first, name=name, shape=shape, unit=unit, feedthrough=feedthrough, default=default, meaning=meaning)


def _nested(values: Any) -> tuple[Any, ...]:
    return tuple(_nested(value) if np.ndim(value) else float(value) for value in values)
