"""Inputs and outputs of a plant by name; the name of a vector stands for all its elements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import as_number, as_vector
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.ports import without_brackets
from bayesftc.cosim.types import Floats

Names = str | Sequence[str]


def check_by_name(**given: object) -> None:
    """Refuse values of inputs that are not given by name."""
    for name, value in given.items():
        if not isinstance(value, Mapping | None):
            what, example = ("two numbers", "(0.02, 5.0)") if name == "loads" else ("a number", "0.02")
            raise ModelError(
                f"{name} is {value!r}; give {what} for each input by name, as {name}={{'load': {example}}}."
            )


def names_of(given: Names, kind: str) -> list[str]:
    """Return names as a list.

    Raises
    ------
    ModelError
        If there is no name, or one occurs twice.
    """
    names = [given] if isinstance(given, str) else list(given) if isinstance(given, Iterable) else []
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise ModelError(f"{kind}={given!r}; {_remedy(names, kind)}")
    return names


def _remedy(names: Sequence[Any], kind: str) -> str:
    """Return what to give instead of wrong names; an output that is measured several times has several sensors."""
    if kind == "measured" and names and all(isinstance(name, str) for name in names):
        once = list(dict.fromkeys(names))
        counts = [names.count(name) for name in once]
        return (
            f"name the outputs each once, and give the number of sensors of each: measured={once}, sensors={counts} (in a "
            f"scenario: count = {counts} in [sensors])."
        )
    return "give the name of at least one variable of the plant, each once."


def elements_of(name: str, available: Sequence[str]) -> list[str]:
    """Return the elements of a name: itself, or those of a vector (``y[0]``, ``y[1]``, ...); none if unknown.

    A default label of python-control, ``y[1]``, also stands for the port ``y1`` of a system without labels.
    """
    if name not in available and (plain := without_brackets(name, available)):
        return [plain]
    return [name] if name in available else [element for element in available if element.startswith(f"{name}[")]


def places_of(names: Sequence[str], available: Sequence[str], kind: str) -> list[int]:
    """Return the indices of the elements of names.

    Raises
    ------
    UnknownNameError
        If a name is unknown.
    ModelError
        If an element is named twice.
    """
    places: list[int] = []
    for name in names:
        indices = [list(available).index(element) for element in elements_of(name, available)]
        if not indices:
            raise UnknownNameError(f"The plant has no {kind} {name!r}; {did_you_mean(name, available)}")
        if set(indices) & set(places):
            raise ModelError(f"{kind}s {', '.join(names)}: {name!r} repeats an element; name each once.")
        places += indices
    return places


def spread(title: str, given: Mapping[str, Any], available: Sequence[str]) -> dict[int, float]:
    """Return values given by name by index; a vector has one number, or one for each element."""
    values_by_index: dict[int, float] = {}
    for name, value in given.items():
        places = places_of([name], available, "input")
        values = as_vector(f"{title} of {name}", value, len(places)) if len(places) > 1 else [value]
        values_by_index.update(zip(places, values, strict=True))  # type: ignore[arg-type]
    return values_by_index


def operating(inputs: Sequence[str], start: Floats, at: Mapping[str, float | Sequence[float]]) -> Floats:
    """Return the inputs at the operating point: the given values, else the start values."""
    u = np.array(start, dtype=np.float64)
    for place, value in spread("The operating point", at, inputs).items():
        u[place] = as_number(f"The operating point has {inputs[place]}", value)
    return u


def chosen(names: Sequence[str], available: Sequence[str], kind: str) -> tuple[list[int], tuple[str, ...]]:
    """Return indices and names of the elements of names, each once even if several names contain it."""
    places = list(dict.fromkeys(place for name in names for place in places_of([name], available, kind)))
    return places, tuple(available[place] for place in places)


def measured_by(sensors: int | Sequence[int] | None, outputs: int) -> list[int]:
    """Return the number of the output that each sensor measures: in turn, or so many sensors of each output."""
    if isinstance(sensors, Mapping):
        raise ModelError(
            f"sensors is {brief(sensors)}; give the numbers without names, in the order of the measured outputs: "
            f"sensors={tuple(sensors.values())}."
        )
    if sensors is None or np.ndim(sensors) == 0:
        count = outputs if sensors is None else int(as_number("The model has sensors", sensors, least=1, whole=True))
        if count % outputs:
            raise ModelError(
                f"{count} sensors are no multiple of {outputs} measured outputs. Give a number for each, "
                f"such as sensors={(*[1] * (outputs - 1), 3)} for one sensor of each but three of the last. A single number must "
                f"be a multiple of {outputs}: the sensors then measure the outputs in turn."
            )
        return [i % outputs for i in range(count)]
    counts = [int(as_number("The model has sensors", each, least=1, whole=True)) for each in sensors]  # type: ignore[union-attr]
    if len(counts) != outputs:
        raise ModelError(f"sensors has {len(counts)} numbers for {outputs} measured outputs; give one for each.")
    return [i for i, count in enumerate(counts) for _ in range(count)]


def sensors_of(
    rows: Sequence[int], sensors: int | Sequence[int] | None, sensor_std: float | Sequence[float]
) -> tuple[list[int], Floats]:
    """Return the output that each sensor measures, and the variance of its noise; see `LinearModel.from_fmu`."""
    measured = measured_by(sensors, len(rows))
    of_outputs = np.shape(sensor_std) == (len(rows),)
    if np.ndim(sensor_std) == 1 and np.shape(sensor_std)[0] not in (len(rows), len(measured)):
        raise ModelError(
            f"sensor_std has {len(sensor_std)} numbers for {len(measured)} sensors of {counted(len(rows), 'output')}; give one "  # type: ignore[arg-type]
            "number, one for each output, or one for each sensor."
        )
    std = as_vector("sensor_std", sensor_std, len(rows) if of_outputs else len(measured))
    if (std < 0).any():
        raise ModelError(f"sensor_std is {std.tolist()}; standard deviations must not be negative.")
    if (std == 0).any():
        raise ModelError(
            f"sensor_std is {std.tolist()}; a sensor without noise cannot be weighed against others. For a coarse sensor, give "
            "about a third of its resolution."
        )
    return [rows[i] for i in measured], (std[measured] if of_outputs else std) ** 2
