"""Factors of a campaign: lines of a scenario file, also under the names of blocks and parameters in Python."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from bayesftc.cosim.diagram.closed_loop import fault_block, noise_block
from bayesftc.cosim.errors import ScenarioError, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.scenario._place import Place
from bayesftc.scenario._sections import Shipped, Wiring, fault_list

OF_PLANT = {f.name for cls in (Wiring, Shipped, FMU) for f in fields(cls)}
"""Keys of ``[plant]`` with an FMU; any other name after ``plant.`` is a parameter."""
PARAMETERS = "plant.parameters."


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
    first, _, rest = path.partition(".")
    if first == "plant" and rest and "fmu" in content["plant"]:
        return path if re.match(r"\w*", rest)[0] in OF_PLANT else PARAMETERS + rest  # type: ignore[index]
    blocks = _lines_of_blocks(content)
    return path if first not in blocks else f"{blocks[first]}.{rest}" if rest else blocks[first]


def _lines_of_blocks(content: Mapping[str, Any]) -> dict[str, str]:
    """Return the line of each block whose name in the file differs from that in the diagram."""
    root, lines = Place(""), {noise_block(name): f"noise.{name}" for name in content.get("noise", {})}
    lists = {"faults": ("", content.get("faults", []))}
    lists |= {f"input_faults.{name}": (name, faults) for name, faults in content.get("input_faults", {}).items()}
    for section, (name, faults) in lists.items():
        fault_blocks = fault_list(faults, root / section)
        lines |= {fault_block(fault, name): f"{section}[{i}]" for i, fault in enumerate(fault_blocks)}
    return lines


def set_line(content: Any, path: str, value: Any) -> None:
    """Set the value at a path of keys and indices. The last key may be new in its table.

    Raises
    ------
    ScenarioError
        If there is no such line.
    """
    steps: list[str | int] = [
        int(number) if number else key for key, number in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path)
    ]
    if path.startswith(PARAMETERS):
        content["plant"].setdefault("parameters", {})
        if "." in path.removeprefix(PARAMETERS):  # an FMU's parameter name may contain dots
            steps = ["plant", "parameters", path.removeprefix(PARAMETERS)]
    at, so_far = content, ""
    for i, step in enumerate(steps):
        last = i == len(steps) - 1
        if isinstance(at, Mapping) and isinstance(step, str):
            if last:
                at[step] = value  # type: ignore[index]
                return
            if step not in at:
                raise ScenarioError(
                    f"The factor {path!r}: the scenario has no {step!r}{so_far}; {did_you_mean(step, at)}"
                )
        elif isinstance(at, list) and isinstance(step, int) and step < len(at):
            if last:
                at[step] = value
                return
        else:
            raise ScenarioError(f"The factor {path!r}: the scenario has no {step!r}{so_far}; {_there(at)}")
        at, so_far = at[step], f" in {'.'.join(map(str, steps[: i + 1]))}"


def _there(part: Any) -> str:
    """Return the end of a sentence about an element that does not exist."""
    if isinstance(part, list):
        return f"it has the elements 0 to {len(part) - 1}." if part else "the list is empty."
    return "check the path of the line."
