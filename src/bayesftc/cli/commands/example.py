"""``bayesftc example``: the shipped files that commands read."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.scenario._files import KINDS, shipped_files

USES = {
    "scenario": "bayesftc run {name}",
    "campaign": "bayesftc campaign {file}",
    "monitor's model": "bayesftc monitor . --model {file}",
    "recording": "bayesftc monitor . --model model.toml",
}
"""What a user does with a file of each kind, once it is printed into the current folder."""


def example(
    name: Annotated[str | None, typer.Argument(help="A shipped file; without a name they are listed.")] = None,
) -> None:
    """Print a shipped file's text, or the names, kinds and uses of all."""
    shipped = {kind: shipped_files(kind) for kind in KINDS}
    every = {known: file for files in shipped.values() for known, file in files.items()}
    if name is None:
        widest = [max(map(len, names)) for names in (every, KINDS)]
        for kind, files in shipped.items():
            for known, file in files.items():
                use = USES[kind].format(name=known, file=file.name)
                typer.echo(f"{known:{widest[0]}}  {kind:{widest[1]}}  {use}")
        return
    if name not in every:
        raise ScenarioError(f"No example {name!r} is shipped; {did_you_mean(name, every)}")
    typer.echo(every[name].read_text(encoding="utf-8"), nl=False)
