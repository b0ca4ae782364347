"""Links between the site and the rest of the repository.

The pages at the root of the repository (`PAGES`) get copies in ``project/``. Links lead to these copies; a link to any other file
outside `docs`, such as an example, becomes a download.
"""

from __future__ import annotations

import re
from os.path import normpath, relpath
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGES = {
    "CHANGELOG.md": "docs/project/changelog.md",
    "CONTRIBUTING.md": "docs/project/contribute.md",
    "SECURITY.md": "docs/project/security.md",
    "benchmarks/README.md": "docs/project/benchmarks.md",
}
_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s]+)\)")


def linked(text: str, source: str, target: str) -> str:
    """Return the text of a page with the links that it has on the site.

    Parameters
    ----------
    text : str
        The page as in the repository.
    source, target : str
        Its file in the repository and on the site, relative to the root of the repository.
    """

    def link(match: re.Match[str]) -> str:
        words, url = match.groups()
        path, _, anchor = url.partition("#")
        if not path or "://" in url or url.startswith("mailto:"):
            return match[0]
        file = normpath(Path(source).parent / path)
        file = PAGES.get(file, file)
        relative = relpath(file, Path(target).parent)
        if not file.startswith("docs/"):
            return f"{{download}}`{words.replace('`', '')} <{relative}>`"
        return f"[{words}]({relative}{'#' * bool(anchor)}{anchor})"

    parts = re.split(r"(^```.*?^```)", text, flags=re.M | re.S)  # code is left as it is
    return "".join(part if part.startswith("```") else _LINK.sub(link, part) for part in parts)


def copy_pages(app: Sphinx, _: object) -> None:
    """Write the copies of the pages at the root; those that do not change keep their time."""
    root = Path(app.srcdir).parent
    for source, target in PAGES.items():
        text, path = linked((root / source).read_text(encoding="utf-8"), source, target), root / target
        path.parent.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def link_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Rewrite the links of a page that lead out of `docs`."""
    file = f"docs/{name}.md"
    if file not in PAGES.values() and (Path(app.srcdir).parent / file).exists():
        source[0] = linked(source[0], file, file)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("config-inited", copy_pages)  # before Sphinx looks for its sources
    app.connect("source-read", link_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
