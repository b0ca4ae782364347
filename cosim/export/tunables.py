"""The tunable settings of a block: those whose values are, unchanged, among the parameters of its step functions.

They are not declared but found by comparison: a block is created again with another value of a setting. The setting is tunable if
only numbers among the parameters have changed, and exactly to the setting's new value. Then changing these numbers has the same
effect as that setting. A setting from which something else is computed (a matrix, a step function, an initial state) is not
tunable.

Nested settings are included, as ``precision.forgetting``. A model is not, because the block was designed for it. Zeros of a
matrix are its structure and not tunable; neither are infinite limits, which FMI cannot write.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import Field, dataclass, fields, is_dataclass, replace
from fractions import Fraction
from inspect import getdoc
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats

Element = tuple[str, int]
"""A number of a parameter: the parameter's name, and the index of the element, row by row."""

_DESIGN = frozenset({"model", "system"})
"""Settings for which a block was designed."""

_TRIED = ((0.8, 0.2), (1.25, 0.7), (0.96, 0.04), (1.04, -0.2), (0.5, -0.7), (2.0, 1.0))
"""Other values to try for a number: a factor, and the value instead of zero. Two of them must be allowed."""

_TRIALS = 2

_MOST = 100
"""Most numbers of a tunable setting; larger ones are data, and constant tables in C."""

_TELLING = 15
"""A first sentence with fewer characters is only a unit, such as ``Seconds.``; the next one is added."""


@dataclass(frozen=True)
class Setting:
    """A tunable setting.

    Parameters
    ----------
    name : str
        Its path in the block: ``u_max``, ``precision.forgetting``, ``u_max[1]`` if only that element is tunable.
    shape : tuple of int
        ``()`` for a number.
    start : tuple of float
        Its present numbers.
    places : tuple of tuple of (str, int)
        The places of each number among the parameters.
    description : str
        Its description in the docstring.
    unit : str
        The unit in its field: ``s``, or ``{u}/s``, where ``{u}`` is the unit of the port ``u``; empty for none. In
        ``{*_signal}`` the star stands for the setting that has this one, such as ``start``.
    """

    name: str
    shape: tuple[int, ...]
    start: tuple[float, ...]
    places: tuple[tuple[Element, ...], ...]
    description: str
    unit: str


def settings_of(block: Block, definition: Definition, step: Fraction) -> list[Setting]:
    """Return the tunable settings of a block, in the order of its fields."""
    if not is_dataclass(block):
        return []
    numbers = _Numbers(block, definition)
    used: set[Element] = set()
    settings = []
    for name, value, owner, exchanged in _paths(block, "", lambda new: new):
        places = _places_of(value, exchanged, numbers, step)
        if places is None or any(place in used for each in places.values() for place in each):
            continue
        used |= {place for each in places.values() for place in each}
        holder, _, field = name.rpartition(".")
        unit = _measured(type(owner), field).replace("{*", "{" + holder)
        settings += _split(name, value, places, _described(type(owner), field), unit)
    return settings


class _Numbers:
    """All numbers of a definition, and the parts that must not change."""

    def __init__(self, block: Block, definition: Definition):
        self.kept = (
            definition.output,
            definition.update,
            definition.compiled,
            block.inputs,
            block.outputs,
            {name: _bits(value) for name, value in definition.state.items()},
            {name: np.shape(value) for name, value in {**definition.parameters, **definition.scratch}.items()},
        )
        arrays = {name: np.asarray(value, dtype=np.float64).ravel() for name, value in definition.parameters.items()}
        self.places: list[Element] = [(name, i) for name, array in arrays.items() for i in range(array.size)]
        self.values: Floats = np.concatenate([np.zeros(0), *arrays.values()])


def _bits(value: Any) -> tuple[tuple[int, ...], bytes]:
    array = np.asarray(value, dtype=np.float64)
    return array.shape, array.tobytes()


def _paths(
    holder: Any, path: str, rebuilt: Callable[[Any], Any]
) -> Iterator[tuple[str, Floats, Any, Callable[[Any], Any]]]:
    """Yield all numbers and arrays among the settings: path, value, owner, and a function that replaces the value."""
    for field in fields(holder):
        if not field.init or field.name in _DESIGN or field.name.startswith("_") or _counts(field):
            continue

        def exchanged(new: Any, name: str = field.name) -> Any:
            return rebuilt(replace(holder, **{name: new}))

        value, name = getattr(holder, field.name), path + field.name
        if is_dataclass(value) and not isinstance(value, type):
            yield from _paths(value, f"{name}.", exchanged)
        elif isinstance(value, list | tuple) and value and all(is_dataclass(item) for item in value):
            for i, item in enumerate(value):

                def among(new: Any, i: int = i, all_: Any = value, put: Callable[[Any], Any] = exchanged) -> Any:
                    return put(type(all_)([*all_[:i], new, *all_[i + 1 :]]))

                yield from _paths(item, f"{name}[{i}].", among)
        elif (numbers := _as_numbers(value)) is not None:
            yield name, numbers, holder, exchanged


