"""Which settings of a block may change while it runs: those that its step functions find as they are among the parameters.

Nobody declares them: a block is made anew with another value of a setting, and what it then does is compared. A setting is
tunable if nothing but numbers among the parameters has changed, and these have become the setting's new value, to the bit. Then
a block whose number is changed does what the block with that setting does. One from which something else is computed (a matrix,
a step function, the beginning of a state) is not.

Settings of settings count as well, as ``precision.forgetting``; a model does not, for it is what a block was designed for. The
zeros of a matrix are its structure, and stay; a limit that is infinite stays, too, for FMI cannot write it.
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
"""A number of a parameter: the parameter's name, and which of its elements, row by row."""

_DESIGN = frozenset({"model", "system"})
"""Settings that a block was designed for."""

_TRIED = ((0.8, 0.2), (1.25, 0.7), (0.96, 0.04), (1.04, -0.2), (0.5, -0.7), (2.0, 1.0))
"""Other values of a number, as factor, and as what becomes of zero; two of them must be allowed."""

_WANTED = 2

_MOST = 100
"""A setting of more numbers is data; in C it stays in a table that never changes."""

_TELLING = 15
"""A first sentence with fewer characters is a unit, such as ``Seconds.``; the next one belongs to it."""


@dataclass(frozen=True)
class Setting:
    """A setting that may change.

    Parameters
    ----------
    name : str
        Its path in the block: ``u_max``, ``precision.forgetting``, ``u_max[1]`` if it is the only element that may.
    shape : tuple of int
        ``()`` for a number.
    start : tuple of float
        Its numbers as they are.
    places : tuple of tuple of (str, int)
        Where each of them stands among the parameters.
    description : str
        What the docstring says of it.
    unit : str
        What its field says of it: ``s``, or ``{u}/s`` where ``{u}`` stands for the unit of the port ``u``; empty for nothing.
    """

    name: str
    shape: tuple[int, ...]
    start: tuple[float, ...]
    places: tuple[tuple[Element, ...], ...]
    description: str
    unit: str


def settings_of(block: Block, definition: Definition, step: Fraction) -> list[Setting]:
    """Return the settings of a block that may change, in the order of its fields."""
    if not is_dataclass(block):
        return []
    now = _Numbers(block, definition)
    taken: set[Element] = set()
    found = []
    for name, value, owner, exchanged in _paths(block, "", lambda new: new):
        places = _found(value, exchanged, now, step)
        if places is None or any(place in taken for each in places.values() for place in each):
            continue
        taken |= {place for each in places.values() for place in each}
        field = name.rpartition(".")[2]
        found += _split(name, value, places, _described(type(owner), field), _measured(type(owner), field))
    return found


class _Numbers:
    """All numbers of a definition, and what must not change."""

    def __init__(self, block: Block, definition: Definition):
        self.kept = (
            definition.output, definition.update, definition.compiled, block.inputs, block.outputs,
            {name: _bits(value) for name, value in definition.state.items()},
            {name: np.shape(value) for name, value in {**definition.parameters, **definition.scratch}.items()},
        )  # fmt: skip
        arrays = {name: np.asarray(value, dtype=np.float64).ravel() for name, value in definition.parameters.items()}
        self.places: list[Element] = [(name, i) for name, array in arrays.items() for i in range(array.size)]
        self.values: Floats = np.concatenate([np.zeros(0), *arrays.values()])


def _bits(value: Any) -> tuple[tuple[int, ...], bytes]:
    array = np.asarray(value, dtype=np.float64)
    return array.shape, array.tobytes()


def _paths(
    holder: Any, path: str, rebuilt: Callable[[Any], Any]
) -> Iterator[tuple[str, Floats, Any, Callable[[Any], Any]]]:
    """Yield all numbers and arrays among the settings: path, value, whose they are, and what exchanges them."""
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
    """Return whether a setting is a whole number: how many there are of something, or which of them is meant."""
    kind = field.type if isinstance(field.type, str) else getattr(field.type, "__name__", "")
    return kind.partition(" ")[0] == "int"


def _as_numbers(value: Any) -> Floats | None:
    """Return a setting that consists of numbers, some of them finite."""
    if isinstance(value, bool | np.bool_ | str | Fraction) or not isinstance(value, Real | list | tuple | np.ndarray):
        return None
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    if array.dtype.kind not in "iuf" or not 0 < array.size <= _MOST or not np.isfinite(array).any():
        return None
    return array.astype(np.float64)


