"""``bayesftc inspect`` of an SSP: its components, their parameter values, and the connections."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from bayesftc.cli import output
from bayesftc.cosim.blocks.mathblocks import Gain
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import SSPError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import Port
from bayesftc.cosim.ssp.system import open_ssp


def inspect_ssp(path: Path, *, validate: bool, json: bool) -> None:
    """Print tables (or JSON) of the diagram of an SSP. With `validate` it and its FMUs must follow SSP and FMI."""
    try:
        diagram = open_ssp(path, validate=validate)
        step: str | None = str(diagram.step)
    except SSPError as error:
        if "give dt=" not in str(error):
            raise
        diagram, step = open_ssp(path, validate=validate, dt=1), None
    data = {"path": str(path), "step": step, "components": _components(diagram), "connections": _connections(diagram)}
    if json:
        typer.echo(output.as_json(data))
        return
    _print(data)


def _components(diagram: Diagram) -> dict[str, Any]:
    return {
        node.name: {
            "fmu": Path(node.block.path).name,
            "fmi_version": node.block.description.fmi_version,
            "kind": node.block.kind,
            "values": dict(node.block.parameters or {}),
        }
        for node in diagram.nodes
        if isinstance(node.block, FMU)
    }


def _connections(diagram: Diagram) -> list[dict[str, Any]]:
    """Return the source of each input of each FMU. A `Gain` between two FMUs is a transformation."""
    data = []
    for node in diagram.nodes:
        for port in node.block.inputs or () if isinstance(node.block, FMU) else ():
            assert isinstance(port, Port)
            source = diagram.source_of(node, port, 0)
            if source is None:
                continue
            reference, linear = source[0], {}
            block = reference.node.block
            if isinstance(block, Gain):
                linear = {"factor": block.gain, "offset": block.offset}
                before = diagram.source_of(reference.node, block.inputs[0], 0)
                assert before is not None
                reference = before[0]
            data.append(
                {"from": f"{reference.node.name}.{reference.port.name}", "to": f"{node.name}.{port.name}", **linear}
            )
    return data


def _print(data: dict[str, Any]) -> None:
    from rich.text import Text

    console = output.terminal()
    console.print(Text(f"file  {data['path']}"))
    console.print(Text(f"step  {data['step']} s" if data["step"] else "step  none is given: open_ssp(path, dt=...)"))
    components = output.plain_table("component", "FMU", "FMI", "used for", "values")
    for name, row in data["components"].items():
        values = ", ".join(f"{variable} = {value}" for variable, value in row["values"].items())
        components.add_row(*map(Text, (name, row["fmu"], row["fmi_version"], row["kind"], values)))
    console.print(components)
    connections = output.plain_table("from", "to", "factor", "offset", right={"factor", "offset"})
    for row in data["connections"]:
        numbers = (f"{row[n]:.10g}" if n in row else "" for n in ("factor", "offset"))
        connections.add_row(*map(Text, (row["from"], row["to"], *numbers)))
    if data["connections"]:
        console.print(connections)
