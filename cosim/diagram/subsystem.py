"""A diagram with free ports as one block: its inputs and outputs refer to ports of the blocks inside."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from fractions import Fraction
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.diagram.nodes import Node, PortRef
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, listed

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.run.online import Online

INSIDE = "inside"
"""The input of a `Boundary` that gets the outputs of the blocks inside."""

Inner = PortRef | str | Sequence[PortRef | str]
"""One or several ports of blocks inside."""


def _show(inside, outputs):
    for i in range(outputs.shape[0]):
        outputs[i] = inside[i]


@dataclass(frozen=True)
class Boundary(Block):
    """The ports of a subsystem in the diagram that contains it.

    Its outputs are only for results: other blocks get those of the blocks inside, and the blocks inside what feeds its inputs.
    """

    free: tuple[Port, ...]
    shown: tuple[Port, ...]
    step: Fraction
    inside: Diagram | None = field(default=None, compare=False, repr=False)
    goals: tuple[str, ...] = ()
    led: tuple[str, ...] = ()
    """Names of the blocks inside whose goal is that of the subsystem."""

    @property
    def sample_time(self) -> Fraction:
        """The sample time of the subsystem."""
        return self.step

    @property
    def inputs(self) -> tuple[Port, ...]:
        """The subsystem's inputs, and ``inside``, the outputs of its blocks."""
        return (*self.free, Port(INSIDE, (sum(port.size for port in self.shown),)))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The subsystem's outputs."""
        return self.shown

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        return Definition(_show)

    def offset(self, output: Port) -> int:
        """Return the first element of ``inside`` that belongs to an output."""
        names = [port.name for port in self.shown]
        return sum(port.size for port in self.shown[: names.index(output.name)])


