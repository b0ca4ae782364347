"""Factors of a campaign: lines of a scenario file, also under the names of blocks and parameters in Python."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any

from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.cosim.diagram.closed_loop import fault_blocks, noise_block
from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.scenario._fmu_files import Shipped
from bayesftc.scenario._place import Place
from bayesftc.scenario._sections import Wiring, fault_list

OF_PLANT = {f.name for cls in (Wiring, Shipped, FMU) for f in fields(cls)}
"""Keys of ``[plant]`` with an FMU; any other name after ``plant.`` is a parameter."""
PARAMETERS = ".parameters."
SHAPES = {
    "plant": {*(f.name for cls in (Wiring, Shipped) for f in fields(cls)), "kind", "inputs", "outputs", "dt"},
    "sensors": {"count", "signals", "matrix", "every", "unit", "invalid"},
}
"""Keys that say what a controller is connected to. The others of these sections are numbers that it need not know."""


def line_of(path: str, content: Mapping[str, Any]) -> str:
    """Return the line of a scenario file that a factor refers to.

    Parameters
    ----------
    path : str
        A line such as ``"faults[0].start"``, or a path into the diagram as in `bayesftc.cosim.varied`: ``"freeze_0.start"``,
        ``"disturbance_noise.std"``, ``"plant.m"``.
    content : mapping
        The content of the file.

    Returns
    -------
    str
        The path of the line. A path that names no block with a section is returned unchanged.
    """
    lines = {"plant": "plant", **_lines_of_blocks(content)}
    names = [name for name in lines if path == name or path.startswith(f"{name}.")]
    if not names:
        return path
    name = max(names, key=len)
    line, rest = lines[name], path[len(name) + 1 :]
    if rest and "fmu" in _table(content, line) and re.match(r"\w*", rest)[0] not in OF_PLANT:  # type: ignore[index]
        return f"{line}{PARAMETERS}{rest}"
    return f"{line}.{rest}" if rest else line


def known_to_controller(lines: Iterable[str]) -> set[str]:
    """Return those of a point's factors that a controller which is designed for the plant knows.

    These are all but numbers of the plant and of the sensors. If another factor changes what it is connected to, such as the
    number of sensors, it knows the numbers of that section, too.

    Parameters
    ----------
    lines : iterable of str
        From `line_of`.
    """
    steps = {line: _steps(line) for line in lines}
    connected = {of[0] for of in steps.values() if len(of) == 1 or of[1] in SHAPES.get(str(of[0]), ())}
    return {line for line, of in steps.items() if of[0] not in SHAPES or of[0] in connected}


def _steps(path: str) -> list[str | int]:
    return [int(number) if number else key for key, number in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path)]


def _table(content: Any, line: str) -> Any:
    """Return the table at a line, or an empty one if there is none."""
    for step in _steps(line):
        if isinstance(content, Mapping):
            content = content.get(step)
        else:
            content = (
                content[step] if isinstance(content, list) and isinstance(step, int) and step < len(content) else None
            )
    return content if isinstance(content, Mapping) else {}


def _lines_of_blocks(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the line of each block whose name in the file differs from that in the diagram."""
    root, lines = Place(""), {noise_block(name): f"noise.{name}" for name in content.get("noise", {})}
    lists = {"faults": ("", content.get("faults", []))}
    lists |= {f"input_faults.{name}": (name, faults) for name, faults in content.get("input_faults", {}).items()}
    for section, (name, faults) in lists.items():
        names = fault_blocks(fault_list(faults, root / section), name)
        lines |= {block: f"{section}[{i}]" for i, block in enumerate(names)}
    for name in ("plant", "controller"):
        lines |= _lines_inside(content[name], name, name)
    return {**lines, **_lines_inside(content, "", "")}


def _lines_inside(table: Any, name: str, line: str) -> dict[str, str]:
    """Return the lines of the blocks of a table, and of the blocks of subsystems among them, by their names in the diagram."""
    inside = table.get("blocks", {}) if isinstance(table, Mapping) else {}
    lines: dict[str, str] = {}
    for key, value in inside.items() if isinstance(inside, Mapping) else ():
        own_name, own_line = f"{name}.{key}".strip("."), f"{line}.blocks.{key}".strip(".")
        lines |= {own_name: own_line, **_lines_inside(value, own_name, own_line)}
    return lines


def set_line(content: Any, path: str, value: Any) -> None:
    """Set the value at a path of keys and indices. The last key may be new in its table.

    Raises
    ------
    ScenarioError
        If there is no such line.
    """
    steps = _steps(path)
    block, of_fmu, parameter = path.partition(PARAMETERS)
    if of_fmu and "fmu" in (table := _table(content, block)):
        table.setdefault("parameters", {})
        if "." in parameter:  # an FMU's parameter name may contain dots
            steps = [*_steps(block), "parameters", parameter]
    at, so_far = content, ""
    for i, step in enumerate(steps):
        last = i == len(steps) - 1
        if isinstance(at, Mapping) and isinstance(step, str):
            if last:
                at[step] = value  # type: ignore[index]
                return
            if step not in at:
                names = {*at, *(() if i else _lines_of_blocks(content))}
                raise ScenarioError(
                    f"The factor {path!r}: the scenario has no {step!r}{so_far}; {did_you_mean(step, names)}"
                )
        elif isinstance(at, list) and isinstance(step, int) and step < len(at):
            if last:
                at[step] = value
                return
        else:
            raise ScenarioError(f"The factor {path!r}: the scenario has no {step!r}{so_far}; {_there(at, step)}")
        if isinstance(at[step], str) and (condition := When.read(at[step])):
            at[step] = asdict(condition)  # a condition as text has the entries of its table
        at, so_far = at[step], f" in {'.'.join(map(str, steps[: i + 1]))}"


def _there(part: Any, step: str | int) -> str:
    """Return the end of a sentence about an element that does not exist."""
    if isinstance(part, list):
        if "," in str(step):
            return f"write an element of a matrix as [{']['.join(str(step).replace(' ', '').split(','))}]."
        return f"it has the elements 0 to {len(part) - 1}." if part else "the list is empty."
    return "check the path of the line."
