"""``bayesftc example``: print the shipped files that commands read."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.scenario._files import KINDS, shipped_files, use_of


def example(
    name: Annotated[str | None, typer.Argument(help="A shipped file; without a name all are listed.")] = None,
) -> None:
    """Print a shipped file's text, or the names, kinds and uses of all."""
    shipped = {kind: shipped_files(kind) for kind in KINDS}
    every = {file_name: file for files in shipped.values() for file_name, file in files.items()}
    if name is None:
        widest = [max(map(len, names)) for names in (every, KINDS)]
        for kind, files in shipped.items():
            for file_name, file in files.items():
                use = use_of(kind, file_name, file)
                typer.echo(f"{file_name:{widest[0]}}  {kind:{widest[1]}}  {use}")
        return
    if name not in every:
        raise ScenarioError(f"There is no shipped file {name!r}; {did_you_mean(name, every)}")
    typer.echo(every[name].read_text(encoding="utf-8"), nl=False)
