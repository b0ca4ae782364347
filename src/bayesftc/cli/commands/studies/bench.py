"""``bayesftc bench``: measure speed, start-up, memory and compilation on this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc import bench as benchmarks
from bayesftc.cli.options import Json


def bench(
    section: Annotated[
        list[str] | None, typer.Argument(help="What to measure, such as campaign or export; by default everything.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few and short repetitions: a check that all works, not a measurement.")
    ] = False,
    json: Json = False,
) -> None:
    """Make the measurements and print them."""
    benchmarks.main(json=json, quick=quick, sections=section or benchmarks.SECTIONS)
