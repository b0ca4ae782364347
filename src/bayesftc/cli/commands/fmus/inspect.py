"""``bayesftc inspect``: an FMU's description, and what works with it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc.cli import completion, output
from bayesftc.cli.inspection.elements import COLUMNS, rows
from bayesftc.cli.inspection.verdicts import Verdict, verdicts
from bayesftc.cli.options import Json
from bayesftc.cosim.base.paths import exists, expanded
from bayesftc.cosim.errors import FMUError, did_you_mean
from bayesftc.cosim.fmi.fmu import describe

if TYPE_CHECKING:
    from rich.console import Console

    from bayesftc.cosim.fmi.fmu import FMUDescription

KINDS = {
    "coSimulation": "co-simulation",
    "modelExchange": "model exchange",
    "scheduledExecution": "scheduled execution",
}
STYLES = {"yes": "green", "no": "red", "partly": "yellow"}
ORDER = ("input", "output", "parameter", "structuralParameter", "calculatedParameter", "local", "independent")

LEAST = 30
"""Least width of the columns after those that are never broken: start and description."""

EMPTIABLE = frozenset({"unit", "start", "description"})
"""Columns that are left out if they are empty."""

OTHER_COMMANDS = {
    ".csv": ("a table of samples", "bayesftc monitor {} --fit"),
    ".toml": ("a scenario, a campaign or a model of a monitor", "bayesftc run {}"),
}
"""What a file with this ending is, and the command that reads it."""


def inspect(
    fmu: Annotated[
        str,
        typer.Argument(
            help="An FMU or SSP file, or the name of a shipped FMU, as CruiseControl.",
            autocompletion=completion.shipped_fmus,
        ),
    ],
    validate: Annotated[bool, typer.Option(help="Whether the description must follow the rules of FMI.")] = True,
    everything: Annotated[
        bool, typer.Option("--all", help="Show local variables as well, and each element of arrays.")
    ] = False,
    json: Json = False,
) -> None:
    """Print tables (or JSON) of the description and of what works."""
    if Path(fmu).suffix.lower() in {".ssp", ".ssd"}:
        from bayesftc.cli.inspection.ssp import inspect_ssp

        inspect_ssp(expanded(fmu), validate=validate, json=json)
        return
    path = find_fmu(fmu)
    _refuse_other_files(path)
    description = describe(path, validate=validate)
    works = verdicts(path, description, validate=validate)
    if json:
        table = {v.what: {"works": v.works, "how": v.how} for v in works}
        typer.echo(output.as_json({"path": str(path), **_plain(asdict(description)), "works": table}))
        return
    _print(path, description, works, everything)


def _refuse_other_files(path: Path) -> None:
    """Raise FMUError for a file of another command."""
    command = OTHER_COMMANDS.get(path.suffix.lower())
    if command is not None and path.is_file():
        raise FMUError(f"{path} is {command[0]}, not an FMU. Use:  {command[1].format(path)}")


def find_fmu(name: str) -> Path:
    """Return the FMU's path, given a path or the name of a shipped FMU."""
    from bayesftc import fmus

    path = expanded(name)
    if exists(path) or path.suffix.lower() == ".fmu" or path.name != name:
        return path
    if name not in fmus.names():
        raise FMUError(f"There is no file {name!r} and no shipped FMU of this name; {did_you_mean(name, fmus.names())}")
    return fmus.path(name)


def _print(path: Path, description: FMUDescription, works: list[Verdict], everything: bool) -> None:
    from rich.table import Table
    from rich.text import Text

    console = output.terminal()
    facts = Table(box=None, show_header=False, pad_edge=False)
    facts.add_column(style="bold", no_wrap=True)
    facts.add_column(overflow="fold")
    for label, value in _facts(path, description):
        facts.add_row(label, Text(value))
    console.print(facts)
    console.print()
    table = output.plain_table("what works", "", "how, or why not")
    for verdict in works:
        table.add_row(Text(verdict.what), Text(verdict.works, style=STYLES[verdict.works]), Text(verdict.how))
    console.print(table)
    _print_variables(console, description, everything)


def _print_variables(console: Console, description: FMUDescription, everything: bool) -> None:
    from rich.text import Text

    shown = [v for v in description.variables if everything or v.causality in ORDER[:5]]
    ranked = sorted(shown, key=lambda v: ORDER.index(v.causality) if v.causality in ORDER else len(ORDER))
    texts = rows(ranked, apart=everything)
    types = {row[COLUMNS.index("type")] for row in texts}
    # Columns that no variable fills, or that are all the same, leave their width to the descriptions.
    dropped = {"type"} if len(types) == 1 < len(texts) else set()
    dropped |= {name for i, name in enumerate(COLUMNS) if name in EMPTIABLE and not any(row[i] for row in texts)}
    filled = [i for i, name in enumerate(COLUMNS) if name not in dropped]
    columns, texts = [COLUMNS[i] for i in filled], [tuple(row[i] for i in filled) for row in texts]
    whole = [name for name in columns if name in COLUMNS[:4]]
    table = output.plain_table(*columns, right={"start"}, whole=whole)
    for row in texts:
        table.add_row(*map(Text, row))
    kept = len(whole)
    needed = sum(
        2 + max(map(len, column)) for column in zip(columns[:kept], *(row[:kept] for row in texts), strict=True)
    )
    # Long names make the table wider than the terminal, so that the columns beside them keep some width.
    console.width = max(console.width, needed + LEAST)
    console.print(table)
    if "type" in dropped:
        console.print(f"All are of the type {types.pop()}.")
    hidden = len(description.variables) - len(shown)
    if hidden:
        console.print(f"{hidden} more (time and local variables): --all shows them.")
    elif len(texts) < len(shown):
        console.print("--all shows each element.")


def _facts(path: Path, description: FMUDescription) -> list[tuple[str, str]]:
    experiment = ", ".join(f"{name} {value:g}" for name, value in description.default_experiment.items())
    capabilities = ", ".join(
        name if value is True else f"{name} {value}" for name, value in description.capabilities.items() if value
    )
    entries = [
        ("model", description.name),
        ("file", str(path)),
        ("description", description.description),
        ("FMI", description.fmi_version),
        ("kinds", ", ".join(KINDS.get(kind, kind) for kind in description.kinds)),
        ("platforms", ", ".join(description.platforms) or "none: it has no binaries"),
        ("capabilities", capabilities or "none"),
        ("default experiment", experiment),
        ("made by", description.generation_tool),
        ("timing", description.timing),
        ("stands for", _stands_for(description)),
        ("direct feedthrough", _feedthrough(description)),
    ]
    return [(label, value) for label, value in entries if value]


def _stands_for(description: FMUDescription) -> str:
    """Return from which blocks of a diagram the FMU was exported."""
    if not description.blocks:
        return ""
    blocks = "block" if len(description.blocks) == 1 else "blocks"
    return f"{', '.join(description.blocks)} (bayesftc verify runs it beside the {blocks})"


def _feedthrough(description: FMUDescription) -> str:
    """Return which outputs depend at the same instant on which inputs."""
    if not any(v.causality == "input" for v in description.variables):
        return "none"
    if description.timing == "sampled":
        return "within a step: its outputs belong to the beginning of the step, and take all inputs of that time"
    lines = [
        f"{output} <- {'any input (not stated)' if inputs is None else ', '.join(inputs)}"
        for output, inputs in description.feedthrough.items()
        if inputs != ()
    ]
    return "; ".join(lines) or "none"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items() if key not in {"token", "log_categories"}}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
