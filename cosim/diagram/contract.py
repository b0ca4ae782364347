"""What a block's step functions must keep to: ask for what the block has, write all outputs, and write nothing else."""

from __future__ import annotations

import dis
from functools import lru_cache
from types import CodeType
from typing import Any

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.records import as_written
from bayesftc.cosim.types import Kernel, argument_names

RESERVED = frozenset({"t", "k", "inputs", "outputs"})
"""Argument names of step functions that are no ports: time, step count, and all inputs or outputs as one flat array."""

_CONTAINER = {"STORE_SUBSCR": 2, "STORE_SLICE": 3}
"""How deep in the operand stack the array lies into which an instruction stores."""


def checked(block: Block, definition: Definition, title: str) -> Definition:
    """Return the definition if its step functions ask only for what the block has and write all its outputs.

    Raises
    ------
    KernelError
        If they do not; `title` is what the sentence calls the block.
    """
    outputs = {p.name for p in block.outputs}
    late = {p.name for p in block.inputs if not p.feedthrough}
    entries = {*definition.state, *definition.parameters, *definition.scratch}
    known = {p.name for p in block.inputs} | outputs | entries | RESERVED
    for name in definition.records:
        if name in known:
            raise KernelError(
                f"Block {title} has a record {name!r}, but a port or entry is called so, too: rename one."
            )
    for kernel in (definition.output, definition.update):
        if kernel is None:
            continue
        for name in argument_names(kernel):
            if name not in known:
                raise KernelError(
                    f"The step function {kernel.__name__!r} of block {title} asks for {name!r}, which is no port, state, "
                    f"parameter or scratch space of it (these are: {', '.join(sorted(known))})."
                )
            if kernel is definition.output and name in late:
                raise KernelError(
                    f"The step function {kernel.__name__!r} of block {title} reads {name!r} to write the outputs, but that input "
                    "is declared feedthrough=False; leave that out, or read it in the update function."
                )
    written = set(argument_names(definition.output)) if definition.output else set()
    forgotten = [p.name for p in block.outputs if p.name not in written and "outputs" not in written]
    if forgotten:
        raise KernelError(
            f"Block {title} has the output {forgotten[0]!r}, but no output function with an argument of that name writes it."
        )
    for kernel in (definition.output, definition.update):
        if kernel is not None:
            _check_stores(kernel, block, definition, title)
    return definition


def _check_stores(kernel: Kernel, block: Block, definition: Definition, title: str) -> None:
    stored = _stored(kernel, definition)
    fed = sorted(stored & {"inputs", *(p.name for p in block.inputs)})
    if fed:
        raise KernelError(
            f"The step function {kernel.__name__!r} of block {title} writes into its input {fed[0]!r}; an input belongs to the "
            "block that feeds it: declare a state for what is to be kept."
        )
    written = sorted(stored & {"outputs", *(p.name for p in block.outputs)})
    if written and kernel is definition.update:
        raise KernelError(
            f"The update function {kernel.__name__!r} of block {title} writes the output {written[0]!r}, which others would see "
            "before its time; write a state, and let the output function show it."
        )


def _stored(kernel: Kernel, definition: Definition) -> set[str]:
    """Return the names of the arrays into which a step function stores, those in records, too."""
    written, found = as_written(kernel), set()
    records = {name: definition.records[name] for name in argument_names(written) if name in definition.records}
    for name in stored_into(written.__code__):
        first, *rest = name.split(".")
        array: Any = records.get(first, first)
        for part in rest:
            array = getattr(array, part, None)
        found.add(array if isinstance(array, str) else name)
    return found


@lru_cache(maxsize=1024)  # a campaign builds many diagrams of the same few functions
def stored_into(code: CodeType) -> frozenset[str]:
    """Return the names of local variables into whose elements `code` stores.

    It follows the operand stack along the text of the function; a field of a record is called ``record.field``. What is
    stored by a function that it calls, or under another name of the same array, is not seen.
    """
    found: set[str] = set()
    stack: list[str | None] = []
    for instruction in dis.get_instructions(code):
        name, argument = instruction.opname, instruction.argval
        if name in _CONTAINER:
            depth = _CONTAINER[name]
            if len(stack) >= depth and (target := stack[-depth]) is not None:
                found.add(target)
        if name.startswith("LOAD_FAST"):  # since Python 3.13 there are instructions that load two
            stack += argument if isinstance(argument, tuple) else [argument]
        elif name.startswith("STORE_FAST_LOAD_FAST"):
            stack[-1:] = [argument[1]]
        elif name == "LOAD_ATTR" and stack and stack[-1] is not None:
            stack[-1] = f"{stack[-1]}.{argument}"
        elif name == "COPY":
            stack.append(stack[-instruction.arg] if instruction.arg and instruction.arg <= len(stack) else None)
        elif name == "SWAP":
            depth = instruction.arg or 1
            if depth <= len(stack):
                stack[-1], stack[-depth] = stack[-depth], stack[-1]
        else:
            _apply(stack, dis.stack_effect(instruction.opcode, instruction.arg, jump=False))
    return frozenset(found)


def _apply(stack: list[str | None], effect: int) -> None:
    """Change the depth as any other instruction does; what it leaves on top is no plain argument any more."""
    if effect < 0:
        del stack[effect:]
    stack += [None] * max(effect, 0)
    if stack and effect <= 0:
        stack[-1] = None
