"""``bayesftc run``: a scenario file to a table, a figure and files."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayesftc.cli import output
from bayesftc.cosim.errors import BayesFTCError, ModelError, SimulationError
from bayesftc.cosim.metrics import figures
from bayesftc.cosim.roles import LoopSignals, loop_signals
from bayesftc.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.diagram import Diagram
    from bayesftc.cosim.result import Result
    from bayesftc.cosim.simulation import Progress


def run_scenario(
    path: str, out: Path | None, options: Mapping[str, Any], *, check_kalman: bool, json: bool, quiet: bool
) -> None:
    """Run a scenario, print its figures and write its files.

    Parameters
    ----------
    path : str
        A scenario file or the name of a shipped scenario.
    out : pathlib.Path or None
        Folder for ``result.npz``, ``figure.png`` and ``figures.json``.
    options : mapping
        What is to differ from the file: ``seed``, ``duration``, ``engine``; None leaves it.
    check_kalman : bool
        Whether the belief is compared with filterpy's.
    json, quiet : bool
        How the figures are printed: as JSON, or not at all.
    """
    scenario = load_scenario(path)
    loop = scenario.loop()
    folder = None if out is None else output.prepare_folder(out)
    try:
        with _progress(shown=sys.stderr.isatty() and not quiet and not json) as progress:
            result = scenario.simulate(loop, progress=progress, **options)
    except SimulationError as error:
        if folder is not None and error.result is not None:
            report = _report(path, scenario, loop, error.result)
            output.write_files(folder, error.result, *report)
            raise SimulationError(f"{error} They are in {folder / output.RESULT}.", error.result) from error
        raise
    numbers, signals = _report(path, scenario, loop, result)
    if check_kalman:
        numbers["kalman"] = _kalman(scenario, loop, result)
    if folder is not None:
        output.write_files(folder, result, numbers, signals)
    if json:
        typer.echo(output.as_json(numbers))
    elif not quiet:
        output.print_report(numbers, folder)


def _report(path: str, scenario: Scenario, loop: Diagram, result: Result) -> tuple[dict[str, Any], LoopSignals]:
    """Return the numbers of a run as plain data, and its signals by their part in the loop."""
    from bayesftc import __version__

    signals = loop_signals(loop, result)
    numbers: dict[str, Any] = {
        "scenario": path,
        "bayesftc": __version__,
        **{name: result.metadata[name] for name in ("seed", "engine")},
        "duration": float(result.time[-1]) if len(result.time) else 0.0,
        "steps": max(len(result.time) - 1, 0) * result.decimation,
        "stopped": result.stopped,
        "units": {q.name: q.unit for q in signals.quantities},
        **figures(signals).to_dict(),
        "notes": _notes(scenario, signals),
    }
    return numbers, signals


def _notes(scenario: Scenario, signals: LoopSignals) -> list[str]:
    """Return sentences on what is missing from the figures and why."""
    why = getattr(getattr(scenario.controller, "precision", None), "why_no_probability", None)
    notes = [f"There is no fault probability: {why}"] if why else []
    for quantity in signals.quantities:
        if quantity.truth is None or quantity.belief is None:
            notes.append(
                f"The signals of {quantity.name} were not all recorded; take 'record' out of the scenario for all figures."
            )
        elif quantity.reference is None:
            notes.append(f"{quantity.name} has no tracking error: no element of the goal is for it.")
    if signals.faulty is None:
        notes.append("When faults were present was not recorded, so nothing can be said of their detection.")
    if not signals.quantities:
        notes.append(
            "What the sensors measure is a function of the plant's outputs, so true values are not known here."
        )
    return notes


def _kalman(scenario: Scenario, loop: Diagram, result: Result) -> dict[str, Any]:
    from bayesftc.controllers import BayesianController
    from bayesftc.controllers.validation import check_kalman

    if not isinstance(scenario.controller, BayesianController):
        raise ModelError(
            f"--check-kalman needs a BayesianController, not a {type(scenario.controller).__name__}; leave it out."
        )
    brain = loop["controller"]
    source = loop.source_of(brain, brain.block.port("y"), 0)
    name = None if source is None else f"{source[0].node.name}.{source[0].port.name}"
    try:
        return asdict(check_kalman(result, scenario.controller, y=name))
    except BayesFTCError as error:
        raise type(error)(f"--check-kalman: {error}") from None


@contextmanager
def _progress(shown: bool) -> Iterator[Progress | None]:
    """Give a function that moves a progress bar on stderr, or None."""
    if not shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("Preparing", total=None)  # the first run of a kind of loop is compiled, for some seconds
        yield lambda step, steps: bar.update(task, description="Simulating", completed=step, total=steps)
