"""Blocks in a diagram, and references to their ports for connections."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

from bayesftc.cosim.block import Block
from bayesftc.cosim.errors import ConnectionError, UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, labels, without_brackets


@dataclass(frozen=True, eq=False)
class Node:
    """A ``block`` in a diagram, with its ``name``; ``node["y"]`` refers to its port.

    For a vector or matrix port, ``node["y[1]"]`` (the same as ``node["y"][1]``) and ``node["K[0,1]"]`` refer to one element. The
    block runs at every ``every``-th base step.

    Attributes
    ----------
    name : str
        Name in the diagram.
    block : Block
        The block.
    every : int
        Base steps from one step of the block to the next.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=(1.0, 2.0)), "noise")
    >>> filtered = diagram.add(cosim.ExponentialFilter(1.0), "filter", every=2)
    >>> diagram.connect(noise["y[1]"], filtered["u"])
    >>> print(noise["y[1]"].name, noise.port("y").shape, filtered.every)
    noise.y[1] (2,) 2
    """

    name: str
    block: Block
    every: int

    @cached_property
    def inputs(self) -> tuple[Port, ...]:
        """The inputs of the block, kept here because the block makes new ports at each access."""
        return tuple(self.block.inputs)

    @cached_property
    def outputs(self) -> tuple[Port, ...]:
        """The outputs of the block."""
        return tuple(self.block.outputs)

    def port(self, name: str) -> Port:
        """Return the port of that name, as `Block.port` does."""
        match = next((port for port in (*self.outputs, *self.inputs) if port.name == name), None)
        return self.block.port(name) if match is None else match  # Block.port raises with the list of names

    def __getstate__(self) -> dict[str, Any]:
        return {"name": self.name, "block": self.block, "every": self.every}

    def __getitem__(self, port: str) -> PortRef:
        directions: list[tuple[Literal["input", "output"], tuple[Port, ...]]] = [
            ("output", self.outputs),
            ("input", self.inputs),
        ]
        for direction, ports in directions:
            for candidate in ports:
                if candidate.name == port:
                    return PortRef(self, candidate, direction, tuple(range(candidate.size)))
        for direction, ports in directions:
            for candidate in ports:
                if candidate.shape and port in (elements := labels(candidate.name, candidate.shape)):
                    return PortRef(self, candidate, direction, (elements.index(port),))
        names = [p.name for _, ports in directions for p in ports]
        if plain := without_brackets(str(port), [p.name for _, ports in directions for p in ports if not p.shape]):
            return self[plain]
        if elements := [name for name in names if name.startswith(f"{port}[")]:
            raise UnknownNameError(
                f"Block {self.name!r} has no port {port!r}, but {' and '.join(elements[:2])}, each a port. Connect them one by "
                f"one, or give FMU the argument arrays=True: then they are one port {port!r}."
            )
        raise UnknownNameError(f"Block {self.name!r} has no port {port!r}; {did_you_mean(port, names)}")

    def __repr__(self) -> str:
        return f"<{self.name}: {type(self.block).__name__}>"


@dataclass(frozen=True)
class PortRef:
    """A port of a block in a diagram, or some of its elements: ``node["y"]``, ``node["y"][0]``.

    Attributes
    ----------
    node : Node
        The block in its diagram.
    port : Port
        The port.
    direction : {"input", "output"}
        The side of the block.
    elements : tuple of int
        The elements referred to, in order.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise, total = diagram.add(cosim.Gaussian(std=(1.0, 2.0)), "noise"), diagram.add(cosim.Sum("+-"), "total")
    >>> diagram.connect([noise["y"][1], noise["y"][0]], total["u"])
    >>> run = diagram.simulate(0.1, record=[noise["y"], total["y"]], engine="interpreted")
    >>> bool((run["total.y"] == run["noise.y"][:, 1] - run["noise.y"][:, 0]).all())
    True
    """

    node: Node
    port: Port
    direction: Literal["input", "output"]
    elements: tuple[int, ...]

    @property
    def name(self) -> str:
        """``block.port``, with an index if the reference is to some elements only."""
        whole = f"{self.node.name}.{self.port.name}"
        if len(self.elements) == self.port.size:
            return whole
        return whole + "[" + ", ".join(map(str, self.elements)) + "]"

    def with_unit_of(self, element: int) -> str:
        """Return the name of what has the unit of one element: that element, if the elements have different units."""
        return label(PortRef(self.node, self.port, self.direction, (element,))) if self.port.units else self.name

    def __getitem__(self, index: int | slice) -> PortRef:
        try:
            chosen = self.elements[index] if isinstance(index, slice) else (self.elements[index],)
        except (IndexError, TypeError):
            chosen = ()
        if not chosen:
            raise ConnectionError(
                f"{self.name} has {len(self.elements)} elements, numbered from 0 (a matrix row by row); there is no element "
                f"{index!r}."
            )
        return PortRef(self.node, self.port, self.direction, chosen)

    def __repr__(self) -> str:
        return f"<{self.direction} {self.name}{f' in {self.port.unit}' if self.port.unit else ''}>"

    def __len__(self) -> int:
        return len(self.elements)

    def __iter__(self) -> Iterator[PortRef]:
        return (self[i] for i in range(len(self)))


def label(reference: PortRef) -> str:
    """Return the name in results of a port, or of the one element referred to: ``plant.K[0,1]``."""
    if len(reference.elements) != 1 or not reference.port.shape:
        return reference.name
    return labels(f"{reference.node.name}.{reference.port.name}", reference.port.shape)[reference.elements[0]]
