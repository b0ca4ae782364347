"""Tables of the keys of scenario, campaign and monitor files (``bayesftc keys`` prints the same), and of the columns of results.

``{keys} bayesftc.cosim.Freeze`` is a table of a class's or function's keys; ``{kinds} bayesftc.cosim.FAULTS`` has one for each
class of a list. ``{columns} bayesftc.cosim.judging.metrics.Errors`` is a table of a record's figures, and ``{definitions}
bayesftc.cosim.judging.metrics`` the text of a module's docstring.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterable, Mapping
from typing import Any, get_type_hints

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

from bayesftc.scenario._keys import described, keys_of, summary, thing


def meaning(text: str) -> str:
    """Return a docstring's sentence as Markdown in the cell of a table."""
    text = re.sub(r"``(.+?)``", r"`\1`", text)
    return text.replace("|", r"\|") or " "


def table(schema: Any, without: str) -> list[str]:
    """Return the Markdown table of the keys that a class or function has in a file."""
    rows = [
        f"| `{key.name}` | {key.value} | {f'`{key.default}`' if key.default not in {'', 'required'} else key.default or ' '} | "
        f"{meaning(key.meaning)} |"
        for key in keys_of(schema, without)
    ]
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
        return table(chosen, self.options.get("without", ""))

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
            out += [f'**`kind = "{cls.__name__}"`**: {meaning(summary(cls))}', "", *super().lines(cls)]
        return out


def columns(record: Any, prefix: str, labels: Mapping[str, str]) -> list[str]:
    """Return the Markdown table of a record's figures: name of the column, label in printed tables, meaning.

    Texts and numbers of sensors are no figures: they are in files, but no columns of a campaign.
    """
    hints, rows = get_type_hints(record), []
    for name, words in described(record).items():
        column = f"`{prefix}{name}`" if hints[name] is float else f"`{name}`, only in `figures.json`"
        rows.append(f"| {column} | {labels.get(name, ' ')} | {meaning(words)} |")
    return ["| column | in printed tables | meaning |", "|---|---|---|", *rows, ""]


def labels_of(rows: Mapping[str, str] | Iterable[tuple[str, str, str]]) -> dict[str, str]:
    """Return the label of each figure in printed tables, from the rows of such a table."""
    return dict(rows) if isinstance(rows, Mapping) else {key: label for label, key, _ in rows}


class Columns(Keys):
    """A table of the columns that a record of figures has in results; `prefix` precedes their names, `rows` has their labels."""

    option_spec = {"prefix": str, "rows": str}  # noqa: RUF012 - as docutils has it

    def lines(self, chosen: Any) -> list[str]:
        """Return the text."""
        return columns(chosen, self.options["prefix"], labels_of(thing(self.options["rows"])))


def definitions(module: str) -> list[str]:
    """Return the docstring of a module as Markdown, without its first paragraph."""
    text = inspect.getdoc(importlib.import_module(module)) or ""
    return re.sub(r"``(.+?)``", r"`\1`", text.partition("\n\n")[2]).splitlines()


class Definitions(Keys):
    """The docstring of a module, without its first paragraph."""

    def run(self) -> list[nodes.Node]:
        """See the class."""
        return self.parsed(definitions(self.arguments[0]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_directive("keys", Keys)
    app.add_directive("kinds", Kinds)
    app.add_directive("columns", Columns)
    app.add_directive("definitions", Definitions)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
