"""Blocks and diagrams as systems of python-control: `Block.to_control` and `Diagram.to_control`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import control
import numpy as np

from bayesftc.cosim._control.equations import Equations
from bayesftc.cosim._control.machine import Machine
from bayesftc.cosim.block import Block, Definition, Floats
from bayesftc.cosim.diagram import Diagram, Node
from bayesftc.cosim.errors import ModelError, UnconnectedInputError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmu import FMU
from bayesftc.cosim.ports import Port, labels

Names = Sequence[str] | Mapping[str, str] | str
Element = tuple[str, str, int]
"""Block, port and element of a scalar signal."""

_OUTSIDE = "<outside>"


class ControlSystem(control.NonlinearIOSystem):  # type: ignore[misc]
    """A block or a diagram as a system of python-control; made by `Block.to_control` and `Diagram.to_control`.

    Its functions of time, state and inputs are pure: they can be asked in any order, and a system may stand twice in a diagram.

    Parameters
    ----------
    machine : Machine or Equations
        What evaluates the diagram, in discrete time, or a model exchange FMU, in continuous time.
    name, dt, inputs, outputs, states
        As for ``control.nlsys``.
    """

    def __init__(
        self,
        machine: Machine | Equations,
        name: str | None,
        dt: float,
        inputs: Sequence[str],
        outputs: Sequence[str],
        states: Sequence[str],
    ):
        super().__init__(
            machine.update,
            machine.output,
            name=name,
            dt=dt,
            inputs=list(inputs),
            outputs=list(outputs),
            states=list(states),
        )
        self._machine = machine

    @property
    def initial_state(self) -> Floats:
        """The state in which the block or the diagram begins, for ``X0=...``: python-control itself begins at zeros."""
        return self._machine.initial.copy()

    def linearize(self, x0: Any, u0: Any = None, *args: Any, **settings: Any) -> Any:
        """Return the linearization at a state and inputs, as ``control.linearize`` describes it.

        Parameters
        ----------
        x0, u0, args, settings
            See ``control.linearize``.

        Raises
        ------
        ModelError
            If there is an FMU in it whose state is known to itself alone.
        """
        if self._machine.opaque:
            raise ModelError(
                f"The state of the FMU {self._machine.opaque[0]!r} is known to itself alone, so that it cannot be linearized in "
                "python-control: LinearModel.from_fmu makes a linear model of it."
            )
        hints = self._machine.hints
        told, hints.told = hints.told, True  # whoever asks for zeros here means them
        try:
            return super().linearize(x0, u0, *args, **settings)
        finally:
            hints.told = told


def initial_state(system: Any) -> Floats:
    """Return the state in which a python-control system begins, for ``X0=...``; python-control itself begins at zeros.

    Parameters
    ----------
    system : control.InputOutputSystem
        What `Block.to_control` or `Diagram.to_control` has made, or an interconnection with such systems in it. Systems of
        python-control begin at zeros.

    Returns
    -------
    ndarray
        A number for each state.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> cosim.initial_state(cosim.UnitDelay(initial=3.0).to_control(dt=0.1)).tolist()
    [3.0]
    """
    if isinstance(system, control.InterconnectedSystem):
        return np.concatenate([np.zeros(0), *(initial_state(part) for part in system.syslist)])
    if isinstance(system, ControlSystem):
        return system.initial_state
    return np.zeros(system.nstates or 0)


def block_to_control(
    block: Block,
    dt: float | str | Fraction | None,
    inputs: Names | None,
    outputs: Names | None,
    seed: int | None,
    engine: str,
    name: str | None,
) -> ControlSystem:
    """Return a block as a system of python-control; `Block.to_control` describes the arguments."""
    step = block.sample_time if dt is None else dt
    continuous = step is None and isinstance(block, FMU) and block.kind == "model exchange"
    if step is None and not continuous:
        raise ModelError(f"{type(block).__name__} does not know its sample time; give to_control(dt=...) in seconds.")
    diagram = Diagram(1 if step is None else step)
    node = diagram.add(block, name)
    if inputs is None:
        inputs = [port.name for port in block.inputs if port.draw is None]
    known = {port.name: (node, port) for port in block.inputs}, {port.name: (node, port) for port in block.outputs}
    if continuous and isinstance(block, FMU):
        return _equations(block, known, inputs, outputs, node.name)
    return _system(diagram, known, inputs, outputs, seed, engine, node.name, f"{node.name}.")


def diagram_to_control(
    diagram: Diagram, inputs: Names | None, outputs: Names | None, seed: int | None, engine: str, name: str | None
) -> ControlSystem:
    """Return a diagram as a system of python-control; `Diagram.to_control` describes the arguments."""
    sides = [
        {f"{node.name}.{port.name}": (node, port) for node in diagram.nodes for port in getattr(node.block, side)}
        for side in ("inputs", "outputs")
    ]
    if inputs is None:
        inputs = list(_needed(diagram))
    return _system(diagram, (sides[1] | sides[0], sides[1]), inputs, outputs, seed, engine, name)


Signals = Mapping[str, tuple[Node, Port]]


def _system(
    diagram: Diagram,
    known: tuple[Signals, Signals],
    inputs: Names,
    outputs: Names | None,
    seed: int | None,
    engine: str,
    name: str | None,
    prefix: str = "",
) -> ControlSystem:
    given = _chosen(known[0], inputs, "input")
    shown = _chosen(known[1], list(known[1]) if outputs is None else outputs, "output")
    whole, places = _opened(diagram, list(given.values()))
    machine = Machine(whole, places, [(node.name, port.name, i) for node, port, i in shown.values()], seed, engine)
    states = [allowed(state.removeprefix(prefix)) for state in machine.names]
    return ControlSystem(machine, name, float(diagram.step), list(given), list(shown), states)


def _equations(
    fmu: FMU, known: tuple[Signals, Signals], inputs: Names, outputs: Names | None, name: str
) -> ControlSystem:
    given = _chosen(known[0], inputs, "input")
    shown = _chosen(known[1], list(known[1]) if outputs is None else outputs, "output")
    model = Equations(fmu, *([(port, i) for _, port, i in side.values()] for side in (given, shown)))
    states = [allowed(state) for state in model.names]
    return ControlSystem(model, name, 0.0, list(given), list(shown), states)


def _chosen(known: Signals, names: Names, what: str) -> dict[str, tuple[Node, Port, int]]:
    """Return the scalar signals that are meant, each by its label: ``y[0]``, ``y[1]`` for a vector ``y`` or an element of it."""
    listed = [names] if isinstance(names, str) else names
    renamed = names if isinstance(names, Mapping) else {name: name for name in listed}
    if len(renamed) < len(listed):
        raise ModelError(f"to_control has one of its {what}s twice: {', '.join(listed)}; name each once.")
    chosen: dict[str, tuple[Node, Port, int]] = {}
    for signal, label in renamed.items():
        label = allowed(label)
        if signal in known:
            node, port = known[signal]
            scalars = {scalar: (node, port, i) for i, scalar in enumerate(labels(label, port.shape))}
        else:
            scalars = {label: _one(known, signal, what)}
        for scalar, place in scalars.items():
            if scalar in chosen or place in chosen.values():
                raise ModelError(
                    f"to_control has two {what}s {scalar!r}, or one of them twice; name each once, and give one of them another "
                    f"name, as in {what}s={{{signal!r}: 'other'}}."
                )
            chosen[scalar] = place
    return chosen


def allowed(label: str) -> str:
    """Return a signal's name as python-control allows it: without dots, which divide systems from signals there."""
    return label.replace(".", "_")


