"""Tables of the keys of scenario, campaign and model files, from the dataclasses and functions that are their schema.

``{keys} bayesftc.cosim.Freeze`` is a table of a class's or function's keys; ``{kinds} bayesftc.cosim.FAULTS`` has one for each
class of a list.
"""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import MISSING, fields
from typing import Any, get_type_hints

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from inherited_parameters import entries
from sphinx.application import Sphinx

from bayesftc.scenario._schema import expected, settings


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


def described(schema: Any) -> dict[str, str]:
    """Return the first sentence about each key, from the docstring; of a class also from those of its bases."""
    texts: dict[str, str] = {}
    for base in reversed(schema.__mro__[:-1]) if isinstance(schema, type) else [schema]:
        for names, entry in entries(base):
            words = " ".join(entry.desc)
            if words and not words.startswith("See "):
                texts |= dict.fromkeys(names, words)
    return texts


def defaults(schema: Any) -> dict[str, Any]:
    """Return the default of each key; MISSING for a required one."""
    if isinstance(schema, type):
        return {f.name: MISSING if f.default_factory is MISSING else None for f in fields(schema)} | {
            f.name: f.default for f in fields(schema) if f.default is not MISSING
        }
    parameters = inspect.signature(schema).parameters
    return {name: MISSING if p.default is p.empty else p.default for name, p in parameters.items()}


def meaning(text: str) -> str:
    """Return a docstring's sentence as Markdown in the cell of a table."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    return text.replace("|", r"\|") or " "


def shown(value: Any) -> str:
    """Return how a default is written in a file."""
    if value is MISSING:
        return "required"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, int | float):
        return f"`{value}`"
    return f"`[{', '.join(map(repr, value))}]`" if isinstance(value, tuple) and value else " "


def table(schema: Any, without: set[str]) -> list[str]:
    """Return the Markdown table of the keys that a class or function has in a file."""
    hints, texts, given = get_type_hints(schema), described(schema), defaults(schema)
    rows = []
    for name in settings(schema):
        phrase = expected(hints[name]) if name not in without else ""
        if phrase:
            rows.append(f"| `{name}` | {phrase} | {shown(given[name])} | {meaning(texts.get(name, ''))} |")
    return ["| key | value | default | meaning |", "|---|---|---|---|", *rows, ""] if rows else ["No further keys.", ""]


class Keys(Directive):
    """A table of the keys of a class or function; the option ``without`` leaves some out."""

    required_arguments = 1
    option_spec = {"without": str}  # noqa: RUF012 - as docutils has it

    def run(self) -> list[nodes.Node]:
        """See the class."""
        return self.parsed(self.lines(thing(self.arguments[0])))

    def lines(self, chosen: Any) -> list[str]:
        """Return the text."""
        return table(chosen, set(self.options.get("without", "").split()))

    def parsed(self, lines: list[str]) -> list[nodes.Node]:
        """Return the nodes of a Markdown text."""
        node = nodes.Element()
        self.state.nested_parse(StringList(lines, source=self.arguments[0]), self.content_offset, node)
        return node.children


class Kinds(Keys):
    """A table of keys for each class of a list, under its name and the first sentence of its docstring."""

    def lines(self, chosen: Any) -> list[str]:
        """Return the text."""
        out: list[str] = []
        for cls in chosen:
            first = " ".join((inspect.getdoc(cls) or "").split("\n\n")[0].split())
            out += [f'**`kind = "{cls.__name__}"`**: {meaning(first)}', "", *super().lines(cls)]
        return out


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_directive("keys", Keys)
    app.add_directive("kinds", Kinds)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
