"""``bayesftc verify``: an FMU beside the blocks of a scenario that it stands for, and in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc.cli import output
from bayesftc.cli.options import Duration, Json, Quiet, Seed, Timing
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.export.verification import Deviation, Verification

DIFFERS = 19
"""Exit code where the FMU does not do what the blocks do."""


def verify(
    fmu: Annotated[Path, typer.Argument(help="An FMU, of bayesftc export or of any tool with the same names.")],
    against: Annotated[
        str, typer.Option(metavar="SCENARIO", help="The scenario whose blocks it is to do the work of.")
    ],
    block: Annotated[
        list[str] | None,
        typer.Option(
            "--block", "-b", help="The block that it stands for; by default the one that it was exported from."
        ),
    ] = None,
    duration: Duration = None,
    seed: Seed = None,
    tolerance: Annotated[
        float,
        typer.Option(
            help="Largest difference, by the largest value of a signal. 0: the same numbers; 1e-9 is usual where exp, log or "
            "sin come from another C library."
        ),
    ] = 0.0,
    timing: Annotated[Timing | None, typer.Option(help="When its outputs hold; by default what it says.")] = None,
    isolate: Annotated[bool, typer.Option("--isolate", help="Run the FMU in a process of its own.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare an FMU with blocks of a scenario and print the differences; leave with `DIFFERS` where they are too large."""
    from bayesftc.cosim.export.verification import verify_fmu

    if not (isfinite(tolerance) and tolerance >= 0.0):
        raise ModelError(f"--tolerance is {tolerance!r}; it must be a number that is not negative.")
    scenario = load_scenario(against)
    own = scenario.simulation
    found = verify_fmu(
        expanded(fmu),
        scenario.loop(),
        block or None,
        duration=own.duration if duration is None else duration,
        seed=own.seed if seed is None else seed,
        timing=timing.value if timing else None,  # type: ignore[arg-type]
        isolate=isolate,
        engine=own.engine,
    )
    if json:
        typer.echo(output.as_json(_plain(found, against, tolerance)))
    elif not quiet:
        _print(found, against, tolerance)
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