def _found(
    value: Floats, exchanged: Callable[[Any], Any], now: _Numbers, step: Fraction
) -> dict[int, list[Element]] | None:
    """Return where each element of a setting that may change stands among the parameters; None where it may not."""
    open_ = np.isfinite(value) & ((value != 0.0) if value.ndim > 1 else True)
    if not open_.any() or not np.isin(value[open_], now.values).all():
        return None
    elements = np.flatnonzero(open_)
    agreed: dict[int, list[int]] | None = None
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
        if then.kept != now.kept:
            return None
        if len(np.unique(new.ravel()[elements])) < len(elements):
            continue  # two elements have become equal
        where = _where(value, new, elements, now, then)
        if where is None or (agreed is not None and where != agreed):
            return None
        agreed, allowed = where, allowed + 1
        if allowed == _WANTED:
            return {element: [now.places[place] for place in places] for element, places in where.items()}
    return None


def _other(value: Floats, elements: NDArray[np.intp], factor: float, at_zero: float) -> Floats:
    """Return a setting of which these elements have other values, each one of its own."""
    new = value.copy()
    apart = 1.0 + np.linspace(0.0, 0.01, len(elements))
    old = new.ravel()[elements]
    new.ravel()[elements] = np.where(old == 0.0, at_zero, factor * old) * apart
    return new


def _where(
    value: Floats, new: Floats, elements: NDArray[np.intp], now: _Numbers, then: _Numbers
) -> dict[int, list[int]] | None:
    """Return which numbers have changed with each element; None where one has changed otherwise, or none with an element."""
    which = dict(zip(new.ravel()[elements].tolist(), elements.tolist(), strict=True))
    where: dict[int, list[int]] = {element: [] for element in elements.tolist()}
    for place in np.flatnonzero(then.values.view(np.int64) != now.values.view(np.int64)).tolist():
        # What is the new value now, and was the old one, is this element.
        element = which.get(float(then.values[place]))
        if element is None or value.ravel()[element] != now.values[place]:
            return None
        where[element].append(place)
    return where if all(where.values()) else None


def _like(value: Floats) -> Any:
    """Return an array as settings are given: a number, or tuples of numbers."""
    return float(value) if value.ndim == 0 else _tuples(value.tolist())


def _tuples(rows: Any) -> Any:
    return tuple(map(_tuples, rows)) if isinstance(rows, list) else rows


def _split(
    name: str, value: Floats, places: dict[int, list[Element]], description: str, unit: str
) -> Iterator[Setting]:
    """Yield a setting as one, or, where not all of its elements may change, those that may one by one."""
    if len(places) == value.size:
        start = tuple(value.ravel().tolist())
        yield Setting(name, value.shape, start, tuple(tuple(places[i]) for i in range(value.size)), description, unit)
        return
    names = labels(name, value.shape)
    for element, where in places.items():
        yield Setting(names[element], (), (float(value.ravel()[element]),), (tuple(where),), description, unit)


def _measured(kind: type, name: str) -> str:
    """Return the unit that a setting has in the metadata of its field."""
    return next(str(field.metadata.get("unit", "")) for field in fields(kind) if field.name == name)


def _described(kind: type, name: str) -> str:
    """Return what a docstring in numpydoc's form says first of a setting, of the class or of one that it inherits from."""
    for each in kind.__mro__:
        found = _entry(getdoc(each) or "", name) if "__doc__" in vars(each) else ""
        if found and not found.startswith("See "):
            return found
    return f"{name} of {kind.__name__}"


def _entry(text: str, name: str) -> str:
    section = re.search(r"^Parameters\n-+\n(.*?)(?:^\w[^\n]*\n-+\n|\Z)", text, re.DOTALL | re.MULTILINE)
    names = rf"^(?:\w+, )*{re.escape(name)}(?:, \w+)*(?: :[^\n]*)?\n"
    entry = re.search(rf"{names}((?:    [^\n]*\n?)+)", section[1] if section else "", re.MULTILINE)
    if entry is None:
        return ""
    said = ""
    for sentence in re.split(r"(?<=[^.\d][.;:]) ", " ".join(entry[1].split()).replace("`", "")):
        said = f"{said} {sentence}".strip()
        if len(said) >= _TELLING:
            break
    return said.rstrip(".;:")
