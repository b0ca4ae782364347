"""Which folders may import from which: ``tools/floors.py`` has the list and reads the imports, in whatever form and wherever."""

import ast
import gc
import importlib.util
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[1] / "tools" / "floors.py"
spec = importlib.util.spec_from_file_location("floors", TOOL)
floors = importlib.util.module_from_spec(spec)
spec.loader.exec_module(floors)


@pytest.fixture(scope="module")
def modules():
    """Return the syntax trees of all modules: once, and not in each worker that collects these tests."""
    gc.disable()  # which would look at the millions of nodes again and again
    yield floors.modules()
    gc.enable()


@pytest.fixture(scope="module")
def edges(modules):
    """Return what each module imports."""
    return floors.edges(modules)


def test_folders_import_from_below(edges):
    up = [
        f"{module} -> {target}"
        for module, targets in edges.items()
        for target in sorted(targets)
        if floors.floor(target) > floors.floor(module) and not floors.door(module, target)
    ]
    assert sum(map(len, edges.values())) > 1500
    assert not up, f"these reach up, and through no door of {TOOL.name}: {', '.join(up)}"


def test_every_door_is_used_and_says_for_what(edges):
    for (module, target), reason in floors.DOORS.items():
        through = [t for t in edges[module] if floors.door(module, t) == (module, target)]
        assert through, f"nothing goes through {module} -> {target}"
        assert reason


def test_every_floor_has_something_on_it(modules):
    for name in (name for level in floors.FLOORS for name in level):
        assert any(m == name or m.startswith(name + ".") for m in modules), f"{name} stands in FLOORS, but nowhere else"


@pytest.mark.parametrize(
    "line",
    [
        "from bayesftc.cosim.run.session import Session",
        "import bayesftc.cosim.run.session",
        "import bayesftc.cosim.run.session as live",
        "from bayesftc.cosim import Session",
        "def f():\n    from bayesftc.cosim.run import session",
        "if TYPE_CHECKING:\n    from bayesftc.cosim.run.session import Session",
    ],
)
def test_an_import_is_seen_in_every_form(line, modules):
    found = set(floors.imports("cosim.block", ast.parse(line), modules, floors.public(modules)))
    assert found == {"cosim.run.session"}


def test_modules_that_import_each_other_are_few(edges):
    inside = {module: {t for t in targets if not floors.door(module, t)} for module, targets in edges.items()}
    circles = floors.circles(inside)
    assert circles
    large = [circle for circle in circles if len(circle) > floors.LARGEST_CIRCLE]
    assert not large, f"these import each other in a circle: {'; '.join(map(', '.join, large))}"


def test_folders_stay_small(modules):
    files = {}
    for module in modules:
        folder, _, name = module.rpartition(".")
        files[folder] = files.get(folder, 0) + (name != "__init__")
    full = {f: n for f, n in files.items() if n > floors.MOST_FILES}
    assert not full, f"more than {floors.MOST_FILES} files: join two that belong together, or make a folder of some"


def test_functions_take_few_arguments(modules):
    functions = [
        (f"{module}.{node.name}", len(node.args.posonlyargs) + len(node.args.args))
        for module, tree in modules.items()
        for node in floors.statements(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    assert len(functions) > 3000
    assert not {f"{name}: {count}" for name, count in functions if count > floors.MOST_ARGUMENTS}


def test_only_tables_of_coefficients_are_formatted_by_hand():
    folders = [TOOL.parents[1] / folder for folder in ("cosim", "controllers", "fmus", "src", "examples", "tools")]
    files = [file for folder in folders for file in folder.rglob("*.py")]
    by_hand = {file.name for file in files if "# fmt:" in file.read_text(encoding="utf-8")}
    assert by_hand == {"drawing.py", "elementary.py"}


def test_no_module_needs_itself_to_be_imported(modules):
    needs = {}
    behind = floors.public(modules)
    for module, tree in modules.items():
        at_once = ast.Module([n for n in tree.body if not later(n)], [])
        needs[module] = set(floors.imports(module, at_once, modules, behind))
    assert sum(map(len, needs.values())) > 500
    while free := [module for module, others in needs.items() if not others & needs.keys()]:
        for module in free:
            del needs[module]
    assert not needs, f"these import each other in a circle: {', '.join(sorted(needs))}"


def later(node):
    """Return whether a statement at the top of a module is not carried out when the module is imported."""
    return isinstance(node, ast.FunctionDef | ast.ClassDef) or (
        isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
    )


def test_names_that_begin_with_an_underscore_stay_in_their_file(modules):
    for module, tree in modules.items():
        for node in floors.statements(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "bayesftc":
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}".removeprefix("bayesftc.")
                    private = alias.name.startswith("_") and not alias.name.startswith("__") and whole not in modules
                    assert not private, f"{module} uses {alias.name} of {node.module}"


def test_the_picture_is_of_these_floors(edges):
    assert floors.PICTURE.read_text(encoding="utf-8") == floors.draw(edges), "python tools/floors.py draw"
