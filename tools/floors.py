"""The floors of the package: which folder may import from which.

    python tools/floors.py          # prints the floors, the upward imports, and the circles
    python tools/floors.py draw     # writes docs/figures/floors.svg, from the imports of the code

Every import counts: at the top of a module, inside a function, under ``TYPE_CHECKING``. A folder imports from its own floor and
from those below it. The few upward imports, for a user's convenience, are named doors.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FLOORS: tuple[tuple[str, ...], ...] = (
    ("_interrupt",),
    ("cosim.errors",),
    ("_public",),
    ("fmus",),
    ("cosim.types",),
    ("cosim.base",),
    ("cosim.base.recordings",),
    ("cosim.elementary",),
    ("cosim.ops", "cosim.ports"),
    ("cosim.array_ports",),
    ("cosim.stepping", "cosim.stepping.source"),
    ("cosim.stepping.translate",),
    ("cosim.stepping.machine",),
    ("cosim.random", "cosim.drawing"),
    ("cosim.block",),
    ("cosim.blocks.faults",),
    ("cosim.blocks", "cosim.blocks.sensing"),
    ("cosim.fmi.reading",),
    ("cosim.fmi.binaries",),
    ("cosim.fmi.running",),
    ("cosim.fmi.exchange",),
    ("cosim.fmi.exchange.integrators",),
    ("cosim.isolation",),
    ("cosim.fmi",),
    ("cosim.fmi.prediction",),
    ("cosim.diagram",),
    ("cosim.run", "cosim.run.coupled"),
    ("cosim.judging",),
    ("cosim.judging.figures",),
    ("cosim.control",),
    ("cosim.ssp",),
    ("cosim.export",),
    ("cosim.campaign.designs",),
    ("cosim.campaign.runs",),
    ("cosim.campaign.store",),
    ("cosim.campaign.executors",),
    ("cosim.campaign",),
    ("cosim.live",),
    ("cosim.statistics",),
    ("cosim.fitting",),
    ("cosim.comparison",),
    ("cosim",),
    ("controllers.linalg",),
    ("controllers.signals", "controllers.models", "controllers.models.fmu"),
    ("controllers.identification",),
    ("controllers.thresholds",),
    ("controllers.laws", "controllers.precision.base"),
    ("controllers.estimation",),
    ("controllers.precision",),
    ("controllers.switching", "controllers.switching.bank"),
    ("controllers.bayesian",),
    ("controllers.learning",),
    ("controllers.active_inference",),
    ("controllers.registry",),
    ("controllers.detection",),
    ("controllers.diagnosis", "controllers.diagnosis.words"),
    ("controllers.design",),
    ("controllers",),
    ("scenario", "scenario.live"),
    ("monitoring.fit", "monitoring"),
    ("console", "console.desk"),
    ("console.shown",),
    ("console.web",),
    ("bench", "bench.measures", "bench.measures.console", "bench.measures.live"),
    ("reproduce.settings", "reproduce.paper"),
    ("reproduce.shared",),
    ("reproduce.experiments",),
    ("reproduce.registry", "reproduce"),
    ("report",),
    ("examples",),
    (
        "cli",
        "cli.commands",
        "cli.inspection",
        *(f"cli.commands.{name}" for name in ("loops", "recordings", "fmus", "campaigns", "studies")),
    ),
    ("__main__", "__init__"),
)
"""Folders, and modules on another floor than their folder, from the lowest floor up."""

DOORS: dict[tuple[str, str], str] = {
    ("cosim.errors", "cosim.run.result"): "SimulationError.result: what was recorded before a run failed",
    ("cosim.block", "cosim.run.online"): "Block.online",
    ("cosim.block", "cosim.control.control_system"): "Block.to_control",
    ("cosim.diagram.diagram", "cosim.control.control_system"): "Diagram.to_control",
    ("cosim.diagram.loop_methods", "cosim.control.linear_loop"): "Diagram.bode, Diagram.margins and the like",
    ("cosim.diagram.diagram", "cosim.diagram.schedule"): "Diagram.build",
    ("cosim.diagram.diagram", "cosim.run"): "Diagram.simulate, Diagram.start",
    ("cosim.diagram.subsystem", "cosim.run"): "Subsystem.online",
    ("cosim.isolation.worker", "cosim.fmi.fmu"): "FMU(isolate=True): the process of its own makes the block",
    ("cosim.run.result", "cosim.judging"): "Result.plot, Result.plot_signals, Result.animate",
    ("cosim.judging.probabilities", "cosim.judging.figures"): "Reliability.plot",
    ("cosim.fitting.fit", "monitoring.healthy"): "fit: the learner that weighs samples",
    ("scenario._files", "examples"): "scenario files by the name of an example",
    ("controllers.models.linear", "controllers.identification.identify"): "LinearModel.identify",
}
"""Upward imports: the module, the imported module or folder, and the public convenience that needs it."""

MOST_FILES = 15
MOST_ARGUMENTS = 12  # by position, without settings by keyword
LARGEST_CIRCLE = 3


def modules() -> dict[str, ast.Module]:
    """Return the syntax tree of each module by its name below ``bayesftc``; for a package, of its ``__init__``."""
    trees = {}
    for folder in (ROOT / "fmus", ROOT / "cosim", ROOT / "controllers", ROOT / "examples", ROOT / "src" / "bayesftc"):
        base = folder if folder.name == "bayesftc" else folder.parent
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(base).with_suffix("").parts
            if not (folder.name == "bayesftc" and (ROOT / parts[0]).is_dir()):
                trees[".".join(parts)] = ast.parse(path.read_text(encoding="utf-8"))
    return trees


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements below a node, which are a tenth of what `ast.walk` yields."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for statement in getattr(node, part, ()):
            yield statement
            yield from statements(statement)


def public(tree_of: dict[str, ast.Module]) -> dict[str, str]:
    """Return the module of each public name in a stub: ``cosim.FMU`` is in ``cosim.fmi.fmu``."""
    behind = {}
    for init in (name for name in tree_of if name.endswith(".__init__")):
        package = init.removesuffix(".__init__")
        for base in (ROOT, ROOT / "src" / "bayesftc"):
            stub = base / package.replace(".", "/") / "__init__.pyi"
            for node in statements(ast.parse(stub.read_text(encoding="utf-8"))) if stub.is_file() else ():
                if isinstance(node, ast.ImportFrom):
                    behind |= {f"{package}.{a.name}": f"{package}.{node.module or a.name}" for a in node.names}
    return behind


def imports(name: str, tree: ast.Module, known: dict[str, ast.Module], behind: dict[str, str]) -> Iterator[str]:
    """Yield the modules of this package that a module imports, in any form and at any place."""
    for node in statements(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").split(".")[0] == "bayesftc":
            wholes = [f"{node.module}.{alias.name}".removeprefix("bayesftc.") for alias in node.names]
        elif isinstance(node, ast.Import):
            wholes = [a.name.removeprefix("bayesftc.") for a in node.names if a.name.startswith("bayesftc.")]
        else:
            continue
        for whole in wholes:
            parent = whole.rpartition(".")[0]
            for target in (whole, behind.get(whole, ""), parent, f"{whole}.__init__", f"{parent}.__init__"):
                if target in known:
                    if target != name:
                        yield target
                    break


def floor(module: str) -> int:
    """Return the number of a module's floor, by the longest matching prefix in `FLOORS`."""
    module = module.removesuffix(".__init__")
    best = max(
        (name for level in FLOORS for name in level if module == name or module.startswith(name + ".")),
        key=len,
        default=None,
    )
    if best is None:
        raise LookupError(f"{module} has no floor. Add its folder to FLOORS of tools/floors.py.")
    return next(number for number, level in enumerate(FLOORS) if best in level)