def _one(known: Signals, signal: str, what: str) -> tuple[Node, Port, int]:
    match = re.fullmatch(r"(.+)\[([\d,]+)\]", signal)
    if match and match[1] in known:
        node, port = known[match[1]]
        elements = labels(match[1], port.shape)
        if signal in elements:
            return node, port, elements.index(signal)
    raise UnknownNameError(f"There is no {what} {signal!r}; {did_you_mean(signal, known)}")


def _hand_on(u, y):
    for i in range(y.shape[0]):
        y[i] = u[i]


@dataclass(frozen=True)
class _Outside(Block):
    """Stands in a diagram for all that comes from outside: ``y`` is ``u``."""

    size: int

    @property
    def inputs(self) -> tuple[Port, ...]:
        return (Port("u", (self.size,), default=0.0),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        return (Port("y", (self.size,)),)

    def define(self, step: Fraction) -> Definition:
        return Definition(_hand_on)


def _needed(diagram: Diagram) -> dict[str, tuple[Node, Port, int]]:
    """Return the scalar inputs that have neither a source nor a start value."""
    return {
        label: (node, port, i)
        for node in diagram.nodes
        for port in node.block.inputs
        for i, label in enumerate(labels(f"{node.name}.{port.name}", port.shape))
        if port.draw is None and port.default is None and diagram.source_of(node, port, i) is None
    }


def _opened(diagram: Diagram, given: Sequence[tuple[Node, Port, int]]) -> tuple[Diagram, list[Element]]:
    """Return a copy of the diagram in which the given signals come from outside, and where they are put in.

    An output that comes from outside is no longer heard: all that it feeds is fed from outside.
    """
    whole = copy(diagram)
    coupling, whole._coupling = whole._coupling, None
    outside = whole.add(_Outside(len(given)), _OUTSIDE) if given else None
    for j, (node, port, i) in enumerate(given):
        assert outside is not None
        targets = [(node.name, port.name, i)]
        if any(port.name == output.name for output in node.block.outputs):
            targets = [
                target
                for target, (source, element) in diagram._sources.items()
                if source.node is node and source.port.name == port.name and element == i
            ]
        for target in targets:
            whole._sources[target] = outside["y"], j
    for name, (node, _, _) in _needed(whole).items():
        raise UnconnectedInputError(
            f"The input {name} of {type(node.block).__name__} has neither a source nor a start value; name it among the inputs "
            "of to_control, as it is by default."
        )
    whole.build(coupling)
    return whole, [(_OUTSIDE, "u", j) for j in range(len(given))]


__all__ = ["ControlSystem", "initial_state"]
