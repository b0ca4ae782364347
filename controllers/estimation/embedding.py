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
        The step functions to call: ``law_output``, and if they exist ``law_update`` and ``law_derivative``.
    calls : mapping of str to str
        The statement that calls each of them.
    state, parameters : mapping of str to array
        State and parameters of the law, under names with a prefix.
    """

    functions: Mapping[str, Kernel]
    calls: Mapping[str, str]
    state: Mapping[str, Floats]
    parameters: Mapping[str, Floats]


def law_sizes(law: Any) -> tuple[int, int, int] | None:
    """Return a law's number of states, goals and controls; None for a plain function, which has no sizes.

    Raises
    ------
    ModelError
        If it is neither a function nor a block with the inputs x_hat and goal and the output u.
    """
    if isinstance(law, FunctionType):
        if len(argument_names(law)) != 3:
            raise ModelError(
                f"The control law {law.__name__!r} must have three arguments: x_hat, goal, and u, which it writes."
            )
        return None
    if law is None:
        raise ModelError(
            'The controller lacks its law. Give one such as law=Proportional(2.0), in a scenario law = { kind = "Proportional", '
            "gain = 2.0 }, or a function (x_hat, goal, u)."
        )
    if not isinstance(law, Block):
        raise ModelError(f"law is {law!r}; give a block such as Proportional(2.0), or a function (x_hat, goal, u).")
    inputs, outputs = {p.name: p.size for p in law.inputs}, {p.name: p.size for p in law.outputs}
    if set(inputs) != {"x_hat", "goal"} or set(outputs) != {"u"}:
        raise ModelError(
            f"A control law must have the inputs x_hat and goal and the output u, but {type(law).__name__} has "
            f"{', '.join(inputs)} and {', '.join(outputs)}. Wrap it in a block with these ports."
        )
    return inputs["x_hat"], inputs["goal"], outputs["u"]


def embed(law: Any, sizes: tuple[int, int, int], step: Fraction, *, differentiate: bool) -> Embedded:
    """Embed a law in a controller with the arrays ``mean``, ``goal``, ``law_control`` (u) and ``D`` (du/dx)."""
    if isinstance(law, FunctionType):
        definition, ports = Definition(law), dict(zip(argument_names(law), ("x_hat", "goal", "u"), strict=True))
    else:
        definition, ports = law.define(step), {name: name for name in ("x_hat", "goal", "u")}
    if definition.output is None or not definition.compiled:
        raise ModelError(f"The law {type(law).__name__} has no output function that can be compiled; give it one.")
    kept = {**definition.state, **definition.scratch}
    state, parameters = _arrays(kept), _arrays(definition.parameters)
    shapes = {name: array.shape for name, array in {**state, **parameters}.items()}
    shapes |= {name: (sizes[("x_hat", "goal", "u").index(port)],) for name, port in ports.items()}
    here = {"x_hat": "mean", "goal": "goal", "u": "law_control"}
    renamed = {name: PREFIX + name for name in (*state, *parameters)} | {n: here[p] for n, p in ports.items()}
    functions: dict[str, Kernel] = {"law_output": definition.output}
    if definition.update is not None:
        functions["law_update"] = definition.update
    calls = {}
    for name, function in functions.items():
        unknown = [a for a in argument_names(function) if a not in {*renamed, "t", "k"}]
        if unknown:
            raise ModelError(
                f"The law's step function {function.__name__!r} has the argument {unknown[0]!r}. Inside a controller a law may "
                "only have its ports, states, parameters and scratch space by name, t and k."
            )
        calls[name] = f"{name}({', '.join(renamed.get(a, a) for a in argument_names(function))})"
    if differentiate:
        u, x = (next(name for name, port in ports.items() if port == port_name) for port_name in ("u", "x_hat"))
        if {"t", "k"} & set(argument_names(definition.output)):
            raise ModelError("A law that depends on time cannot be differentiated; use control='law'.")
        function = jacobian(definition.output, shapes, u, [x])
        functions["law_derivative"] = function
        derivative_arguments = [renamed[a] for a in argument_names(function)[:-1]]
        calls["law_derivative"] = f"law_derivative({', '.join([*derivative_arguments, 'D'])})"
    return Embedded(
        functions,
        calls,
        {PREFIX + name: array for name, array in state.items()},
        {PREFIX + name: array for name, array in parameters.items()},
    )


def run_once(embedded: Embedded, name: str, arrays: Mapping[str, Floats]) -> None:
    """Call one of the law's functions in plain Python on the given arrays, with the law's initial state and parameters."""
    values = {**embedded.state, **embedded.parameters, **arrays, "t": np.float64(0.0), "k": np.int64(0)}
    names = embedded.calls[name].removeprefix(f"{name}(").removesuffix(")").split(", ")
    with np.errstate(all="ignore"):
        embedded.functions[name](*[values[n] for n in names])


def _arrays(values: Mapping[str, Any]) -> dict[str, Floats]:
    return {name: np.atleast_1d(np.asarray(value, dtype=np.float64)) for name, value in values.items()}
