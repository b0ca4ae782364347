"""Tables of the keys of scenario, campaign and model files, from the dataclasses that are their schema.

``{keys} bayesftc.cosim.Freeze`` is a table of a class's keys; ``{kinds} bayesftc.cosim.FAULTS`` has one for each class of a list.
"""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import MISSING, Field, fields
from typing import Any, get_type_hints

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from numpydoc.docscrape import NumpyDocString
from sphinx.application import Sphinx

from bayesftc.scenario._schema import expected


def thing(path: str) -> Any:
    """Return what a full name stands for."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def described(cls: type[Any]) -> dict[str, str]:
    """Return the first sentence about each field, from the docstrings of a class and its bases."""
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__[:-1]):
        text = NumpyDocString(inspect.cleandoc(base.__doc__ or ""))
        for entry in (*text["Parameters"], *text["Attributes"]):
            words = " ".join(entry.desc)
            if words and not words.startswith("See "):
                for name in re.split(r",\s*", entry.name):
                    found[name] = words
    return found


def meaning(text: str) -> str:
    """Return a docstring's sentence as Markdown in the cell of a table."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    return text.replace("|", r"\|") or " "


def default(setting: Field[Any]) -> str:
    """Return how a default is written in a file."""
    value = setting.default if setting.default is not MISSING else None
    if setting.default is MISSING and setting.default_factory is MISSING:
        return "required"
    if value is None or (not isinstance(value, bool | int | float | str | tuple)):
        return " "
    if isinstance(value, tuple):
        return f"`[{', '.join(map(repr, value))}]`" if value else " "
    return (
        f"`{str(value).lower()}`"
        if isinstance(value, bool)
        else f'`"{value}"`'
        if isinstance(value, str)
        else f"`{value}`"
    )


def table(cls: type[Any], without: set[str]) -> list[str]:
    """Return the Markdown table of the keys that a class has in a file."""
    hints, texts = get_type_hints(cls), described(cls)
    rows = []
    for setting in fields(cls):
        phrase = expected(hints[setting.name])
        if setting.init and setting.name not in without and phrase:
            rows.append(
                f"| `{setting.name}` | {phrase} | {default(setting)} | {meaning(texts.get(setting.name, ''))} |"
            )
    return ["| key | value | default | meaning |", "|---|---|---|---|", *rows, ""] if rows else ["No further keys.", ""]


class Keys(Directive):
    """A table of the keys of a class; the option ``without`` leaves some out."""

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
