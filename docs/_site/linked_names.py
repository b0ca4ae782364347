"""Code in a page that is a public name, such as ``Freeze`` or ``cosim.FMU``, becomes a link to the page of that name."""

from __future__ import annotations

import importlib
from functools import cache

from docutils import nodes
from public_names import MODULES, public
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform


@cache
def targets() -> dict[str, str]:
    """Return the full name for each way to write a public name: ``FMU``, ``cosim.FMU``, ``bayesftc.cosim.FMU``."""
    ways: dict[str, str] = {}
    clear: dict[str, set[str]] = {}
    for module in MODULES:
        for name in public(importlib.import_module(module)):
            full = f"{module}.{name}"
            ways |= {full: full, full.removeprefix("bayesftc."): full}
            clear.setdefault(name, set()).add(full)
    # A word of lower case (compare, fit) is linked only with its module, because it may also be an argument or a command.
    return ways | {n: next(iter(f)) for n, f in clear.items() if len(f) == 1 and n[0].isupper()}


def is_linked(node: nodes.Node) -> bool:
    """Return whether a node stands in a link or a heading, at any depth: a link within a link is none."""
    while node.parent is not None:
        node = node.parent
        if isinstance(node, nodes.reference | pending_xref | nodes.title):
            return True
    return False


class LinkNames(SphinxPostTransform):
    """Wraps a literal whose text is a public name into a link."""

    default_priority = 5

    def run(self, **_: object) -> None:
        """See the class."""
        for literal in list(self.document.findall(nodes.literal)):
            text = literal.astext().partition("(")[0]
            if text in targets() and not is_linked(literal):
                full = targets()[text]
                if self.env.docname.endswith(full):
                    continue
                link = pending_xref("", refdomain="py", reftype="obj", reftarget=full, refexplicit=True, refwarn=True)
                literal.replace_self(link)
                link += literal


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_post_transform(LinkNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
