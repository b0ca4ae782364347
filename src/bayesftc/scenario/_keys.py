"""The keys of scenario, campaign and monitor files, from the dataclasses and functions that are their schema.

The command ``bayesftc keys`` and the site show them.
"""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import MISSING, fields
from typing import Any, NamedTuple, get_type_hints

from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.scenario._schema import expected, settings

SECTION = re.compile(r"(Parameters|Attributes)\n-{3,}\n(.*?)(?=\n\S[^\n]*\n-{3,}\n|\Z)", re.DOTALL)
ELSEWHERE = re.compile(r"See `([\w.]+)`")


class Part(NamedTuple):
    """Keys of a section: those of a class or function, or of each class of a list, by its full name.

    Attributes
    ----------
    path : str
        The full name.
    title : str
        What has these keys, such as ``An FMU``.
    without : str
        Names that are no keys of the file, separated by spaces.
    """

    path: str
    title: str = ""
    without: str = ""


class Key(NamedTuple):
    """A key of a file: its name, a phrase for its values, its default as it is written in a file, and its meaning."""

    name: str
    value: str
    default: str
    meaning: str


def thing(path: str) -> Any:
    """Return what a full name stands for."""
    parts = path.split(".")
    for i in range(len(parts) - 1, 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:i]))
        except ImportError:
            continue
        for part in parts[i:]:
            found = getattr(found, part)
        return found
    raise ImportError(path)


def keys_of(schema: Any, without: str = "") -> list[Key]:
    """Return the keys that a class or function has in a file."""
    hints, texts, given, units = get_type_hints(schema), described(schema), defaults(schema), units_of(schema)
    phrases = {name: expected(hints[name]) for name in settings(schema) if name not in without.split()}
    return [
        Key(name, phrase + (f" ({units[name]})" if name in units else ""), shown(given[name]), texts.get(name, ""))
        for name, phrase in phrases.items()
        if phrase
    ]


def summary(cls: type) -> str:
    """Return the first sentence of a docstring."""
    return " ".join((inspect.getdoc(cls) or "").split("\n\n")[0].split())


def described(schema: Any) -> dict[str, str]:
    """Return what a docstring says about each key, also those of the bases, and of what an entry refers to."""
    texts: dict[str, str] = {}
    for base in reversed(schema.__mro__[:-1]) if isinstance(schema, type) else [schema]:
        for names, words in _entries(base.__doc__ or ""):
            if (reference := ELSEWHERE.match(words)) and not set(names) <= texts.keys():
                other = _named(reference[1])
                texts |= {name: text for name, text in (described(other) if other else {}).items() if name in names}
            elif words and not reference:
                texts |= dict.fromkeys(names, words)
    return texts


def _entries(doc: str) -> list[tuple[list[str], str]]:
    """Return the parameters and attributes in a docstring in the form of numpydoc: names, and the text about them."""
    found: list[tuple[list[str], str]] = []
    for section in SECTION.finditer(inspect.cleandoc(doc)):
        for entry in re.split(r"\n(?=\S)", section[2].strip("\n")):
            head, _, text = entry.partition("\n")
            found.append((re.split(r",\s*", head.partition(" : ")[0].strip()), " ".join(text.split())))
    return found


def _named(name: str) -> Any:
    """Return a public class or function by its name; None if there is none."""
    for module in ("controllers", "cosim", "monitoring"):
        try:
            return thing(f"bayesftc.{module}.{name}")
        except AttributeError:
            continue
    return None


def defaults(schema: Any) -> dict[str, Any]:
    """Return the default of each key; MISSING for a required one."""
    if isinstance(schema, type):
        return {f.name: MISSING if f.default_factory is MISSING else None for f in fields(schema)} | {
            f.name: f.default for f in fields(schema) if f.default is not MISSING
        }
    parameters = inspect.signature(schema).parameters
    return {name: MISSING if p.default is p.empty else p.default for name, p in parameters.items()}


def units_of(schema: Any) -> dict[str, str]:
    """Return the unit of each key that has one; that of a port is not known before a scenario connects it."""
    units = {f.name: f.metadata.get("unit") for f in fields(schema)} if isinstance(schema, type) else {}
    return {name: re.sub("{.*?}", "unit of the signal", unit) for name, unit in units.items() if unit}


def shown(value: Any) -> str:
    """Return how a default is written in a file."""
    if value is MISSING:
        return "required"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, DefaultTime):
        return value.in_words
    if isinstance(value, int | float):
        return str(value)
    return f"[{', '.join(map(repr, value))}]" if isinstance(value, tuple) and value else ""
