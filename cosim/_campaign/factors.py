"""A diagram with other settings: what the factors of a campaign change, by paths such as ``"controller.precision"``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.diagram import Diagram
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmu import FMU

FITTED = ("channels", "signals")
"""Settings that a loop fits to its wiring; a block that takes another's place has them of that one, unless it says its own."""


def varied(diagram: Diagram, changes: Mapping[str, Any]) -> Diagram:
    """Return a diagram of the same wiring in which some settings are others.

    Parameters
    ----------
    diagram : Diagram
        Stays as it is.
    changes : mapping of str to object
        By path the new value: of a block as a whole (``"freeze_0"``), of a setting (``"freeze_0.start"``), of a setting's
        setting (``"controller.precision.forgetting"``), of an element (``"controller.model.B[0]"``), or of a parameter of an
        FMU (``"plant.m"``).

    Returns
    -------
    Diagram
        With the coupling of the original; built if that is.

    Raises
    ------
    UnknownNameError
        If there is no such block, setting or parameter.
    ConnectionError
        If a new block lacks a port that is connected, or has another size there.
    BayesFTCError
        What a block has against its new settings.

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
    for path, value in changes.items():
        name, rest = _split(path, blocks)
        blocks[name] = _changed(blocks[name], rest, value, path) if rest else _in_place_of(blocks[name], value, path)
    return diagram.rewired(blocks)


def _split(path: str, blocks: Mapping[str, Block]) -> tuple[str, list[str]]:
    """Return the name of a path's block, which may have dots in it, and the further steps."""
    if not isinstance(path, str):
        raise ModelError(f"{path!r} cannot be a factor; it must be a path such as 'controller.precision'.")
    found = [name for name in blocks if path == name or path.startswith(name + ".")]
    if not found:
        raise UnknownNameError(
            f"The factor {path!r} names no block of the diagram; {did_you_mean(path.split('.')[0], blocks)}"
        )
    name = max(found, key=len)
    return name, re.findall(r"[^.\[\]]+|\[[^\]]*\]", path[len(name) :])


def _in_place_of(block: Block, value: Any, path: str) -> Block:
    if not isinstance(value, Block):
        raise ModelError(
            f"The factor {path!r} is a whole block, and {value!r} is none; name one of its settings, as {path}.NAME."
        )
    if is_dataclass(value) and is_dataclass(block):
        own = {f.name: f.default for f in fields(value) if f.name in FITTED}
        fitted = {
            n: getattr(block, n) for n, default in own.items() if hasattr(block, n) and getattr(value, n) == default
        }
        return replace(value, **fitted) if fitted else value  # type: ignore[return-value]
    return value


def _changed(part: Any, steps: list[str], value: Any, path: str) -> Any:
    """Return `part` with what lies at the end of the steps replaced."""
    if not steps:
        return value
    step, rest = steps[0], steps[1:]
    if step.startswith("["):
        return _with_element(part, step[1:-1], rest, value, path)
    if isinstance(part, Mapping):
        if step not in part:
            raise UnknownNameError(f"The factor {path!r}: there is no {step!r}; {did_you_mean(step, part)}")
        return {**part, step: _changed(part[step], rest, value, path)}
    if is_dataclass(part) and not isinstance(part, type):
        known = [f.name for f in fields(part) if f.init]
        if step in known:
            return replace(part, **{step: _changed(getattr(part, step), rest, value, path)})
        if isinstance(part, FMU):
            name = "".join(s if s.startswith("[") else f".{s}" for s in steps)[
                1:
            ]  # which may have dots and brackets in it
            part.start_value(name)  # or it says what is there
            return replace(part, parameters={**(part.parameters or {}), name: value})
        raise UnknownNameError(
            f"The factor {path!r}: {type(part).__name__} has no setting {step!r}; {did_you_mean(step, known)}"
        )
    raise ModelError(
        f"The factor {path!r}: {type(part).__name__} has no settings that could be changed one by one; give the whole."
    )


def _with_element(part: Any, index: str, rest: list[str], value: Any, path: str) -> Any:
    try:
        place = tuple(int(i) for i in index.split(","))
        if isinstance(part, np.ndarray):
            changed = part.copy()
            changed[place] = _changed(part[place], rest, value, path)
            return changed
        items = list(part)
        items[place[0]] = (
            _changed(items[place[0]], rest, value, path)
            if len(place) == 1
            else _with_element(items[place[0]], ",".join(map(str, place[1:])), rest, value, path)
        )
    except (ValueError, TypeError, IndexError):
        raise UnknownNameError(f"The factor {path!r}: there is no element [{index}].") from None
    return tuple(items) if isinstance(part, tuple) else items


__all__ = ["varied"]
