"""Options and arguments that several commands have."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

Timing = StrEnum("Timing", ["plant", "sampled"])
"""The instant that the outputs of an FMU belong to."""

Json = Annotated[bool, typer.Option("--json", help="Print plain JSON instead of tables.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only warnings and errors.")]
AScenario = Annotated[str, typer.Argument(help="A scenario file, or the name of a shipped one.")]
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
