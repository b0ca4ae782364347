"""A class that inherits parameters shows them on its page, with the descriptions from its bases.

The signature of ``Freeze`` has the parameters of ``Fault``, which only the docstring of ``Fault`` describes. An entry that only
refers to a base ("See `Fault`.") is replaced as well.
"""

from __future__ import annotations

import inspect
import re
from typing import TYPE_CHECKING, Any

from numpydoc.docscrape import NumpyDocString, Parameter

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ONLY_A_REFERENCE = re.compile(r"See `[\w.]+`(, also for errors)?\.?")
BEFORE_NUMPYDOC = 400


def entries(thing: Any) -> list[tuple[list[str], Parameter]]:
    """Return the parameters and attributes in the docstring of a class or function, each with its names.

    Those of the bases of a class are not among them.
    """
    text = NumpyDocString(inspect.cleandoc(thing.__doc__ or ""))
    return [(re.split(r",\s*", entry.name), entry) for entry in (*text["Parameters"], *text["Attributes"])]


def refers(entry: Parameter) -> bool:
    """Return whether an entry is nothing but a reference to another class."""
    return bool(ONLY_A_REFERENCE.fullmatch(" ".join(entry.desc).strip()))


def completed(cls: type, text: str) -> str:
    """Return the docstring of a class with the parameters that its signature has and only its bases describe.

    Parameters
    ----------
    cls : type
        The class.
    text : str
        Its docstring.
    """
    try:
        names = list(inspect.signature(cls).parameters)
    except (TypeError, ValueError):
        return text
    own = entries(cls)
    described = {name for given, entry in own if not refers(entry) for name in given}
    missing = [name for name in names if name not in described]
    found: dict[str, tuple[list[str], Parameter]] = {}
    for base in reversed(cls.__mro__[1:-1]):
        found |= {name: each for each in entries(base) if not refers(each[1]) for name in each[0] if name in missing}
    if not found:
        return text
    parsed = NumpyDocString(inspect.cleandoc(text))
    groups: dict[str, Parameter] = {}  # in the order of the signature
    for entry in parsed["Parameters"]:
        left = [name for name in re.split(r",\s*", entry.name) if name not in found]
        if left:
            groups[left[0]] = Parameter(", ".join(left), entry.type, entry.desc)
    for name in names:
        if name in found:
            given, entry = found[name]
            together = [other for other in given if found.get(other) == found[name]]
            groups[together[0]] = Parameter(", ".join(together), entry.type, entry.desc)
    places = {name: place for place, name in enumerate(names)}
    parsed["Parameters"] = [groups[name] for name in sorted(groups, key=lambda name: places.get(name, len(places)))]
    return str(parsed)


def complete(_app: Sphinx, what: str, _name: str, thing: Any, _options: Any, lines: list[str]) -> None:
    """Complete the docstring of a class."""
    if what in {"class", "exception"} and isinstance(thing, type) and thing.__doc__:
        lines[:] = completed(thing, "\n".join(lines)).splitlines()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("autodoc-process-docstring", complete, priority=BEFORE_NUMPYDOC)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
