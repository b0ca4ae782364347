"""``bayesftc verify``: run an FMU beside the scenario's blocks that it replaces, and in their place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc.cli import output
from bayesftc.cli.options import Duration, Json, Quiet, Seed, Timing, check_numbers
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.export.verification import Deviation, Verification

DIFFERS = 19
"""Exit code if the FMU's outputs differ from the blocks'."""


def verify(
    fmu: Annotated[Path, typer.Argument(help="An FMU from bayesftc export, or from any tool with the same names.")],
    against: Annotated[
        str, typer.Option(metavar="SCENARIO", help="The scenario with the blocks that the FMU replaces.")
    ],
    block: Annotated[
        list[str] | None,
        typer.Option(
            "--block", "-b", help="The block that the FMU replaces; by default the one that it was exported from."
        ),
    ] = None,
    duration: Duration = None,
    seed: Seed = None,
    tolerance: Annotated[
        float,
        typer.Option(
            help="Largest difference, relative to the largest value of a signal. With 0, all numbers must be equal. 1e-9 is "
            "usual for FMUs of other tools, which use the exp, log and sin of a C library."
        ),
    ] = 0.0,
    timing: Annotated[Timing | None, typer.Option(help="The FMU's timing; by default from its description.")] = None,
    isolate: Annotated[bool, typer.Option("--isolate", help="Run the FMU in a process of its own.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare an FMU with blocks of a scenario, print the differences, and exit with `DIFFERS` if they are too large."""
    from bayesftc.cosim.export.verification import verify_fmu

    if not (isfinite(tolerance) and tolerance >= 0.0):
        raise ModelError(f"--tolerance is {tolerance!r}. It must be finite and not negative.")
    check_numbers(duration=duration, seed=seed)
    scenario = load_scenario(against)
    defaults = scenario.simulation
    with _remedies_of_options():
        verification = verify_fmu(
            expanded(fmu),
            scenario.loop(),
            block or None,
            duration=defaults.duration if duration is None else duration,
            seed=defaults.seed if seed is None else seed,
            timing=timing.value if timing else None,  # type: ignore[arg-type]
            isolate=isolate,
            engine=defaults.engine,
        )
    if json:
        typer.echo(output.as_json(_plain(verification, against, tolerance)))
    elif not quiet:
        _print(verification, against, tolerance)
    if not verification.agrees(tolerance):
        raise typer.Exit(DIFFERS)


@contextmanager
def _remedies_of_options() -> Iterator[None]:
    """Give errors the options of the command in place of arguments in Python."""
    from bayesftc.cosim.export.stand_in import NAME_IT

    try:
        yield
    except ModelError as error:
        if NAME_IT not in str(error):
            raise
        raise ModelError(str(error).replace(NAME_IT, "Name it by --block")) from error


def _plain(verification: Verification, name: str, tolerance: float) -> dict[str, Any]:
    def table(deviations: Sequence[Deviation]) -> dict[str, Any]:
        return {d.signal: {key: value for key, value in asdict(d).items() if key != "signal"} for d in deviations}

    return {
        "fmu": str(verification.path),
        "scenario": name,
        "blocks": list(verification.blocks),
        "steps": verification.steps,
        "step": str(verification.step),
        "seed": verification.seed,
        "tolerance": tolerance,
        "agrees": verification.agrees(tolerance),
        "verdict": verification.verdict(tolerance),
        "beside": table(verification.beside),
        "in_loop": None if verification.in_loop is None else table(verification.in_loop),
        "notes": list(verification.notes),
    }


def _print(verification: Verification, name: str, tolerance: float) -> None:
    steps = f"{verification.steps} step" + ("" if verification.steps == 1 else "s")
    typer.echo(
        f"{verification.path.name} beside {', '.join(verification.blocks)} of {name}, {steps}, seed {verification.seed}\n"
    )
    typer.echo(verification.report(tolerance))
