"""A page for each public name, and lists of them by subject: written before Sphinx reads its sources.

The names are those of ``__init__.pyi``. A subject is the folder in which a name is defined, with its docstring as the heading. So
a new public name has its page without a change of the site.
"""

from __future__ import annotations

import importlib
import inspect
from collections import defaultdict
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MODULES = (
    "bayesftc.cosim",
    "bayesftc.cosim.live",
    "bayesftc.cosim.statistics",
    "bayesftc.controllers",
    "bayesftc.monitoring",
    "bayesftc.fmus",
)
FOLDER = "reference/api"


def public(module: ModuleType) -> dict[str, Any]:
    """Return the public names of a module, without modules that have a list of their own."""
    names = {name: getattr(module, name) for name in module.__all__}
    return {n: t for n, t in names.items() if not (inspect.ismodule(t) and t.__name__ in MODULES)}


def subject(thing: Any, module: str) -> str:
    """Return the name of the folder in which something is defined; of constants and modules, that of `module`."""
    where = getattr(thing, "__module__", None) or module
    if not where.startswith(module):
        return module
    folder = where.rpartition(".")[0]
    # Folders inside the second level (cosim.fmi.exchange) belong to their subject, except for a large one.
    return (
        folder if folder.count(".") <= module.count(".") + 1 or "faults" in folder else ".".join(folder.split(".")[:3])
    )


def heading(folder: str) -> str:
    """Return the first sentence of a folder's docstring."""
    text = (inspect.getdoc(importlib.import_module(folder)) or folder).splitlines()[0]
    return text.rstrip(".")


def kind(thing: Any) -> str:
    """Return which template a name's page has."""
    if inspect.isclass(thing):
        return "error" if issubclass(thing, Exception) else "class"
    if inspect.ismodule(thing):
        return "module"
    return "function" if inspect.isroutine(thing) else "data"


def _title(text: str, rule: str = "=") -> str:
    return f"{text}\n{rule * len(text)}\n"


def page(module: ModuleType) -> str:
    """Return the text of the page that lists the public names of a module."""
    name = module.__name__
    groups: dict[str, list[str]] = defaultdict(list)
    for short, thing in public(module).items():
        groups["errors" if kind(thing) == "error" else subject(thing, name)].append(short)
    lines = [_title(name), (inspect.getdoc(module) or "").split("\n\n")[0], ""]
    things = public(module)
    for folder in sorted(groups, key=lambda g: (g == "errors", g != name, g)):
        title = "Errors" if folder == "errors" else "General" if folder == name else heading(folder)
        lines.append(_title(title, "-"))
        for template in ("class", "function", "data", "module", "error"):
            chosen = sorted((n for n in groups[folder] if kind(things[n]) == template), key=str.lower)
            if chosen:
                lines += [".. autosummary::", f"   :toctree: {name}", f"   :template: {template}.rst", ""]
                lines += [*(f"   ~{name}.{n}" for n in chosen), ""]
    return "\n".join(lines) + "\n"


def write_pages(app: Sphinx, _: object) -> None:
    """Write the lists into ``reference/api``; files that do not change keep their time, so that Sphinx skips them."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    texts = {name: page(importlib.import_module(name)) for name in MODULES}
    texts["index"] = (
        _title("Public names") + "\n".join([".. toctree::", "", *(f"   {name}" for name in MODULES)]) + "\n"
    )
    for name, text in texts.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("config-inited", write_pages)  # before Sphinx looks for its sources
    return {"parallel_read_safe": True, "parallel_write_safe": True}
