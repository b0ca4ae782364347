"""Options and arguments that several commands have."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bayesftc.cli.completion import scenarios
from bayesftc.cosim.errors import BayesFTCError

Timing = StrEnum("Timing", ["plant", "sampled"])
"""The instant that the outputs of an FMU belong to."""

Json = Annotated[bool, typer.Option("--json", help="Print plain JSON instead of tables.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only warnings and errors.")]
AScenario = Annotated[
    str, typer.Argument(help="A scenario file, or the name of a shipped one.", autocompletion=scenarios)
]
Duration = Annotated[float | None, typer.Option(help="Seconds, instead of the scenario's.")]
Seed = Annotated[int | None, typer.Option(help="Seed of all noise, instead of the scenario's.")]
RunFolder = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write result.npz, figure.png and figures.json there.")
]
Store = Annotated[Path, typer.Argument(help="The folder of a campaign's results.")]
RecordFolder = Annotated[
    Path | None, typer.Option("--record", metavar="DIR", help="Record all signals there, in pieces (Parquet).")
]
LiveDuration = Annotated[float | None, typer.Option(help="Seconds; by default until it is stopped.")]


def check_numbers(*, duration: float | None = None, seed: int | None = None, pace: float | None = None) -> None:
    """Refuse numbers that no scenario accepts, before one is read: that may take seconds, if its controller is designed.

    Raises
    ------
    StepSizeError, ModelError
        If a number is out of its range. Whether the duration is a whole number of steps is not checked.
    """
    from bayesftc.cosim.base.timebase import exact_duration
    from bayesftc.cosim.random import check_seed
    from bayesftc.cosim.run.pacing import check_pace

    if duration is not None:
        exact_duration(duration, "The duration")
    if seed is not None:
        check_seed(seed)
    if pace is not None:
        check_pace(pace)


def as_invalid(given: Sequence[str]) -> dict[str, list[float | str]]:
    """Return the values of the option --invalid by column: ``0`` or ``Bad Input`` holds for all, ``lidar=0`` for one."""
    values: dict[str, list[float | str]] = {}
    for text in given:
        name, _, value = (part.strip() for part in text.rpartition("="))
        if not value:
            raise typer.BadParameter(
                f"{text!r} has no value. Write --invalid 0 for all columns, or --invalid lidar=0 for the column lidar.",
                param_hint="--invalid",
            )
        try:
            values.setdefault(name, []).append(float(value))
        except ValueError:
            values.setdefault(name, []).append(value)
    return values


@contextmanager
def by_options(**options: str) -> Iterator[None]:
    """Give errors of a Python function inside the names of options in place of those of arguments.

    Parameters
    ----------
    **options : str
        Name of an argument -> its option: ``time="--time"`` makes ``--time ...`` of ``time=...``.
    """
    try:
        yield
    except BayesFTCError as error:
        text = str(error)
        for name, option in options.items():
            text = re.sub(rf"\b{name}= ?", f"{option} ", text)
        error.args = (text, *error.args[1:])
        raise
