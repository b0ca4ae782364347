"""``bayesftc example``: print the shipped files that commands read."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cli import completion, output
from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.scenario._files import KINDS, shipped_files, use_of, used_with


def example(
    name: Annotated[
        str | None,
        typer.Argument(help="A shipped file; without a name all are listed.", autocompletion=completion.examples),
    ] = None,
) -> None:
    """Print a shipped file's text, or the names, kinds and uses of all.

    Files that are used together are named on stderr.
    """
    shipped = {kind: shipped_files(kind) for kind in KINDS}
    every = {file_name: file for files in shipped.values() for file_name, file in files.items()}
    if name is None:
        widest = [max(map(len, names)) for names in (every, KINDS)]
        for kind, files in shipped.items():
            for file_name, file in files.items():
                use = use_of(kind, file_name, file)
                typer.echo(f"{file_name:{widest[0]}}  {kind:{widest[1]}}  {use}")
        groups = {tuple(sorted([file_name, *others])) for file_name in every if (others := used_with(file_name))}
        for group in sorted(groups):
            commands = "\n".join(f"  bayesftc example {file_name} > {every[file_name].name}" for file_name in group)
            typer.echo(
                f"\n{', '.join(every[each].name for each in group)} are used together, all in one folder:\n{commands}"
            )
        return
    if name not in every:
        raise ScenarioError(f"There is no shipped file {name!r}; {did_you_mean(name, every)}")
    typer.echo(every[name].read_text(encoding="utf-8"), nl=False)
    if others := used_with(name):
        commands = ", ".join(f"bayesftc example {other} > {every[other].name}" for other in others)
        output.say_notes([f"{every[name].name} is used together with other files, all in one folder: {commands}."])
