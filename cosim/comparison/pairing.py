"""Check that runs of several loops are paired: the same seed gives all loops the same noise, faults and reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from inspect import getclosurevars
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.blocks.preview import Preview
from bayesftc.cosim.blocks.sensing.sensors import Sensors
from bayesftc.cosim.blocks.sources import Source
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.wiring import find_controller, find_sensors, is_controller
from bayesftc.cosim.errors import ModelError


def check_pairs(loops: Mapping[str, Diagram]) -> None:
    """Refuse loops whose runs with the same seed are not paired.

    Random streams belong to the names of blocks. So sensors, sources, faults and all other blocks with random inputs must be the
    same in each loop. Plant and controller may differ. A `Preview` is the same as its source: the present goal is the same.

    Raises
    ------
    ModelError
        If the loops differ in their sample time, or in one of these blocks.
    """
    (first, one), *others = loops.items()
    find_controller(one), find_sensors(one)
    expected = dict(_surroundings(one))
    for name, loop in others:
        if loop.step != one.step:
            raise ModelError(
                f"The loops {first!r} and {name!r} run at {float(one.step):g} s and {float(loop.step):g} s, so that their noise "
                "differs. Give both the same dt."
            )
        actual = dict(_surroundings(loop))
        for block in (*expected, *actual):
            if block not in expected or block not in actual:
                owner, other, found = (
                    (first, name, expected[block]) if block in expected else (name, first, actual[block])
                )
                raise ModelError(
                    f"The loop {owner!r} has the block {block!r} ({type(found[0]).__name__}), and {other!r} does not. "
                    "A comparison needs the same faults, sensors, sources and noise in all loops, with the same names. Only "
                    "plant and controller may differ. Add the block to both."
                )
            if not alike(expected[block][0], actual[block][0]):
                raise ModelError(
                    f"The block {block!r} has other settings in the loop {name!r} than in {first!r}, so that noise, faults or "
                    "reference differ. Give both the same settings."
                )
            if expected[block][1] != actual[block][1]:
                raise ModelError(
                    f"The block {block!r} runs every {actual[block][1]} steps in the loop {name!r}, and every "
                    f"{expected[block][1]} in {first!r}. Give both the same every=."
                )


def _surroundings(loop: Diagram) -> Iterator[tuple[str, tuple[Block, int]]]:
    """Yield the blocks that must be the same in each loop, and their every: not those inside the controller, which may differ."""
    inside = tuple(f"{node.name}." for node in loop.nodes if is_controller(node))
    for node in loop.nodes:
        block = node.block.source if isinstance(node.block, Preview) else node.block
        random = any(port.draw is not None for port in block.inputs)
        if (random or isinstance(block, Fault | Sensors | Source)) and not node.name.startswith(inside):
            yield node.name, (block, node.every)


def alike(one: Any, other: Any) -> bool:
    """Return whether two blocks, or settings of them, are equal, including arrays."""
    if one is other:
        return True
    if is_dataclass(one) or isinstance(one, Block):
        if type(one) is not type(other) or not is_dataclass(one):
            return False
        return all(alike(getattr(one, each.name), getattr(other, each.name)) for each in fields(one))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    if _is_plain_sequence(one) and _is_plain_sequence(other):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, FunctionType) and isinstance(other, FunctionType):
        return one.__code__ == other.__code__ and alike(*(getclosurevars(each).nonlocals for each in (one, other)))
    try:
        return bool(np.array_equal(one, other, equal_nan=True))
    except TypeError:
        return bool(one == other)


def _is_plain_sequence(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)
