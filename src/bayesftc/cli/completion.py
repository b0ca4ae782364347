"""What the shell completes: names of shipped files, files of a kind, sections of files, blocks of a scenario.

A function is called at each Tab, so it reads names only: it builds no scenario and imports nothing slow by itself.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

import typer

LOOP = ("plant", "sensors", "controller")
"""Blocks of every scenario's loop."""


def scenarios(incomplete: str) -> list[str]:
    """Return shipped scenarios, and scenario files here."""
    from bayesftc.scenario._files import shipped_scenarios

    return [*_beginning(shipped_scenarios(), incomplete), *_files(incomplete, ".toml")]


def examples(incomplete: str) -> list[str]:
    """Return the names of all shipped files."""
    from bayesftc.scenario._files import KINDS, shipped_files

    return _beginning((name for kind in KINDS for name in shipped_files(kind)), incomplete)


def shipped_fmus(incomplete: str) -> list[str]:
    """Return shipped FMUs, and FMU and SSP files here."""
    from bayesftc import fmus

    return [*_beginning(fmus.names(), incomplete), *_files(incomplete, ".fmu", ".ssp", ".ssd")]


def kinds_of_files(incomplete: str) -> list[str]:
    """Return the kinds of files with keys."""
    from bayesftc.cli.commands.loops.keys import FILES

    return _beginning(FILES, incomplete)


def sections(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the sections of the kind of file that is named before."""
    from bayesftc.cli.commands.loops.keys import FILES, section_words

    titles = FILES.get(str(ctx.params.get("file")), {})
    return _beginning(dict.fromkeys(section_words(title)[0] for title in titles), incomplete)


def blocks(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the blocks of the scenario that is named before."""
    from bayesftc.scenario._files import shipped_scenarios

    # After an option without a value yet, the arguments before it are not parsed.
    name = str(ctx.params.get("scenario") or next(iter(ctx.args), ""))
    try:
        scenario = tomllib.loads(shipped_scenarios().get(name, Path(name)).read_text(encoding="utf-8"))
    except (OSError, ValueError):  # no file yet, or one that is no scenario
        return _beginning(LOOP, incomplete)
    further = scenario.get("blocks", {})
    return _beginning([*LOOP, *(further if isinstance(further, dict) else ())], incomplete)


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete: str, *endings: str) -> Iterator[str]:
    """Give the files with one of the endings, and the folders, that begin with a text."""
    folder, slash, begin = incomplete.rpartition("/")
    try:
        entries = sorted(Path(folder + slash or ".").iterdir())
    except OSError:
        return
    for entry in entries:
        hidden = entry.name.startswith(".") and not begin.startswith(".")
        if entry.name.startswith(begin) and not hidden:
            if entry.is_dir():
                yield f"{folder}{slash}{entry.name}/"
            elif entry.suffix.lower() in endings:
                yield f"{folder}{slash}{entry.name}"


__all__ = ["blocks", "examples", "kinds_of_files", "scenarios", "sections", "shipped_fmus"]
