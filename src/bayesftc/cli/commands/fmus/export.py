"""``bayesftc export``: write blocks of a scenario's loop as an FMU or as C."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesftc.cli import completion, output
from bayesftc.cli.options import AScenario, Quiet, Timing
from bayesftc.cosim.diagram.diagram import is_external
from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.fmi.fmu import FMU

SHOWN = 14
"""Ports of a side that are printed one by one."""


Form = StrEnum("Form", ["fmu", "c"])


def export(
    scenario: AScenario,
    block: Annotated[
        list[str] | None,
        typer.Option(
            "--block",
            "-b",
            help="A block of the scenario's loop, such as controller; repeat the option for several, which become one.",
            show_default=False,
            autocompletion=completion.blocks,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FILE", help="The FMU, or the folder for C. By default named after the block."
        ),
    ] = None,
    form: Annotated[Form, typer.Option("--format", help="An FMU, or C without FMI for firmware.")] = Form.fmu,
    fmi: Annotated[
        str | None, typer.Option(help="Version of FMI: 2.0 (the default) or 3.0.", show_default=False)
    ] = None,
    platform: Annotated[
        list[str] | None,
        typer.Option(
            help="Platform of the binary, such as windows-x86_64, or all; repeatable. By default this machine's."
        ),
    ] = None,
    timing: Annotated[
        Timing | None, typer.Option(help="The FMU's timing; by default the one that fits the block.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write blocks of a scenario as an FMU or as C, and print what was written."""
    from bayesftc.cosim.export.exporting import c_folder, export_c, export_fmu, fmu_file
    from bayesftc.cosim.export.platforms import platforms_of

    if form is Form.c:
        given = [option for option, value in (("--fmi", fmi), ("--platform", platform), ("--timing", timing)) if value]
        if given:
            raise ModelError(
                f"{' and '.join(given)} cannot be used with --format c, because C is written without FMI. Leave it out."
            )
    if out is not None:
        target = c_folder(out) if form is Form.c else fmu_file(out).parent
        output.check_folder(target, (), silent=True)
    platforms_of(platform or None)
    loaded = load_scenario(scenario)
    loop = loaded.loop()
    if not block:
        raise typer.BadParameter(f"name what to export, such as --block controller; {scenario} has {_blocks_of(loop)}.")
    chosen = list(dict.fromkeys(loop[name].name for name in block))
    if form is Form.c:
        folder, name = out or Path(), _stem(scenario, chosen)
        if not quiet:
            output.note_replaced(folder / f"{name}.{end}" for end in "ch")
        source, header = export_c(loop, folder, name=name, blocks=chosen)
        if not quiet:
            typer.echo(
                f"{source} and {header.name}: {source.stem}_init, {source.stem}_step; {header.name} explains their use."
            )
            typer.echo(f"Try:  cc -std=c99 -O2 -c {quote(str(source))}")
        return
    path = out or Path(f"{_stem(scenario, chosen)}.fmu")
    if not quiet:
        output.note_replaced([path])
    options: dict[str, Any] = {
        "fmi": {None: "2.0", "2": "2.0", "3": "3.0"}.get(fmi, fmi),
        "timing": timing and timing.value,
        "platforms": platform or None,
        "stop_time": float(Fraction(loaded.simulation.duration)),
    }
    about = f"{', '.join(chosen)} of the scenario {Path(scenario).name}"
    path = export_fmu(loop, path, blocks=chosen, description=f"{about[0].upper()}{about[1:]}", **options)
    if not quiet:
        _report(path)
        typer.echo(f"Try:  bayesftc verify {quote(str(path))} --against {quote(scenario)}")


def _blocks_of(loop: Diagram) -> str:
    """Return the names of the blocks that can be exported."""
    *names, last = (node.name for node in loop.nodes if not is_external(node))
    return f"{', '.join(names)} and {last}" if names else last


def _stem(name: str, blocks: Sequence[str]) -> str:
    return blocks[0] if len(blocks) == 1 else Path(name).stem


def _report(path: Path) -> None:
    """Print a summary of an FMU, read from the file."""
    from bayesftc.cosim.fmi.fmu import FMU

    fmu = FMU(path)
    description = fmu.description
    typer.echo(
        f"{path}: FMI {description.fmi_version}, {path.stat().st_size / 1000:.0f} kB, for {', '.join(description.platforms)}"
    )
    typer.echo(f"inputs   {_listed(fmu.inputs)}")
    typer.echo(f"outputs  {_listed(fmu.outputs)}")
    tunable = [v for v in description.variables if v.causality == "parameter" and v.variability == "tunable"]
    if tunable:
        typer.echo(f"tunable  {_some([f'{v.name}{_measured(v.unit)}' for v in tunable])}")
    typer.echo(f"step     {description.default_experiment['stepSize']:g} s, fixed")
    typer.echo(f"timing   {_timing(fmu)}")


def _timing(fmu: FMU) -> str:
    if fmu.timing == "sampled":
        return "sampled: the outputs after a step are those of the inputs at its beginning"
    return "plant: the outputs after a step are those at its end"


def _listed(ports: Any) -> str:
    """Return ports with their units. The elements of an array, separate variables in FMI 2, are shown as one."""
    sizes: dict[str, str] = {}
    units: dict[str, list[str]] = {}
    for port in ports:
        whole, bracket, index = port.name.partition("[")
        size = [int(i) + 1 for i in index.rstrip("]").split(",")] if bracket else list(port.shape)
        sizes[whole] = f" ({'x'.join(map(str, size))})" if size else ""
        units.setdefault(whole, []).append(port.unit or "no unit")
    measured = {
        name: _measured(", ".join(dict.fromkeys(each)) if {*each} != {"no unit"} else None)
        for name, each in units.items()
    }
    return _some([name + size + measured[name] for name, size in sizes.items()]) or "none"


def _measured(unit: str | None) -> str:
    return f" in {unit}" if unit else ""


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
