"""The contract of step functions: their arguments belong to the block, and they write all outputs but no inputs."""

from __future__ import annotations

import dis
from collections.abc import Set
from functools import lru_cache
from types import CodeType
from typing import Any

import numpy as np

from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.records import as_written
from bayesftc.cosim.types import Kernel, argument_names

RESERVED = frozenset({"t", "k", "inputs", "outputs"})
"""Argument names of step functions that are not ports: time, step count, and all inputs or outputs as one flat array."""

_CONTAINER = {"STORE_SUBSCR": 2, "STORE_SLICE": 3}
"""For each instruction that stores into an array: the depth of the array in the operand stack."""


def checked(block: Block, definition: Definition, title: str) -> Definition:
    """Return the definition if its step functions use only names of the block and write all its outputs.

    Raises
    ------
    KernelError
        If they do not; `title` is the name of the block in the message.

    Warns
    -----
    UserWarning
        If the output function has an output as an argument, but stores nothing into it, as after ``y = u``.
    """
    outputs = {p.name for p in block.outputs}
    late = {p.name for p in block.inputs if not p.feedthrough}
    entries = {*definition.state, *definition.parameters, *definition.scratch}
    names = {p.name for p in block.inputs} | outputs | entries | RESERVED
    for name in definition.records:
        if name in names:
            raise KernelError(f"Block {title} has a record {name!r} and also a port or entry of that name: rename one.")
    for name, value in definition.scratch.items():
        if _is_shape(value):
            raise KernelError(
                f"Block {title} has scratch={{{name!r}: {value!r}}}, which is a shape; give an array of this shape: "
                f"np.zeros({value!r})."
            )
    for kernel in (definition.output, definition.update):
        if kernel is None:
            continue
        for name in argument_names(kernel):
            if name not in names:
                raise KernelError(
                    f"The step function {kernel.__name__!r} of block {title} has the argument {name!r}, which is no port, "
                    f"state, parameter or scratch array of the block (these are: {', '.join(sorted(names))})."
                )
            if kernel is definition.output and name in late:
                raise KernelError(
                    f"The step function {kernel.__name__!r} of block {title} reads {name!r} to write the outputs, but that input "
                    "is declared feedthrough=False; leave that out, or read it in the update function."
                )
    written = set(argument_names(definition.output)) if definition.output else set()
    unwritten = [p.name for p in block.outputs if p.name not in written and "outputs" not in written]
    if unwritten:
        raise KernelError(
            f"Block {title} has the output {unwritten[0]!r}, but no output function with an argument of that name writes it."
        )
    for kernel in (definition.output, definition.update):
        if kernel is not None:
            _check_stores(kernel, block, definition, title)
    if definition.output is not None:
        _warn_of_unwritten(definition.output, outputs, title)
    return definition


def _is_shape(value: object) -> bool:
    """Return whether scratch space is given by its shape: an array of these numbers, which mean nothing, would be too short."""
    counts = isinstance(value, tuple) and all(isinstance(n, int | np.integer) and n >= 1 for n in value)
    return counts and value not in ((), (1,))


def _warn_of_unwritten(kernel: Kernel, outputs: Set[str], title: str) -> None:
    """Warn of an output into which nothing is stored, neither here nor in a function that is called."""
    code = as_written(kernel).__code__
    for name in sorted(outputs & never_filled(code)):
        warn_user(
            f"The step function {kernel.__name__!r} of block {title} writes nothing into its output {name!r}, which has no "
            f"value (NaN). Write {name}[0] = ..., or {name}[...] = ... for all elements: {name} = ... gives the name to "
            "something else."
        )


def _check_stores(kernel: Kernel, block: Block, definition: Definition, title: str) -> None:
    stored = _stored(kernel, definition)
    fed = sorted(stored & {"inputs", *(p.name for p in block.inputs)})
    if fed:
        raise KernelError(
            f"The step function {kernel.__name__!r} of block {title} writes into its input {fed[0]!r}, which belongs to the "
            "block that feeds it; declare a state for values to keep."
        )
    written = sorted(stored & {"outputs", *(p.name for p in block.outputs)})
    if written and kernel is definition.update:
        raise KernelError(
            f"The update function {kernel.__name__!r} of block {title} writes the output {written[0]!r}, which other blocks "
            "would read too early; write a state, and copy it to the output in the output function."
        )


def _stored(kernel: Kernel, definition: Definition) -> set[str]:
    """Return the names of the arrays into which a step function stores, also of those in records."""
    written, stored = as_written(kernel), set()
    records = {name: definition.records[name] for name in argument_names(written) if name in definition.records}
    for name in stored_into(written.__code__):
        first, *rest = name.split(".")
        array: Any = records.get(first, first)
        for part in rest:
            array = getattr(array, part, None)
        stored.add(array if isinstance(array, str) else name)
    return stored


@lru_cache(maxsize=1024)  # a campaign builds many diagrams of the same few functions
def stored_into(code: CodeType) -> frozenset[str]:
    """Return the names of local variables into whose elements `code` stores.

    It follows the operand stack through the instructions. A field of a record is called ``record.field``. Stores by a function
    that is called, or through another name of the same array, are not found.
    """
    names: set[str] = set()
    stack: list[str | None] = []
    for instruction in dis.get_instructions(code):
        name, argument = instruction.opname, instruction.argval
        if name in _CONTAINER:
            depth = _CONTAINER[name]
            if len(stack) >= depth and (target := stack[-depth]) is not None:
                names.add(target)
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
    return frozenset(names)


@lru_cache(maxsize=1024)
def never_filled(code: CodeType) -> frozenset[str]:
    """Return the arguments of `code` into which it cannot store: never read, or rebound without a store before or after.

    An argument that is read may be passed to a function that stores into it, so that alone is no proof.
    """
    read, rebound, before = set(code.co_cellvars), set(), None
    for instruction in dis.get_instructions(code):
        name, given = instruction.opname, instruction.argval
        names = list(given) if isinstance(given, tuple) else [given]
        if name.startswith("STORE_FAST"):
            loads = "LOAD_FAST" in name  # of two names the first one is stored
            in_place = before is not None and before.opname == "BINARY_OP" and before.argrepr.endswith("=")
            rebound |= set() if in_place else set(names[:1] if loads else names)
            read |= set(names[1:]) if loads else set()
        elif name.startswith("LOAD_FAST"):
            read |= set(names)
        before = instruction
    arguments = set(code.co_varnames[: code.co_argcount + code.co_kwonlyargcount])
    called = any(i.opname.startswith("CALL") for i in dis.get_instructions(code))
    unread = arguments - read
    return frozenset(unread if called else unread | ((rebound & arguments) - stored_into(code)))


def _apply(stack: list[str | None], effect: int) -> None:
    """Change the depth of the stack as any other instruction does; its result on top is not a plain argument."""
    if effect < 0:
        del stack[effect:]
    stack += [None] * max(effect, 0)
    if stack and effect <= 0:
        stack[-1] = None
