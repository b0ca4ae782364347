"""Change settings of a diagram, as factors of a campaign do, by paths such as ``"controller.precision"``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import Field, fields, is_dataclass, replace
from typing import Any, NamedTuple, NoReturn

import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.diagram.roles import units_of_settings
from bayesftc.cosim.diagram.wiring import (
    goals_ahead,
    lies_ahead,
    present_origin,
    preview_of,
    preview_time,
    warn_of_rounded_delays,
    with_rates,
)
from bayesftc.cosim.errors import BayesFTCError, ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.export.units import unit_of_setting
from bayesftc.cosim.fmi.fmu import FMU

FITTED = ("channels", "signals")
"""Settings that a loop derives from its connections. A block that replaces another inherits them, unless it sets them."""


class Change(NamedTuple):
    """A factor's value, the remaining steps of its path, and its whole path."""

    steps: Sequence[str]
    value: Any
    path: str


def varied(diagram: Diagram, changes: Mapping[str, Any]) -> Diagram:
    """Return a diagram with the same connections and some other settings.

    Parameters
    ----------
    diagram : Diagram
        The original, which is not changed.
    changes : mapping of str to object
        Path -> new value: of a block as a whole (``"freeze_0"``), of a setting (``"freeze_0.start"``), of a setting's
        setting (``"controller.precision.forgetting"``), of an element (``"controller.model.B[0]"``), or of a parameter of an
        FMU (``"plant.m"``; ``"plant.parameters.name"`` if `FMU` also has a setting of that name). In any order of the paths,
        an object is changed before its parts, and all settings of one object at once.

    Returns
    -------
    Diagram
        The changed diagram, with the coupling of the original; built if the original is.

    Raises
    ------
    UnknownNameError
        If there is no such block, setting or parameter.
    ConnectionError
        If a new block lacks a connected port, or has it with another size.
    BayesFTCError
        If a block refuses its new settings.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> one, gain = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Gain(2.0), "gain")
    >>> diagram.connect(one["y"], gain["u"])
    >>> float(cosim.varied(diagram, {"gain.gain": 3.0}).simulate(0.1)["gain.y"][-1])
    3.0
    """
    blocks = {node.name: node.block for node in diagram.nodes}
    of_blocks: dict[str, list[Change]] = {}
    for path, value in changes.items():
        name, steps = _split(path, blocks)
        of_blocks.setdefault(name, []).append(Change(steps, value, path))
    for name, of_block in of_blocks.items():
        for change in of_block:
            if not change.steps:
                blocks[name] = _in_place_of(blocks[name], change.value, change.path)
        blocks[name] = _changed(blocks[name], [change for change in of_block if change.steps])
    changed = with_rates(diagram.rewired(blocks | _previews(diagram, blocks)), diagram)
    warn_of_rounded_delays(changed)
    return changed


def unit_of_factor(diagram: Diagram, path: str) -> str | None:
    """Return the unit of a block's setting, or of a parameter of an FMU; None if there is none, or no such setting."""
    blocks = {node.name: node.block for node in diagram.nodes}
    try:
        name, steps = _split(path, blocks)
    except BayesFTCError:  # a loop that is a function has factors of any names
        return None
    block, setting = blocks[name], _joined(steps)
    declared: Mapping[str, Field[Any]] = getattr(block, "__dataclass_fields__", {})
    whole, _, index = setting.partition("[")
    if isinstance(block, FMU) and whole not in declared:
        setting = setting.removeprefix("parameters.")
        units = {variable.name: variable.unit for variable in block.description.variables}
        return units.get(setting) or units.get(setting.rpartition("[")[0])
    text = str(declared[whole].metadata.get("unit", "")) if whole in declared else ""
    element = {name: int(index[:-1])} if index[:-1].isdecimal() else {}
    return unit_of_setting(text, name, units_of_settings(diagram, element))


def _previews(diagram: Diagram, blocks: Mapping[str, Block]) -> dict[str, Block]:
    """Return the references of a controller whose preview has changed, with the new one."""
    new: dict[str, Block] = {}
    for node in diagram.nodes:
        before, time = preview_of(diagram, node), preview_time(blocks[node.name], diagram.step * node.every)
        if time == before:
            continue
        for i in range(node.port("goal").size):
            if origin := present_origin(diagram, node, i):
                _refuse_preview(node, origin)
        for origin in goals_ahead(diagram, node):
            block = blocks[origin.node.name]
            if not isinstance(block, Preview):
                _refuse_preview(node, origin)
            new[origin.node.name] = replace(block, time=time)
    return new


def _refuse_preview(controller: Node, origin: PortRef) -> NoReturn:
    title = f"A factor changes the preview of {controller.name!r}, but its goal comes from {origin.name}, "
    if isinstance(origin.node.block, Preview) and not lies_ahead(origin):
        raise ModelError(f"{title}the present value. Connect '{origin.node.name}.ahead' in its place.")
    raise ModelError(
        f"{title}whose future the diagram does not have. Make the loop with a preview of at least 1; the factor may then also "
        "be 0."
    )


