"""Start values and parameters of an FMU, of every type and shape, with units: checked before the binary is loaded."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

import numpy as np

from bayesftc.cosim.base.numbers import with_article
from bayesftc.cosim.base.units import conversion, split
from bayesftc.cosim.errors import FMUError, ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.fmi.binaries.groups import type_range
from bayesftc.cosim.fmi.reading.archive import Archive
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable, Value, flattened, shaped
from bayesftc.cosim.fmi.reading.structure import check_size
from bayesftc.cosim.ports import labels

_FLOATS = frozenset({"Real", "Float64", "Float32"})
_LARGEST = sys.float_info.max


def start_values(
    archive: Archive,
    description: FMUDescription,
    values: Mapping[str, Any],
    units: Mapping[str, str],
    *,
    validate: bool = True,
) -> dict[str, Value]:
    """Check names, causality, types, shapes and units of start values and, with `validate`, the declared bounds.

    `units` are those of variables that have none in the description.

    Returns
    -------
    dict
        Plain Python numbers and strings in the variables' units; of arrays, tuples of tuples.
    """
    if not isinstance(values, Mapping):
        raise ModelError(f"FMU has parameters={values!r}; give values by name, as {{'m': 100.0}}.")
    if units:
        known = (replace(v, unit=v.unit or units.get(v.name)) for v in description.variables)
        description = replace(description, variables=tuple(known))
    variables = {v.name: v for v in description.variables}
    values, elements = _apart(values, variables)
    for name in (*values, *elements):
        if name not in variables:
            settable = [v.name for v in variables.values() if v.settable]
            raise UnknownNameError(
                f"The FMU {archive.path.name} has no variable {name!r}; {did_you_mean(name, settable)}"
            )
        variable = variables[name]
        if not variable.settable:
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} cannot be set: it is {with_article(variable.causality)} that "
                f"the FMU computes ({variable.variability}). Set the variables that it depends on."
            )
        if variable.type in {"Binary", "Clock"}:
            raise FMUError(
                f"{name!r} of the FMU {archive.path.name} is {with_article(variable.causality)} of type {variable.type}, which "
                "cannot be set here; leave it at its start value."
            )
    structural = {n: v for n, v in values.items() if variables[n].causality == "structuralParameter"}
    checked = {n: _converted(archive, description, variables[n], v) for n, v in structural.items()}
    resized = resolved(archive, description, checked)  # structural parameters set the sizes of arrays
    result = {
        name: checked[name] if name in checked else _converted(archive, description, resized[name], value)
        for name, value in values.items()
    }
    for name, given in elements.items():
        result[name] = _with_elements(archive, description, resized[name], result, given)
    for name, value in result.items() if validate else ():
        _check_bounds(archive, variables[name], value)
    return result


def _apart(
    values: Mapping[str, Any], variables: Mapping[str, FMUVariable]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the values of whole variables, and those of elements of arrays (``R[0]``, ``R[0,1]``), by array and element."""
    whole, elements = dict(values), dict[str, dict[str, Any]]()
    for name in values:
        array = name.partition("[")[0]
        if name not in variables and name.endswith("]") and array in variables and variables[array].dimensions:
            elements.setdefault(array, {})[name] = whole.pop(name)
    return whole, elements


def _with_elements(
    archive: Archive,
    description: FMUDescription,
    variable: FMUVariable,
    values: Mapping[str, Value],
    given: Mapping[str, Any],
) -> Value:
    """Return an array with some elements replaced; the others have their given or start values."""
    names = labels(variable.name, variable.shape)
    others = values.get(variable.name, variable.start)
    if not isinstance(others, tuple):
        raise FMUError(
            f"The FMU {archive.path.name} is given {next(iter(given))!r}, but the other elements of {variable.name!r} are not "
            f"known. Give the whole array {variable.name!r}, row by row."
        )
    flat = list(flattened(others))
    for name, value in given.items():
        if name not in names:
            raise UnknownNameError(
                f"The FMU {archive.path.name} has no variable {name!r}: {variable.name!r} is an array of shape "
                f"{variable.shape}; {did_you_mean(name, names)}"
            )
        flat[names.index(name)] = _converted(archive, description, replace(variable, name=name, shape=()), value)
    return shaped(tuple(flat), variable.shape)


def _check_bounds(archive: Archive, variable: FMUVariable, value: Value) -> None:
    low, high = variable.bounds
    for x in flattened(value):
        if not isinstance(x, str) and not low <= x <= high:
            allowed = f"from {low:g} up" if high == math.inf else f"up to {high:g}" if low == -math.inf else ""
            raise FMUError(
                f"{variable.name!r} of the FMU {archive.path.name} is set to {x!r}, but its declaration allows only values "
                f"{allowed or f'from {low:g} to {high:g}'}{f' {variable.unit}' if variable.unit else ''}. Give such a value, or "
                "try it all the same with validate=False."
            )


def resolved(archive: Archive, description: FMUDescription, values: Mapping[str, Value]) -> dict[str, FMUVariable]:
    """Return the variables by name, with the array sizes that structural parameters set.

    Parameters
    ----------
    archive : Archive
        The FMU.
    description : FMUDescription
        Its model description.
    values : mapping of str to value
        Start values that replace those of the description, including structural parameters.

    Raises
    ------
    FMUError
        If an array would be too large.
    """
    if not any(v.dimensions for v in description.variables):
        return {v.name: v for v in description.variables}
    structure = {v.name: v.start for v in description.variables} | dict(values)
    shapes = {v.name: tuple(_size(archive, v, d, structure) for d in v.dimensions) for v in description.variables}
    check_size(archive, [*shapes.items()])
    variables: dict[str, FMUVariable] = {}
    for variable in description.variables:
        shape: tuple[int, ...] = shapes[variable.name]
        count: int = math.prod(shape)
        if shape != variable.shape:
            elements = set(flattened(variable.start)) if variable.start is not None else set()
            start = shaped((*elements,), shape) if len(elements) == 1 and count else None
            variable = replace(variable, shape=shape, start=start)
        variables[variable.name] = variable
    return variables