def edges(known: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Return the modules that each module imports; a name from a stub or an ``__init__`` counts as its own module."""
    behind = public(known)
    return {name: set(imports(name, tree, known, behind)) for name, tree in known.items()}


def door(module: str, target: str) -> tuple[str, str] | None:
    """Return the door between two modules, if there is one."""
    return next((d for d in DOORS if d[0] == module and (target == d[1] or target.startswith(d[1] + "."))), None)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the sets of modules that import each other in a circle, the largest first (Tarjan, 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(v: str) -> None:
        index[v] = low[v] = len(index)
        stack.append(v)
        for w in sorted(graph.get(v, ())):
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in stack:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            at = stack.index(v)
            part = stack[at:]
            del stack[at:]
            if len(part) > 1:
                groups.append(sorted(part))

    for v in sorted(graph):
        if v not in index:
            visit(v)
    return sorted(groups, key=len, reverse=True)


WAY = (
    ("cosim.block", "Block", "ports and step functions"),
    ("cosim.diagram.diagram", "Diagram", "blocks, connections"),
    ("cosim.diagram.schedule", "Schedule", "order, memory, groups"),
    ("cosim.run.session", "Session", "FMUs opened, state, seed"),
    ("cosim.run.engines", "engine", "compiled, or plain Python"),
    ("cosim.run.result", "Result", "signals over time"),
    ("cosim.judging.roles", "LoopSignals", "goal, belief, faults"),
)
"""The way of a run through the package: module, name, and content."""

COLOURS = {"cosim": "#dbe9f6", "controllers": "#fde6c8", "fmus": "#e2efda"}


def draw(graph: dict[str, set[str]]) -> str:
    """Return a picture (SVG) of the floors, with the imports of each, and of the way of a run through them."""
    for k in range(1, len(WAY)):
        earlier, module = {name for name, *_ in WAY[:k]}, WAY[k][0]
        if not earlier & graph[module] and not any(module in graph[name] for name in earlier):
            raise LookupError(
                f"{module} and the modules before it do not import each other any more. Correct WAY of tools/floors.py."
            )
    of: dict[str, dict[str, int]] = {}
    present: set[str] = set()
    names = [name for level in FLOORS for name in level]

    def home(module: str) -> str:
        fits = (n for n in names if module.removesuffix(".__init__") == n or module.startswith(n + "."))
        return max(fits, key=len)

    for module, targets in graph.items():
        present.add(home(module))
        for target in targets:
            if home(target) != home(module) and not target.endswith(".__init__") and not door(module, target):
                counts = of.setdefault(home(module), {})
                counts[home(target)] = counts.get(home(target), 0) + 1
    width, row = 1120, 26
    rows = [name for level in reversed(FLOORS) for name in level if name in present]
    height = row * (len(rows) + 1) + 150
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        '<text x="10" y="18" font-weight="bold">folder</text>',
        '<text x="330" y="18" font-weight="bold">imports most from, all on lower floors</text>',
    ]
    for k, name in enumerate(rows):
        y = row * (k + 1)
        colour = COLOURS.get(name.split(".")[0], "#eeeeee")
        most = sorted(of.get(name, {}).items(), key=lambda item: (-item[1], item[0]))[:4]
        shown = ", ".join(sorted(target for target, _ in most))
        out.append(f'<rect x="5" y="{y}" width="310" height="{row - 3}" rx="4" fill="{colour}"/>')
        out.append(f'<text x="12" y="{y + 16}">{escape(name)}</text>')
        out.append(f'<text x="330" y="{y + 16}" fill="#444444">{escape(shown)}</text>')
    top, step = row * (len(rows) + 1) + 40, (width - 20) // len(WAY)
    out.append(f'<text x="10" y="{top - 10}" font-weight="bold">the way of a run</text>')
    for k, (module, title, holds) in enumerate(WAY):
        x = 8 + k * step
        out.append(f'<rect x="{x}" y="{top}" width="{step - 22}" height="64" rx="4" fill="#dbe9f6"/>')
        small = 'font-size="10"'
        for text, y, style in (
            (title, 18, 'font-weight="bold"'),
            (holds, 37, small),
            (module, 55, f'{small} fill="#666666"'),
        ):
            out.append(f'<text x="{x + 6}" y="{top + y}" {style}>{escape(text)}</text>')
        if k:
            out.append(f'<path d="M {x - 20} {top + 32} h 14 m -5 -4 l 5 4 l -5 4" stroke="#444444" fill="none"/>')
    return "\n".join([*out, "</svg>", ""])


PICTURE = ROOT / "docs" / "figures" / "floors.svg"


def main() -> None:
    """Print floors with their numbers of files, doors and circles, or draw the floors."""
    graph = edges(modules())
    if sys.argv[1:] == ["draw"]:
        PICTURE.write_text(draw(graph), encoding="utf-8")
        return
    folders: dict[str, int] = {}
    for name in graph:
        folders[name.rpartition(".")[0]] = folders.get(name.rpartition(".")[0], 0) + 1
    for number, level in reversed(list(enumerate(FLOORS))):
        print(f"{number:3}  " + ", ".join(f"{n} ({folders[n]})" if n in folders else n for n in level))
    for (module, target), reason in DOORS.items():
        print(f"door  {module} -> {target}: {reason}")
    for name, targets in sorted(graph.items()):
        for target in sorted(targets):
            if floor(target) > floor(name) and not door(name, target):
                print(f"UP    {name} -> {target}")
    inside = {name: {t for t in targets if not door(name, t)} for name, targets in graph.items()}
    for circle in circles(inside):
        print(f"circle of {len(circle)}: {', '.join(circle)}")
    for folder, files in folders.items():
        if files - 1 > MOST_FILES:
            print(f"full  {folder}: {files - 1} files")


if __name__ == "__main__":
    main()
