"""Tables of the keys of scenario, campaign and monitor files; ``bayesftc keys`` prints the same.

``{keys} bayesftc.cosim.Freeze`` is a table of a class's or function's keys; ``{kinds} bayesftc.cosim.FAULTS`` has one for each
class of a list.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

from bayesftc.scenario._keys import keys_of, summary, thing


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


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_directive("keys", Keys)
    app.add_directive("kinds", Kinds)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
