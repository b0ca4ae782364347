"""A figure drawn by the code in a page: ``{drawn} what one sees, in words``. The code draws with matplotlib's pyplot.

(matplotlib's own directive does not work in Markdown pages.)
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

FOLDER = "drawn"


class Drawn(SphinxDirective):
    """Executes its content and shows the current figure; the argument is its alternative text."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list[nodes.Node]:
        """See the class."""
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot

        code = "\n".join(self.content)
        name = f"{hashlib.sha256(code.encode()).hexdigest()[:16]}.svg"
        path = Path(self.env.srcdir) / FOLDER / name
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            with matplotlib.rc_context({"svg.hashsalt": name, "font.size": 10}):
                exec(compile(code, self.env.docname, "exec"), {"__name__": "__main__"})
                pyplot.gcf().savefig(path, metadata={"Date": None})
                pyplot.close("all")
        image = nodes.image("", uri=f"/{FOLDER}/{name}", alt=self.arguments[0])
        return [image]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_directive("drawn", Drawn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
