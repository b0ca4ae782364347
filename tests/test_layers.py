"""Which parts of the package may use which: imports point one way, in no circle, at no name that is another file's own."""

import ast
from pathlib import Path

import bayesftc

ROOT = Path(bayesftc.__file__).resolve().parent
LAYERS = ("fmus", "cosim", "controllers", "scenario", "monitoring", "bench", "reproduce", "report", "examples", "cli")
"""Each may use those before it."""


def modules():
    """Return the syntax tree of each module of the package by its full name."""
    found = {}
    for layer in LAYERS:
        for file in (ROOT / layer).rglob("*.py"):
            parts = ("bayesftc", *file.relative_to(ROOT).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = ast.parse(
                file.read_text(encoding="utf-8")
            )
    return found


MODULES = modules()


def imports(tree, *, at_once=False):
    """Yield what a module imports from this package: module and name; with `at_once` only what it needs to be imported itself."""
    waiting = [tree]
    while waiting:
        for node in ast.iter_child_nodes(waiting.pop()):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "bayesftc":
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    yield (whole, None) if whole in MODULES else (node.module, alias.name)
            later = isinstance(node, ast.FunctionDef) or (
                isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
            )
            if not (at_once and later):
                waiting.append(node)


def layer_of(module):
    return module.split(".")[1] if "." in module else ""


def test_imports_point_one_way():
    seen = set()
    for module, tree in MODULES.items():
        for used, _ in imports(tree):
            own, other = layer_of(module), layer_of(used)
            if other in LAYERS and own != other:
                assert LAYERS.index(other) < LAYERS.index(own), f"{module} uses {used}"
                seen.add((own, other))
    assert len(seen) > 10


def test_no_module_needs_itself():
    needs = {
        m: {used for used, _ in imports(tree, at_once=True) if used in MODULES} - {m} for m, tree in MODULES.items()
    }
    assert sum(map(len, needs.values())) > 500
    while free := [module for module, others in needs.items() if not others & needs.keys()]:
        for module in free:
            del needs[module]
    assert not needs, f"these import each other in a circle: {', '.join(sorted(needs))}"


def test_names_that_begin_with_an_underscore_stay_in_their_file():
    for module, tree in MODULES.items():
        for used, name in imports(tree):
            private = name is not None and name.startswith("_") and not name.startswith("__")
            assert not private, f"{module} uses {name} of {used}"