def _size(archive: Archive, variable: FMUVariable, dimension: int | str, structure: Mapping[str, Any]) -> int:
    size = dimension if isinstance(dimension, int) else structure.get(dimension)
    if not isinstance(size, int) or isinstance(size, bool) or size < 0:
        text = f"{dimension!r}, which is {size}" if isinstance(dimension, str) else str(size)
        raise FMUError(
            f"The array {variable.name!r} of the FMU {archive.path.name} has an invalid size: {text}; export the FMU "
            "again."
        )
    return size


def value_of(variable: FMUVariable, values: Mapping[str, Value]) -> Value:
    """Return the value of a variable before initialization: the given value, else its start value, else zero."""
    value = values.get(variable.name, variable.start)
    if value is None or (variable.shape and not isinstance(value, tuple)):
        zero: Value = 0.0 if variable.type in _FLOATS else variable.type != "Boolean" and 0
        if variable.items:
            zero = variable.items[0][1]
        return shaped((zero,), variable.shape) if variable.shape else zero
    return value


def as_floats(value: Value) -> float | tuple[Any, ...]:
    """Return a value as floats, for float64 ports."""
    return tuple(as_floats(row) for row in value) if isinstance(value, tuple) else float(value)


def _converted(archive: Archive, description: FMUDescription, variable: FMUVariable, value: Any) -> Value:
    number, gain, offset = value, 1.0, 0.0
    if variable.type in _FLOATS:
        pair = split(value) if isinstance(value, str) else _pair(value)
        if pair is not None:
            number, unit = pair
            gain, offset = _conversion(archive, description, variable, f"{number} {unit}", unit)
    if not variable.shape:
        return _element(archive, variable, number, value, gain, offset)
    flat = _flat(number, variable.shape)
    if flat is None:
        raise FMUError(
            f"{variable.name!r} of the FMU {archive.path.name} is an array of shape {variable.shape}, but is given as "
            f"{brief(value)}. Give it row by row."
        )
    return shaped(tuple(_element(archive, variable, x, x, gain, offset) for x in flat), variable.shape)


def _pair(value: Any) -> tuple[Any, str] | None:
    """Return value and unit if they are given as a pair, else None."""
    if (
        isinstance(value, tuple | list)
        and len(value) == 2
        and isinstance(value[1], str)
        and not isinstance(value[0], str)
    ):
        return value[0], value[1]
    return None


def _flat(value: Any, shape: tuple[int, ...]) -> list[Any] | None:
    """Return the elements of nested sequences of exactly this shape, row by row."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not shape:
        return None if isinstance(value, tuple | list) else [value]
    if not isinstance(value, tuple | list) or len(value) != shape[0]:
        return None
    rows = [_flat(row, shape[1:]) for row in value]
    return None if any(row is None for row in rows) else [x for row in rows for x in row or ()]


def _conversion(
    archive: Archive, description: FMUDescription, variable: FMUVariable, given: str, unit: str
) -> tuple[float, float]:
    where = f"{variable.name!r} of the FMU {archive.path.name}"
    if variable.unit is None:
        raise FMUError(f"{where} has no unit, but {given!r} has one; give a plain number.")
    factors = conversion(unit, variable.unit, description.units)
    if isinstance(factors, str):
        raise FMUError(
            f"{where} is in {variable.unit}, and {given!r} cannot be converted to that: {factors}. Give it in a compatible "
            f"unit, or as a plain number in {variable.unit}."
        )
    gain, offset = factors
    return gain, 0.0 if variable.relative else offset


def _element(archive: Archive, variable: FMUVariable, value: Any, shown: Any, gain: float, offset: float) -> Value:
    kind = variable.type
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if kind in _FLOATS:
        if is_number and -_LARGEST <= value <= _LARGEST:
            converted = gain * float(value) + offset if (gain, offset) != (1.0, 0.0) else float(value)
            if math.isfinite(converted):
                return converted
        required = "a finite number"
    elif kind == "Boolean":
        if isinstance(value, bool | np.bool_):
            return bool(value)
        required = "True or False"
    elif kind == "String":
        if isinstance(value, str) and "\0" not in value and not any("\ud800" <= c <= "\udfff" for c in value):
            return value
        required = "a string without NUL characters or surrogates" if isinstance(value, str) else "a string"
    elif variable.items:
        if isinstance(value, str) and value in dict(variable.items):
            return dict(variable.items)[value]
        if is_number and isinstance(value, Integral) and int(value) in dict(variable.items).values():
            return int(value)
        names = [f"{name!r} ({number})" for name, number in variable.items[:12]]
        required = "one of " + ", ".join([*names, "..."] if len(variable.items) > 12 else names)
    else:
        low, high = _range(variable)
        if is_number and isinstance(value, Integral) and low <= int(value) <= high:
            return int(value)
        required = f"a whole number from {low} to {high}"
    raise FMUError(
        f"{variable.name!r} of the FMU {archive.path.name} is of type {kind} and must be {required}, not {brief(shown)}."
    )


def _range(variable: FMUVariable) -> tuple[int, int]:
    low, high = type_range(variable, 2 if variable.type in {"Integer", "Enumeration"} else 3)
    exact = np.iinfo(variable.type.lower()) if "64" in variable.type else None  # beyond the exact range of doubles
    return (int(low), int(high)) if exact is None else (int(exact.min), int(exact.max))
