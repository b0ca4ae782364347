"""Start-up and compilation, in separate processes with separate cache folders."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from bayesftc.bench._child import ChildError, Finished, run_code, run_python
from bayesftc.bench._figures import Figure, Section

_REPORT = """
import json
from bayesftc.cosim.stepping.kept import STATISTICS
print(json.dumps(STATISTICS))
"""

SCENARIO = f"""
from bayesftc.scenario import load_scenario
steps = len(load_scenario("cruise_control").simulate(duration=20.0).time) - 1
if steps != 1000:
    raise SystemExit(f"The shipped scenario made {{steps}} steps.")
{_REPORT}"""
"""20 s of the shipped scenario: 1,000 steps."""

OTHER_DIAGRAM = f"""
from bayesftc.bench.measures.plain_loop import engine_loop
engine_loop()(1000)
{_REPORT}"""
"""A diagram with a block that the scenario does not have."""


def measure(quick: bool = False) -> Section:
    """Measure the first run with an empty cache, a second diagram, and then starts with the filled cache."""
    cold = []
    with ExitStack() as stack:
        for _ in range(1 if quick else 3):
            folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            cold.append(_first_runs(folder))
        cache = {"BAYESFTC_CACHE": folder}
        commands = {
            "python": lambda: run_python(["-c", "pass"]),
            "import": lambda: run_python(["-c", "import bayesftc"]),
            "help": lambda: run_python(["-m", "bayesftc", "--help"]),
            "scenario": lambda: run_code(SCENARIO, cache),
        }
        rounds: list[dict[str, Finished | str]] = [
            {name: _attempt(command) for name, command in commands.items()} for _ in range(1 if quick else 7)
        ]

    def starts(key: str, label: str, at_most: float | None = None) -> Figure:
        return _seconds(key, label, [r[key] for r in rounds], at_most)

    compiled = "functions compiled by that process"
    firsts, seconds = [c[0] for c in cold], [c[1] for c in cold]
    return Section(
        "startup",
        "Start-up and compilation (whole processes)",
        (
            starts("python", "bare Python"),
            starts("import", "import bayesftc", 0.5),
            starts("help", "bayesftc --help", 1.0),
            starts("scenario", "shipped scenario, 1,000 steps, compiled code from the cache", 3.0),
            _count("scenario_compiled", compiled, [r["scenario"] for r in rounds], "compiled", 0),
            _seconds("first_run", "the same with an empty cache", firsts),
            _count("first_compiled", compiled, firsts, "compiled"),
            _count("first_engine", "parts of the engine among them", firsts, "engine"),
            _count("second_compiled", "functions compiled by a second, different diagram", seconds, "compiled"),
            _count("second_engine", "parts of the engine among them", seconds, "engine", 0),
        ),
    )


def _first_runs(folder: str) -> tuple[Finished | str, Finished | str]:
    """Run the scenario and then another diagram, with an empty folder as the cache."""
    cache = {"BAYESFTC_CACHE": folder}
    first = _attempt(lambda: run_code(SCENARIO, cache))
    before = _engine_files(folder)
    if isinstance(first, Finished):
        first.value["engine"] = len(before)
    second = _attempt(lambda: run_code(OTHER_DIAGRAM, cache))
    if isinstance(second, Finished):
        second.value["engine"] = len(_engine_files(folder) - before)
    return first, second


def _engine_files(folder: str) -> set[str]:
    """Return the names of the engine's parts: machine code from our compiler (service), and from numba (engine)."""
    names = (path.name for path in Path(folder).rglob("*_*") if path.suffix in {".o", ".nbc"})
    return {name for name in names if name.startswith(("service_", "engine_"))}


def _attempt(command: Callable[[], Finished]) -> Finished | str:
    try:
        return command()
    except ChildError as error:
        return str(error)


def _reason(outcomes: list[Finished | str]) -> str | None:
    return next((o for o in outcomes if isinstance(o, str)), None)


def _seconds(key: str, label: str, outcomes: list[Finished | str], at_most: float | None = None) -> Figure:
    samples = [o.seconds for o in outcomes if isinstance(o, Finished)]
    return Figure(key, label, "s", samples, at_most=at_most, reason=_reason(outcomes))


def _count(key: str, label: str, outcomes: list[Finished | str], what: str, at_most: float | None = None) -> Figure:
    samples = [float(o.value[what]) for o in outcomes if isinstance(o, Finished)]
    return Figure(key, label, "", samples, at_most=at_most, reason=_reason(outcomes))