def _counts(field: Field[Any]) -> bool:
    """Return whether a setting is a whole number: a count or an index."""
    kind = field.type if isinstance(field.type, str) else getattr(field.type, "__name__", "")
    return kind.partition(" ")[0] == "int"


def _as_numbers(value: Any) -> Floats | None:
    """Return the numbers of a setting; None if it has no finite numbers."""
    if isinstance(value, bool | np.bool_ | str | Fraction) or not isinstance(value, Real | list | tuple | np.ndarray):
        return None
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    if array.dtype.kind not in "iuf" or not 0 < array.size <= _MOST or not np.isfinite(array).any():
        return None
    return array.astype(np.float64)


def _places_of(
    value: Floats, exchanged: Callable[[Any], Any], numbers: _Numbers, step: Fraction
) -> dict[int, list[Element]] | None:
    """Return the places of each tunable element of a setting among the parameters; None if it is not tunable."""
    candidates = np.isfinite(value) & ((value != 0.0) if value.ndim > 1 else True)
    if not candidates.any() or not np.isin(value[candidates], numbers.values).all():
        return None
    elements = np.flatnonzero(candidates)
    agreed_places: dict[int, list[int]] | None = None
    allowed = 0
    for factor, at_zero in _TRIED:
        new = _other(value, elements, factor, at_zero)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                block = exchanged(_like(new))
                then = _Numbers(block, block.define(step))
        except Exception:  # noqa: BLE001 - whatever a block raises where a value is not allowed
            continue
        if then.kept != numbers.kept:
            return None
        if len(np.unique(new.ravel()[elements])) < len(elements):
            continue  # two elements have become equal
        located = _where(value, new, elements, numbers, then)
        if located is None or (agreed_places is not None and located != agreed_places):
            return None
        agreed_places, allowed = located, allowed + 1
        if allowed == _TRIALS:
            return {element: [numbers.places[place] for place in indices] for element, indices in located.items()}
    return None


def _other(value: Floats, elements: NDArray[np.intp], factor: float, at_zero: float) -> Floats:
    """Return a setting with other, different values for these elements."""
    new = value.copy()
    spread = 1.0 + np.linspace(0.0, 0.01, len(elements))
    values = new.ravel()[elements]
    new.ravel()[elements] = np.where(values == 0.0, at_zero, factor * values) * spread
    return new


def _where(
    value: Floats, new: Floats, elements: NDArray[np.intp], now: _Numbers, then: _Numbers
) -> dict[int, list[int]] | None:
    """Return the numbers that changed with each element; None if others changed, or an element changed no number."""
    element_of = dict(zip(new.ravel()[elements].tolist(), elements.tolist(), strict=True))
    result: dict[int, list[int]] = {element: [] for element in elements.tolist()}
    for place in np.flatnonzero(then.values.view(np.int64) != now.values.view(np.int64)).tolist():
        # A number that changed from an element's old value to its new value belongs to this element.
        element = element_of.get(float(then.values[place]))
        if element is None or value.ravel()[element] != now.values[place]:
            return None
        result[element].append(place)
    return result if all(result.values()) else None


def _like(value: Floats) -> Any:
    """Return an array in the form of settings: a number, or tuples of numbers."""
    return float(value) if value.ndim == 0 else _tuples(value.tolist())


def _tuples(rows: Any) -> Any:
    return tuple(map(_tuples, rows)) if isinstance(rows, list) else rows


def _split(
    name: str, value: Floats, places: dict[int, list[Element]], description: str, unit: str
) -> Iterator[Setting]:
    """Yield a setting as a whole, or its tunable elements one by one if not all are tunable."""
    if len(places) == value.size:
        start = tuple(value.ravel().tolist())
        yield Setting(name, value.shape, start, tuple(tuple(places[i]) for i in range(value.size)), description, unit)
        return
    names = labels(name, value.shape)
    for element, where in places.items():
        yield Setting(names[element], (), (float(value.ravel()[element]),), (tuple(where),), description, unit)


def _measured(kind: type, name: str) -> str:
    """Return the unit of a setting from the metadata of its field."""
    return next(str(field.metadata.get("unit", "")) for field in fields(kind) if field.name == name)


def _described(kind: type, name: str) -> str:
    """Return the first sentence about a setting in the NumPy-style docstring of the class or of a base class."""
    for each in kind.__mro__:
        description = _entry(getdoc(each) or "", name) if "__doc__" in vars(each) else ""
        if description and not description.startswith("See "):
            return description
    return f"{name} of {kind.__name__}"


def _entry(text: str, name: str) -> str:
    section = re.search(r"^Parameters\n-+\n(.*?)(?:^\w[^\n]*\n-+\n|\Z)", text, re.DOTALL | re.MULTILINE)
    names = rf"^(?:\w+, )*{re.escape(name)}(?:, \w+)*(?: :[^\n]*)?\n"
    entry = re.search(rf"{names}((?:    [^\n]*\n?)+)", section[1] if section else "", re.MULTILINE)
    if entry is None:
        return ""
    result = ""
    for sentence in re.split(r"(?<=[^.\d][.;:]) ", " ".join(entry[1].split()).replace("`", "")):
        result = f"{result} {sentence}".strip()
        if len(result) >= _TELLING:
            break
    return result.rstrip(".;:")
