"""``bayesftc verify``: an FMU beside the blocks of a scenario that it stands for, and in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.export.verification import Deviation, Verification

DIFFERS = 19
"""Exit code where the FMU does not do what the blocks do."""


def verify_scenario(
    fmu: Path,
    name: str,
    blocks: Sequence[str],
    *,
    duration: float | None,
    seed: int | None,
    tolerance: float,
    timing: Literal["plant", "sampled"] | None,
    isolate: bool,
    json: bool,
    quiet: bool,
) -> None:
    """Compare an FMU with blocks of a scenario and print the differences; leave with `DIFFERS` where they are too large.

    Parameters
    ----------
    fmu : pathlib.Path
        The FMU.
    name : str
        A scenario file or the name of a shipped scenario.
    blocks : sequence of str
        The blocks that the FMU stands for; none for what it says.
    duration, seed : float, int, optional
        Instead of the scenario's.
    tolerance : float
        The largest difference that is none, by the largest value of the signal.
    timing : {"plant", "sampled"}, optional
        When the FMU's outputs hold; by default what it says.
    isolate : bool
        Run the FMU in a process of its own.
    json, quiet : bool
        How it is printed: as JSON, or not at all.
    """
    from bayesftc.cosim.export.verification import verify_fmu

    if not (isfinite(tolerance) and tolerance >= 0.0):
        raise ModelError(f"--tolerance is {tolerance!r}; it must be a number that is not negative.")
    scenario = load_scenario(name)
    own = scenario.simulation
    found = verify_fmu(
        expanded(fmu),
        scenario.loop(),
        list(blocks) or None,
        duration=own.duration if duration is None else duration,
        seed=own.seed if seed is None else seed,
        timing=timing,
        isolate=isolate,
        engine=own.engine,
    )
    if json:
        from bayesftc.cli.output import as_json

        typer.echo(as_json(_plain(found, name, tolerance)))
    elif not quiet:
        _print(found, name, tolerance)
    if not found.agrees(tolerance):
        raise typer.Exit(DIFFERS)


def _plain(found: Verification, name: str, tolerance: float) -> dict[str, Any]:
    def table(deviations: Sequence[Deviation]) -> dict[str, Any]:
        return {d.signal: {key: value for key, value in asdict(d).items() if key != "signal"} for d in deviations}

    return {
        "fmu": str(found.path),
        "scenario": name,
        "blocks": list(found.blocks),
        "steps": found.steps,
        "step": str(found.step),
        "seed": found.seed,
        "tolerance": tolerance,
        "agrees": found.agrees(tolerance),
        "verdict": found.verdict(tolerance),
        "beside": table(found.beside),
        "in_loop": None if found.in_loop is None else table(found.in_loop),
        "notes": list(found.notes),
    }


def _print(found: Verification, name: str, tolerance: float) -> None:
    steps = f"{found.steps} step" + ("" if found.steps == 1 else "s")
    typer.echo(f"{found.path.name} beside {', '.join(found.blocks)} of {name}, {steps}, seed {found.seed}\n")
    typer.echo(found.report(tolerance))
