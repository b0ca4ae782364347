"""Dataclasses as the schema of a scenario file: the keys of a table are the fields of its class, and no others.

A new fault, source or learner, or a new setting of one, can be used in a scenario file without a change here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from inspect import signature
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from bayesftc._public import meant
from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.scenario._place import Place

SCALARS = {float: "number", int: "whole number", str: "text in quotes", bool: "true or false"}


def build(
    cls: Callable[..., Any],
    table: object,
    place: Place,
    *,
    given: Mapping[str, Any] | None = None,
    of_kind: bool = False,
) -> Any:
    """Return an instance of a dataclass, or a function's result, made from a table of the file.

    Parameters
    ----------
    cls : type or function
        The dataclass, or the function; the names and types of its fields or arguments are the schema.
    table : object
        The value in the file.
    place : Place
        Its place in the file.
    given : mapping, optional
        Fields with values from elsewhere; they are no keys of the table.
    of_kind : bool
        Whether the key ``kind`` has named the class. Nobody who writes a file knows the name of any other.

    Raises
    ------
    ScenarioError
        If a key of the table is unknown, missing or of a wrong type.
    BayesFTCError
        If the class itself rejects the values. The message begins with the place.
    """
    given = dict(given or {})
    entries = as_table(table, place)
    known = {name: required for name, required in settings(cls).items() if name not in given}
    hints = get_type_hints(cls)
    place.refuse_unknown(entries, known)
    values = {name: convert(value, hints[name], place / name) for name, value in entries.items()}
    missing = [name for name, required in known.items() if required and name not in values]
    if missing:
        phrase = expected(hints[missing[0]])
        needed = f", which {cls.__name__} needs" if of_kind else ""
        raise place.error(f"lacks {missing[0]!r}{needed}. Add {missing[0]} = ... ({phrase}).")
    with place.named():
        return cls(**values, **given)


def choose(
    classes: Collection[Callable[..., Any]], table: object, place: Place
) -> tuple[Callable[..., Any], dict[str, Any]]:
    """Return the class or function that the key ``kind`` names (``"Freeze"`` or ``"freeze"``), and the rest of the table."""
    rest = dict(as_table(table, place))
    names = {cls.__name__: cls for cls in classes}
    if "kind" not in rest:
        raise place.error(f"lacks 'kind'. Add kind = one of {', '.join(map(repr, names))}.")
    kind = rest.pop("kind")
    by_folded = {_folded(name): name for name in names}
    folded = _folded(str(kind))
    if folded not in by_folded:
        near = [each for word in meant(str(kind)) if (each := word.rpartition(".")[2]) in names]
        near = near or [by_folded[match] for match in get_close_matches(folded, by_folded)]
        hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"known kinds: {', '.join(names)}."
        raise (place / "kind").error(f"is {kind!r}, which is no valid kind here; {hint}")
    return names[by_folded[folded]], rest


def build_one_of(classes: Collection[type[Any]], table: object, place: Place, **given: Any) -> Any:
    """Return an instance of the class that the table's ``kind`` names."""
    cls, rest = choose(classes, table, place)
    return build(cls, rest, place, given=given, of_kind=True)


def as_table(value: object, place: Place) -> Mapping[str, Any]:
    """Return `value` if it is a table."""
    if not isinstance(value, Mapping):
        raise place.error(f"is {value!r}. It must be a table: [{place.key}], with one line for each setting.")
    return value


def convert(value: object, hint: Any, place: Place) -> Any:
    """Return a value of the file as the type `hint`: lists become tuples, tables become the type's dataclasses."""
    classes = _dataclasses(hint)
    if classes and isinstance(value, Mapping) and not _is_sequence(hint, always=True):
        return _instance(classes, value, place)
    if isinstance(value, str) and When in classes:
        with place.named():
            if condition := When.read(value):
                return condition
    if isinstance(value, list) and _is_sequence(hint) and any(isinstance(item, Mapping) for item in value):
        return tuple(
            _instance(classes, item, place / i)
            if classes and isinstance(item, Mapping)
            else convert(item, hint, place / i)
            for i, item in enumerate(value)
        )
    if value == [] and classes and _is_sequence(hint):
        return ()
    plain = _writable(hint)
    if plain is NoneType and not classes:
        raise place.error("cannot be set in a scenario file. Leave it out, or build this loop in a Python script.")
    try:
        return _adapter(plain).validate_python(_tuples(value), strict=True)
    except ValidationError:
        shown = str(value).lower() if isinstance(value, bool) else repr(value)
        raise place.error(f"is {shown}; it must be {expected(hint, value)}.") from None


def _instance(classes: Sequence[type[Any]], table: Mapping[str, Any], place: Place) -> Any:
    # With a single class ``kind`` is optional.
    has_kind = len(classes) > 1 or "kind" in table
    return build_one_of(classes, table, place) if has_kind else build(classes[0], table, place)


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    return TypeAdapter(hint)


def settings(cls: Callable[..., Any]) -> dict[str, bool]:
    """Return the names of a dataclass's fields, or of a function's arguments, and whether each is required.

    Fields with ``metadata={"derived": True}`` are results of methods, or read from an FMU, and not settings.
    """
    if isinstance(cls, type):
        known = (f for f in fields(cls) if f.init and not f.metadata.get("derived"))
        return {f.name: f.default is MISSING and f.default_factory is MISSING for f in known}
    return {name: p.default is p.empty for name, p in signature(cls).parameters.items()}


