"""Blocks and functions that run inside another block: their arguments renamed, and the statements that call them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.stepping.differentiation import jacobian
from bayesftc.cosim.types import Floats, Kernel, argument_names

PREFIX = "law_"


@dataclass(frozen=True)
class Embedded:
    """A control law inside a controller.

    Attributes
    ----------
    functions : mapping of str to function
        The step functions to call: ``law_output``, and where there are, ``law_update`` and ``law_derivative``.
    calls : mapping of str to str
        For each of them the statement that calls it.
    state, parameters : mapping of str to array
        What the law keeps and knows, under names with a prefix.
    """

    functions: Mapping[str, Kernel]
    calls: Mapping[str, str]
    state: Mapping[str, Floats]
    parameters: Mapping[str, Floats]


def law_sizes(law: Any) -> tuple[int, int, int] | None:
    """Return a law's number of states, goals and controls; None for a plain function, which does not know them.

    Raises
    ------
    ModelError
        If it is neither a function nor a block with the inputs x_hat and goal and the output u.
    """
    if isinstance(law, FunctionType):
        if len(argument_names(law)) != 3:
            raise ModelError(
                f"The control law {law.__name__!r} must take three arguments: x_hat, goal, and u to write."
            )
        return None
    if law is None:
        raise ModelError(
            'The controller lacks its law; give one such as law=Proportional(2.0), in a scenario law = { kind = "Proportional", '
            "gain = 2.0 }, or a function (x_hat, goal, u)."
        )
    if not isinstance(law, Block):
        raise ModelError(f"law must be a block such as Proportional(2.0), or a function (x_hat, goal, u), not {law!r}.")
    inputs, outputs = {p.name: p.size for p in law.inputs}, {p.name: p.size for p in law.outputs}
    if set(inputs) != {"x_hat", "goal"} or set(outputs) != {"u"}:
        raise ModelError(
            f"A control law has the inputs x_hat and goal and the output u; {type(law).__name__} has "
            f"{', '.join(inputs)} and {', '.join(outputs)}. Put what differs into a block of your own."
        )
    return inputs["x_hat"], inputs["goal"], outputs["u"]


def embed(law: Any, sizes: tuple[int, int, int], step: Fraction, *, differentiate: bool) -> Embedded:
    """Return a law as a part of a controller whose arrays are called ``mean``, ``goal``, ``wanted`` (u) and ``D`` (du/dx)."""
    if isinstance(law, FunctionType):
        definition, ports = Definition(law), dict(zip(argument_names(law), ("x_hat", "goal", "u"), strict=True))
    else:
        definition, ports = law.define(step), {name: name for name in ("x_hat", "goal", "u")}
    if definition.output is None or not definition.compiled:
        raise ModelError(f"The law {type(law).__name__} needs an output function that can be compiled.")
    kept = {**definition.state, **definition.scratch}
    state, parameters = _arrays(kept), _arrays(definition.parameters)
    shapes = {name: array.shape for name, array in {**state, **parameters}.items()}
    shapes |= {name: (sizes[("x_hat", "goal", "u").index(port)],) for name, port in ports.items()}
    here = {"x_hat": "mean", "goal": "goal", "u": "wanted"}
    renamed = {name: PREFIX + name for name in (*state, *parameters)} | {n: here[p] for n, p in ports.items()}
    functions: dict[str, Kernel] = {"law_output": definition.output}
    if definition.update is not None:
        functions["law_update"] = definition.update
    calls = {}
    for name, function in functions.items():
        unknown = [a for a in argument_names(function) if a not in {*renamed, "t", "k"}]
        if unknown:
            raise ModelError(
                f"The law's step function {function.__name__!r} asks for {unknown[0]!r}; inside a controller a law has its "
                "ports, states, parameters and scratch space by name, t and k."
            )
        calls[name] = f"{name}({', '.join(renamed.get(a, a) for a in argument_names(function))})"
    if differentiate:
        u, x = (next(name for name, port in ports.items() if port == wanted) for wanted in ("u", "x_hat"))
        if {"t", "k"} & set(argument_names(definition.output)):
            raise ModelError("A law that depends on time is not differentiated; take control='law'.")
        function = jacobian(definition.output, shapes, u, [x])
        functions["law_derivative"] = function
        given = [renamed[a] for a in argument_names(function)[:-1]]
        calls["law_derivative"] = f"law_derivative({', '.join([*given, 'D'])})"
    return Embedded(
        functions,
        calls,
        {PREFIX + name: array for name, array in state.items()},
        {PREFIX + name: array for name, array in parameters.items()},
    )


def run_once(embedded: Embedded, name: str, arrays: Mapping[str, Floats]) -> None:
    """Call one of the law's functions in plain Python on the given arrays, with its own first state and parameters."""
    values = {**embedded.state, **embedded.parameters, **arrays, "t": np.float64(0.0), "k": np.int64(0)}
    names = embedded.calls[name].removeprefix(f"{name}(").removesuffix(")").split(", ")
    with np.errstate(all="ignore"):
        embedded.functions[name](*[values[n] for n in names])


def _arrays(values: Mapping[str, Any]) -> dict[str, Floats]:
    return {name: np.atleast_1d(np.asarray(value, dtype=np.float64)) for name, value in values.items()}