class Subsystem(Block):
    """A diagram as one block: for other diagrams, closed loops, exports and python-control.

    The diagram that gets it adds the blocks inside under the names ``<name>.<block>``. All blocks run in one order, so that a
    subsystem makes no algebraic loop. Results have the signals of the blocks inside (``speed.integral.y``) and of the subsystem
    itself (``speed.u``). Settings of the blocks inside can be factors of a campaign: ``speed.gain.gain``.

    Parameters
    ----------
    diagram : Diagram
        The blocks inside, with their connections, at their sample time. It may contain subsystems. Later changes of it do not
        change this block.
    inputs : mapping of str to port or sequence of ports, optional
        For each input the inputs of blocks inside that it feeds: ``{"e": ["gain.u", "integral.u"]}``. By default each input of a
        block inside that has no source and is not random, under the name of its port (``<block>_<port>`` if several have this
        name).
    outputs : mapping of str to port or sequence of ports, optional
        For each output, the outputs of blocks inside that form it, one after the other. By default each output that feeds
        no block inside.
    goals : sequence of str, optional
        Of a controller: the measured quantity of each element of its input ``goal``, such as ``["angle"]``, for tracking errors
        and figures. Not needed where each quantity has a goal.

    Raises
    ------
    ModelError
        If an input has a source inside, the ports that share an input differ in size, or there is no output.
    UnknownNameError
        If the diagram has no block or port of a name.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> inside = cosim.Diagram(dt=0.1)
    >>> gain, integral = inside.add(cosim.Gain(2.0), "gain"), inside.add(cosim.Integrator(), "integral")
    >>> total = inside.add(cosim.Sum("++"), "total")
    >>> inside.connect([gain["y"], integral["y"]], total["u"])
    >>> pi = cosim.Subsystem(inside, inputs={"e": ["gain.u", "integral.u"]}, outputs={"u": "total.y"})
    >>> outside = cosim.Diagram(dt=0.1)
    >>> error, controller = outside.add(cosim.Constant(3.0), "error"), outside.add(pi, "controller")
    >>> outside.connect(error["y"], controller["e"])
    >>> float(outside.simulate(1.0)["controller.u"][-1].round(9))
    9.0
    """

    def __init__(
        self,
        diagram: Diagram,
        inputs: Mapping[str, Inner] | None = None,
        outputs: Mapping[str, Inner] | None = None,
        goals: Sequence[str] = (),
    ):
        if not isinstance(getattr(diagram, "nodes", None), tuple):
            raise ModelError(f"Subsystem needs a diagram, not {diagram!r}.")
        self.diagram = copy(diagram)
        self.goals = (goals,) if isinstance(goals, str) else tuple(goals)
        if not all(isinstance(name, str) for name in self.goals) or len(set(self.goals)) < len(self.goals):
            raise ModelError(
                f"goals of a subsystem is {goals!r}; give the measured quantity of each goal once, as ['angle']."
            )
        self.fed = self._ports(_free(diagram) if inputs is None else inputs, "input")
        self.shown = self._ports(_open(diagram) if outputs is None else outputs, "output")
        names = [*self.fed, *self.shown]
        if not self.shown:
            raise ModelError('A subsystem needs at least one output: give outputs={"y": "block.y"}.')
        if twice := [name for name in {*names, INSIDE} if [*names, INSIDE].count(name) > 1]:
            raise ModelError(
                f"Two ports of the subsystem have the name {twice[0]!r}; give one of them another name in inputs= or outputs=."
                if twice[0] != INSIDE
                else f"A port of a subsystem cannot be named {INSIDE!r}; give it another name."
            )
        for name, references in self.fed.items():
            if len({len(reference) for reference in references}) > 1:
                sizes = ", ".join(f"{reference.name} ({len(reference)})" for reference in references)
                raise ModelError(
                    f"The ports that the input {name!r} feeds differ in size: {sizes}. Use an input for each size."
                )
        taken = [reference for references in self.fed.values() for reference in references]
        for reference in taken:
            for i in reference.elements:
                if next(diagram.origins_of(reference.node, reference.port, i), None) is not None:
                    raise ModelError(f"{reference.name} has a source inside the subsystem; it cannot be an input, too.")
        places = [(reference.node.name, reference.port.name, i) for reference in taken for i in reference.elements]
        if len(set(places)) < len(places):
            raise ModelError("Two inputs of the subsystem feed the same port inside; name each port once in inputs=.")

    def _ports(self, given: Mapping[str, Inner], direction: str) -> dict[str, tuple[PortRef, ...]]:
        if not isinstance(given, Mapping):
            raise ModelError(f"{direction}s= of a subsystem is a mapping from names to ports, not {given!r}.")
        ports = {}
        for name, inner in given.items():
            if not isinstance(name, str) or not name or any(c.isspace() for c in name):
                raise ModelError(
                    f"{name!r} cannot be the name of an {direction}: it must not be empty or contain spaces."
                )
            several: list[Any] = list(inner) if isinstance(inner, list | tuple) else [inner]
            if not several:
                raise ModelError(f"The {direction} {name!r} of the subsystem refers to no port; name at least one.")
            ports[name] = tuple(_reference(self.diagram, each, direction) for each in several)
        return ports

    @property
    def boundary(self) -> Boundary:
        """The block that has its ports in the diagram that contains it."""
        led = tuple(each.node.name for each in self.fed.get("goal", ()) if each.port.name == "goal")
        return Boundary(self.inputs, self.outputs, self.diagram.step, self.diagram, self.goals, led)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """The inputs, each with shape, unit and start value of the first port inside that it feeds."""
        return tuple(_port(name, references[:1]) for name, references in self.fed.items())

    @property
    def outputs(self) -> tuple[Port, ...]:
        """The outputs."""
        return tuple(_port(name, references) for name, references in self.shown.items())

    @property
    def sample_time(self) -> Fraction:
        """The base step of the diagram inside."""
        return self.diagram.step

    def define(self, step: Fraction) -> Definition:
        """Raise an error: a subsystem has no step functions of its own."""
        raise ModelError(
            "A subsystem runs only in a diagram, which adds the blocks inside. Add it to one, and simulate that."
        )

    def online(self, dt: float | str | Fraction | None = None, *, compiled: bool = True) -> Online:
        """Return the subsystem as a callable that makes one step; see `Block.online`.

        Parameters
        ----------
        dt : float, str or Fraction, optional
            Not needed; if given, the sample time of the diagram inside.
        compiled : bool
            False for the plain Python form, which you can step through in a debugger.
        """
        from bayesftc.cosim.run.online_subsystem import OnlineSubsystem

        return OnlineSubsystem(self, dt, compiled=compiled)

    def __repr__(self) -> str:
        ports = f"{listed(self.inputs)} -> {listed(self.outputs)}"
        return f"<Subsystem of {len(self.diagram.nodes)} blocks at {float(self.diagram.step):g} s: {ports}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self))}</p>\n{self.diagram._repr_html_()}"


