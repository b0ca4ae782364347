"""``bayesftc example``: the shipped scenarios."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.scenario._files import shipped_scenarios


def example(
    name: Annotated[str | None, typer.Argument(help="A shipped scenario; without a name they are listed.")] = None,
) -> None:
    """Print a shipped scenario's text, or the names of all."""
    shipped = shipped_scenarios()
    if name is None:
        for known in shipped:
            typer.echo(known)
        return
    if name not in shipped:
        raise ScenarioError(f"No scenario {name!r} is shipped; {did_you_mean(name, shipped)}")
    typer.echo(shipped[name].read_text(encoding="utf-8"), nl=False)