def _split(path: str, blocks: Mapping[str, Block]) -> tuple[str, list[str]]:
    """Return the name of a path's block, which may contain dots, and the further steps."""
    if not isinstance(path, str):
        raise ModelError(f"{path!r} cannot be a factor; it must be a path such as 'controller.precision'.")
    matches = [name for name in blocks if path == name or path.startswith(name + ".")]
    if not matches:
        raise UnknownNameError(
            f"The factor {path!r} names no block of the diagram; {did_you_mean(path.split('.')[0], blocks)}"
        )
    name = max(matches, key=len)
    return name, re.findall(r"[^.\[\]]+|\[[^\]]*\]", path[len(name) :])


def _in_place_of(block: Block, value: Any, path: str) -> Block:
    if not isinstance(value, Block):
        raise ModelError(
            f"The factor {path!r} is a whole block, but {value!r} is not a block; name one of its settings: {path}.NAME."
        )
    if is_dataclass(value) and is_dataclass(block):
        defaults = {f.name: f.default for f in fields(value) if f.name in FITTED}
        fitted = {
            n: getattr(block, n)
            for n, default in defaults.items()
            if hasattr(block, n) and getattr(value, n) == default
        }
        return replace(value, **fitted) if fitted else value  # type: ignore[return-value]
    return value


def _changed(part: Any, changes: Sequence[Change]) -> Any:
    """Return `part` with the changes: first the object as a whole, then its parts, all at once."""
    for change in changes:
        if not change.steps:
            part = change.value
    inner: dict[str, list[Change]] = {}
    for change in changes:
        if change.steps:
            inner.setdefault(change.steps[0], []).append(change._replace(steps=change.steps[1:]))
    if not inner:
        return part
    path = next(iter(inner.values()))[0].path
    if all(step.startswith("[") for step in inner):
        for step, group in inner.items():
            part = _with_element(part, step[1:-1], group)
        return part
    if isinstance(part, Mapping):
        for step, group in inner.items():
            if step not in part:
                raise UnknownNameError(
                    f"The factor {group[0].path!r}: there is no {step!r}; {did_you_mean(step, part)}"
                )
        return {**part, **{step: _changed(part[step], group) for step, group in inner.items()}}
    if is_dataclass(part) and not isinstance(part, type):
        return _with_settings(part, inner)
    if part is None:
        raise ModelError(
            f"The factor {path!r}: {path.rpartition('.')[0]} is not set in the loop. Give it there, to change a part of it."
        )
    raise ModelError(
        f"The factor {path!r}: the settings of {type(part).__name__} cannot be changed one by one; give a whole new object."
    )


def _with_settings(part: Any, inner: Mapping[str, list[Change]]) -> Any:
    """Return a dataclass with some settings changed, all at once because they may depend on each other."""
    names = [f.name for f in fields(part) if f.init]
    new: dict[str, Any] = {}
    for step, group in inner.items():
        if step in names:
            whole = [change for change in group if not change.steps] if _has_parameters(part, step) else group
            if whole:
                new[step] = _changed(getattr(part, step), whole)
        elif not isinstance(part, FMU):
            raise UnknownNameError(
                f"The factor {group[0].path!r}: {type(part).__name__} has no setting {step!r}; {did_you_mean(step, names)}"
            )
    if isinstance(part, FMU):
        parameters = dict(new.get("parameters", part.parameters) or {})
        for step, group in inner.items():
            for change in group:
                if step not in names:
                    _set_parameter(part, parameters, [step, *change.steps], change)
                elif step == "parameters" and change.steps:
                    _set_parameter(part, parameters, change.steps, change)
        new |= {"parameters": parameters} if parameters else {}
    try:
        return replace(part, **new)
    except (TypeError, ValueError) as error:
        if isinstance(error, BayesFTCError):
            raise
        paths = ", ".join(repr(change.path) for group in inner.values() for change in group)
        raise ModelError(
            f"{type(part).__name__} refuses the values of {paths}: {type(error).__name__}: {error}."
        ) from error


def _has_parameters(part: Any, step: str) -> bool:
    return isinstance(part, FMU) and step == "parameters"


def _set_parameter(fmu: FMU, parameters: dict[str, Any], steps: Sequence[str], change: Change) -> None:
    """Set a parameter of an FMU, or an element of an array; names may contain dots and brackets."""
    name, value = _joined(steps), change.value
    try:
        fmu.start_value(name)
    except UnknownNameError:
        base, bracket, index = name.rpartition("[")
        if not bracket or not isinstance(array := fmu.start_value(base), tuple):
            raise
        name, value = base, _with_element(parameters.get(base, array), index.rstrip("]"), [change._replace(steps=())])
    parameters[name] = value


def _joined(steps: Sequence[str]) -> str:
    return "".join(s if s.startswith("[") else f".{s}" for s in steps).lstrip(".")


def _with_element(part: Any, index: str, changes: Sequence[Change]) -> Any:
    try:
        place = tuple(int(i) for i in index.split(","))
        if isinstance(part, np.ndarray):
            changed = part.copy()
            changed[place] = _changed(part[place], changes)
            return changed
        items = list(part)
        items[place[0]] = (
            _changed(items[place[0]], changes)
            if len(place) == 1
            else _with_element(items[place[0]], ",".join(map(str, place[1:])), changes)
        )
    except (ValueError, TypeError, IndexError):
        raise UnknownNameError(f"The factor {changes[0].path!r}: there is no element [{index}].") from None
    return tuple(items) if isinstance(part, tuple) else items


__all__ = ["unit_of_factor", "varied"]
