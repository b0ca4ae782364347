"""``bayesftc export``: blocks of a scenario's loop as an FMU or as C."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.errors import ModelError
from bayesftc.scenario import load_scenario

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.fmu import FMU

SHOWN = 14
"""Ports of a side that are printed one by one."""


def export_scenario(
    name: str,
    blocks: Sequence[str],
    out: Path | None,
    *,
    form: str,
    fmi: str | None,
    platforms: Sequence[str],
    timing: str | None,
    quiet: bool,
) -> None:
    """Write blocks of a scenario as an FMU or as C, and print what was written.

    Parameters
    ----------
    name : str
        A scenario file or the name of a shipped scenario.
    blocks : sequence of str
        Names of the blocks.
    out : pathlib.Path or None
        The FMU, or the folder of the C files; by default named after block or scenario, in the current folder.
    form : {"fmu", "c"}
        What to write.
    fmi, platforms, timing : str or sequence of str, optional
        As of `bayesftc.cosim.export_fmu`.
    quiet : bool
        Print nothing.
    """
    from bayesftc.cosim.export.exporting import export_c, export_fmu

    loop = load_scenario(name).loop()
    chosen = list(dict.fromkeys(loop[block].name for block in blocks))
    if form == "c":
        given = [option for option, value in (("--fmi", fmi), ("--platform", platforms), ("--timing", timing)) if value]
        if given:
            raise ModelError(
                f"{' and '.join(given)} cannot be given with --format c, which is not for FMI; leave it out."
            )
        source, header = export_c(loop, out or Path(), name=_stem(name, chosen), blocks=chosen)
        if not quiet:
            _say(
                f"{source} and {header.name}: {source.stem}_init, {source.stem}_step; {header.name} says how to use them."
            )
            _say(f"Try:  cc -std=c99 -O2 -c {quote(str(source))}")
        return
    path = out or Path(f"{_stem(name, chosen)}.fmu")
    options: dict[str, Any] = {"fmi": fmi or "2.0", "timing": timing, "platforms": list(platforms) or None}
    about = f"{', '.join(chosen)} of the scenario {Path(name).name}"
    path = export_fmu(loop, path, blocks=chosen, description=f"{about[0].upper()}{about[1:]}", **options)
    if not quiet:
        _report(path)
        _say(f"Try:  bayesftc verify {quote(str(path))} --against {quote(name)}")


def _stem(name: str, blocks: Sequence[str]) -> str:
    return blocks[0] if len(blocks) == 1 else Path(name).stem


def _report(path: Path) -> None:
    """Print what an FMU is, read from the file."""
    from bayesftc.cosim.fmi.fmu import FMU

    fmu = FMU(path)
    description = fmu.description
    _say(
        f"{path}: FMI {description.fmi_version}, {path.stat().st_size / 1000:.0f} kB, for {', '.join(description.platforms)}"
    )
    _say(f"inputs   {_listed(fmu.inputs)}")
    _say(f"outputs  {_listed(fmu.outputs)}")
    tunable = [v for v in description.variables if v.causality == "parameter" and v.variability == "tunable"]
    if tunable:
        _say(f"tunable  {_some([f'{v.name}{_measured(v.unit)}' for v in tunable])}")
    _say(f"step     {description.default_experiment['stepSize']:g} s, no other")
    _say(f"timing   {_timing(fmu)}")


def _timing(fmu: FMU) -> str:
    if fmu.timing == "sampled":
        return "sampled: what a step takes in at its beginning is in the outputs after it"
    return "plant: the outputs after a step are those at its end"


def _listed(ports: Any) -> str:
    """Return ports with their units; the elements of an array, which are variables of their own in FMI 2, as one."""
    found: dict[str, str] = {}
    for port in ports:
        whole, bracket, index = port.name.partition("[")
        sizes = [int(i) + 1 for i in index.rstrip("]").split(",")] if bracket else list(port.shape)
        found[whole] = (f" ({'x'.join(map(str, sizes))})" if sizes else "") + _measured(port.unit)
    return _some([name + rest for name, rest in found.items()]) or "none"


def _measured(unit: str | None) -> str:
    return f" in {unit}" if unit else ""


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")


def _say(line: str) -> None:
    import typer

    typer.echo(line)