def _folded(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()


def _tuples(value: object) -> object:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def _dataclasses(hint: Any) -> list[type[Any]]:
    """Return the dataclasses in a type. A base class is replaced by its registered subclasses."""
    if is_dataclass(hint) and isinstance(hint, type):
        return list(registered(hint)) or [hint]
    return list(dict.fromkeys(cls for part in get_args(hint) for cls in _dataclasses(part)))


def registered(base: type[Any]) -> tuple[type[Any], ...]:
    """Return the registered subclasses of `base`, or none if it has no registry."""
    from bayesftc.controllers.laws import ControlLaw
    from bayesftc.controllers.precision.base import PrecisionLearner
    from bayesftc.controllers.registry import LAWS, LEARNERS
    from bayesftc.controllers.switching.actuator_modes import ACTUATOR_MODES, ActuatorMode
    from bayesftc.controllers.switching.fault_modes import FAULT_MODES, FaultMode
    from bayesftc.cosim.blocks.faults.kinds import FAULTS, Fault, RandomFaults

    single = tuple(fault for fault in FAULTS if fault is not RandomFaults)  # a mixture cannot be a part of a mixture
    lists: dict[type[Any], tuple[type[Any], ...]] = {
        PrecisionLearner: LEARNERS,
        FaultMode: FAULT_MODES,
        ActuatorMode: ACTUATOR_MODES,
        ControlLaw: LAWS,
        Fault: single,
    }
    return lists.get(base, ())


def _writable(hint: Any) -> Any:
    """Return the part of a type that TOML can express, without fractions, functions, paths and classes; or NoneType."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in SCALARS or origin is Literal:
        return hint
    if origin in {Union, UnionType}:
        texts = {str} if When in parts else set()  # of a condition, which `convert` reads
        kept = [part for part in map(_writable, parts) if part is not NoneType and part not in texts]
        return Union[tuple(kept)] if kept else NoneType  # noqa: UP007 - from a list
    if isinstance(origin, type) and issubclass(origin, Sequence | Mapping):
        inner = tuple(part if part is Ellipsis else _writable(part) for part in parts)
        return NoneType if NoneType in inner else origin[inner if len(inner) > 1 else inner[0]]  # type: ignore[index]
    return NoneType


def expected(hint: Any, value: object = None) -> str:
    """Return a phrase for the TOML values of a type: ``a number or a list of numbers``.

    `value` is the value in the file. If it names a class, the example of a table has that class.
    """
    words: list[str] = []
    for word in [*_words(_writable(hint)), *_tables(hint, value)]:
        if word not in words:
            words.append(word)
    return " or ".join(filter(None, (", ".join(words[:-1]), *words[-1:]))) or "a table"


def _tables(hint: Any, value: object) -> list[str]:
    """Return a phrase for the tables of a type, if it has dataclasses."""
    classes = _dataclasses(hint)
    if not classes:
        return []
    of_many = _is_sequence(hint)
    if len(classes) == 1:
        needed = ", ".join(name for name, required in settings(classes[0]).items() if required)
        return [
            *(['a condition such as "plant.v > 22"'] if classes[0] is When else []),
            f"{'a list of tables' if of_many else 'a table'} with the settings of {classes[0].__name__}"
            + (f" ({needed})" if needed else ""),
        ]
    names = {_folded(cls.__name__): cls.__name__ for cls in classes}
    first = value[0] if isinstance(value, Sequence) and not isinstance(value, str) and value else value
    first = first.get("kind") if isinstance(first, Mapping) else first
    table = f'{{ kind = "{names.get(_folded(str(first)), classes[0].__name__)}" }}'
    return [f"a list of tables such as [{table}]" if of_many else f"a table such as {table}"]


def _is_sequence(hint: Any, *, always: bool = False) -> bool:
    """Return whether a type may be, or always is, a sequence of something."""
    origin = get_origin(hint)
    if origin in {Union, UnionType}:
        return (all if always else any)(
            _is_sequence(part, always=always) for part in get_args(hint) if part is not NoneType
        )
    return isinstance(origin, type) and issubclass(origin, Sequence)


def _words(hint: Any) -> list[str]:
    origin, parts = get_origin(hint), get_args(hint)
    if hint in SCALARS:
        return [SCALARS[hint] if hint is bool else f"a {SCALARS[hint]}"]
    if origin is Literal:
        return [repr(part) for part in parts]
    if origin in {Union, UnionType}:
        return [word for part in parts for word in _words(part)]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        of = _words(parts[1])
        return ["a table" + (f" of {_plural(of[0])}" if len(of) == 1 else "")]
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return ["a list of " + " or ".join(_plural(word) for word in _words(parts[0]))]
    return []


def _plural(word: str) -> str:
    plural = {"a list of numbers": "rows of numbers", "a text in quotes": "texts in quotes"}
    if word.startswith("a list of "):
        return plural.get(word) or "lists of " + word.removeprefix("a list of ")
    return plural.get(word) or (word.removeprefix("a ") + "s" if word.startswith("a ") else word)