def outermost(diagram: Diagram) -> list[Node]:
    """Return the blocks that are not inside a subsystem."""
    inside = tuple(f"{node.name}." for node in diagram.nodes if isinstance(node.block, Boundary))
    return [node for node in diagram.nodes if not node.name.startswith(inside)]


def with_inside(diagram: Diagram, names: Iterable[str]) -> list[str]:
    """Return the names of blocks, and of the blocks inside those that are subsystems, in the order of the diagram."""
    chosen = {diagram[name].name for name in names}
    inside = tuple(f"{name}." for name in chosen if isinstance(diagram[name].block, Boundary))
    return [node.name for node in diagram.nodes if node.name in chosen or node.name.startswith(inside)]


def port_named(diagram: Diagram, name: str, whole: str = "The diagram") -> PortRef:
    """Return a port by its name, ``"block.port"`` or an element of it, also of a block inside a subsystem.

    Parameters
    ----------
    diagram : Diagram
        The diagram.
    name : str
        The name.
    whole : str
        What the diagram is called in the error message.

    Raises
    ------
    UnknownNameError
        If there is no such block or port.
    """
    names = {node.name: node for node in diagram.nodes}
    owners = [owner for owner in names if name.startswith(f"{owner}.")]
    if not owners:
        raise UnknownNameError(
            f"{whole} has no block for {name!r}; name a port as 'block.port'; {did_you_mean(name.split('.')[0], names)}"
        )
    owner = max(owners, key=len)
    return names[owner][name[len(owner) + 1 :]]


def _reference(diagram: Diagram, port: PortRef | str, direction: str) -> PortRef:
    """Return a reference to a port of a block of the diagram, which must be on the right side of the block."""
    if isinstance(port, str):
        port = port_named(diagram, port, "The subsystem")
    if not isinstance(port, PortRef):
        raise ModelError(
            f"An {direction} of a subsystem refers to a port, such as node['y'] or 'node.y', not to {port!r}."
        )
    if port.node not in diagram.nodes:
        raise ModelError(f"{port.name} belongs to a block of another diagram than the subsystem's.")
    if port.direction != direction:
        raise ModelError(f"{port.name} is an {port.direction}; it cannot be an {direction} of the subsystem.")
    return port


def _port(name: str, references: Sequence[PortRef]) -> Port:
    """Return a port of the subsystem for ports inside, one after the other."""
    first = references[0].port
    if len(references) == 1 and len(references[0]) == first.size:
        port = replace(first, name=name)
    else:
        units = {(reference.port.unit, reference.port.meaning) for reference in references}
        unit, meaning = units.pop() if len(units) == 1 else (None, None)
        size = sum(map(len, references))
        default = None
        if first.default is not None:
            starts = np.broadcast_to(np.asarray(first.default, float), first.shape).ravel()
            default = tuple(float(starts[i]) for i in references[0].elements)
        port = Port(
            name, (size,), unit, default=default, draw=first.draw, meaning=meaning, description=first.description
        )
        if size == 1:
            port = replace(port, shape=(), default=default and default[0])
    return replace(port, feedthrough=False)


def _free(diagram: Diagram) -> dict[str, Inner]:
    """Return the inputs without a source, except for random ones."""
    return _named(
        [
            PortRef(node, port, "input", elements)
            for node in diagram.nodes
            for port in node.inputs
            if port.draw is None
            if (elements := tuple(i for i in range(port.size) if next(diagram.origins_of(node, port, i), None) is None))
        ]
    )


def _open(diagram: Diagram) -> dict[str, Inner]:
    """Return the outputs that feed no block."""
    used = {
        (origin.node.name, origin.port.name)
        for node in diagram.nodes
        for port in node.inputs
        for i in range(port.size)
        for origin, _ in diagram.origins_of(node, port, i)
        if not isinstance(node.block, Boundary)
    }
    return _named(
        [
            PortRef(node, port, "output", tuple(range(port.size)))
            for node in outermost(diagram)
            for port in node.outputs
            if (node.name, port.name) not in used
        ]
    )


def _named(references: Sequence[PortRef]) -> dict[str, Inner]:
    """Return ports by their names, with the names of their blocks where several have one name."""
    counts = Counter(reference.port.name for reference in references)
    return {r.port.name if counts[r.port.name] == 1 else f"{r.node.name}_{r.port.name}": r for r in references}
