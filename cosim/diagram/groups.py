"""Groups of blocks that are computed together: their members, the order of a sweep, and the guessed values.

There are two kinds. A *loop* belongs to the evaluation of t_k: blocks whose outputs at t_k depend on each other. A *step*
advances FMUs from t_k to t_k+1 together, and also computes the stateless blocks between them. In both, outputs that a block
needs before they are computed are guessed. A sweep through the group computes them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bayesftc.cosim.types import argument_names

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.coupling import Coupling
    from bayesftc.cosim.diagram.schedule import Schedule
    from bayesftc.cosim.ports import Port

Pair = tuple[int, int]
"""A copy: target and source in memory."""

WORDS = 6
"""Words of memory for each FMU that is restored: its address, the functions that save, restore and free, two saved states."""


@dataclass(frozen=True)
class Part:
    """One call of a sweep.

    Attributes
    ----------
    node : int
        Number of the node.
    kind : {"output", "update", "ahead"}
        Which step function; ``ahead`` computes outputs at the end of a step.
    gathers : tuple of (int, int, int)
        Copies of the inputs: target, source, and a second source for a mean of both, or -1.
    outputs : int
        Place of the outputs in memory.
    """

    node: int
    kind: Literal["output", "update", "ahead"]
    gathers: tuple[tuple[int, int, int], ...]
    outputs: int


@dataclass(frozen=True)
class Group:
    """Blocks that are computed together.

    Attributes
    ----------
    nodes : tuple of int
        Numbers of the members.
    every : int
        The multiple of the base step at which the group is computed.
    parts : tuple of Part
        One sweep.
    torn, guesses : tuple of int
        Places of the guessed values, and of the first guesses.
    names : tuple of str
        Names of the guessed values.
    externals : tuple of int
        The FMUs among the members that make steps, and so must be restored.
    states : tuple of (int, int)
        Begin and end of the states of the other members with states.
    words : int
        Place of the words about the FMUs.
    doubling : tuple of five int
        For each output of a member, the places of its values: at t_k, at the beginning and at the end of a substep of the
        group, at the end of a step of double size, and a copy of that at the beginning. Empty without `Coupling.step_error`.
    size : int
        Place of the group's substep size, as a fraction of the step.
    """

    nodes: tuple[int, ...]
    every: int
    parts: tuple[Part, ...]
    torn: tuple[int, ...]
    guesses: tuple[int, ...]
    names: tuple[str, ...]
    externals: tuple[int, ...]
    states: tuple[Pair, ...]
    words: int
    doubling: tuple[tuple[int, int, int, int, int], ...] = ()
    size: int = -1

    @property
    def is_loop(self) -> bool:
        """Whether the group is an algebraic loop at t_k."""
        return all(part.kind == "output" for part in self.parts)

    @property
    def restores(self) -> bool:
        """Whether its FMUs must be able to restore a state."""
        return bool(self.torn or self.doubling)


class Places:
    """Allocates places after the memory of a diagram's blocks."""

    def __init__(self, begin: int):
        self.end = begin

    def take(self, count: int) -> int:
        """Allocate `count` places and return the first."""
        begin, self.end = self.end, self.end + count
        return begin


class Grouping:
    """Finds the groups of a schedule and lays them out.

    Parameters
    ----------
    schedule : Schedule
        The schedule, with its blocks laid out.
    sources : callable
        Returns the copies (target, source) of a node's inputs: of those that feed through, or of all.
    coupling : Coupling
        How FMUs are coupled.
    """

    def __init__(self, schedule: Schedule, sources: Callable[[int, bool | None], tuple[Pair, ...]], coupling: Coupling):
        self._schedule, self._sources, self._coupling = schedule, sources, coupling
        self.places = Places(len(schedule.initial))
        self._ahead: dict[int, int] = {}
        self._now: dict[int, int] = {}
        self._owners: dict[int, int] = {}
        for i, node in enumerate(schedule.nodes):
            begin = schedule.slots[i].start["outputs"]
            self._owners |= {begin + e: i for e in range(sum(p.size for p in node.block.outputs))}

    def loop(self, nodes: list[int]) -> Group:
        """Return the group of an algebraic loop at t_k."""
        schedule = self._schedule
        needs = {i: self._needs(i, set(nodes), True) for i in nodes}
        order = _order(nodes, needs)
        parts, torn = [], []
        for position, i in enumerate(order):
            pairs = self._sources(i, True)
            torn += [origin for _, origin in pairs if self._owners.get(origin) in order[position:]]
            gathers = tuple((to, origin, -1) for to, origin in pairs)
            parts.append(Part(i, "output", gathers, schedule.slots[i].start["outputs"]))
        torn = list(dict.fromkeys(torn))
        rates = {schedule.nodes[i].every for i in order}
        return Group(
            nodes=tuple(order),
            every=rates.pop() if len(rates) == 1 else 1,
            parts=tuple(parts),
            torn=tuple(torn),
            guesses=tuple(torn),  # the values of the step before
            names=tuple(self._name(place) for place in torn),
            externals=tuple(i for i in order if schedule.definitions[i] is None and not schedule.updates(i)),
            states=tuple(self._state(i) for i in order if schedule.definitions[i] is not None),
            words=self.places.take(WORDS * len(order)),
        )

    def steps(self, plants: list[int]) -> list[Group]:
        """Return the groups of FMUs that make their steps together, in order; FMUs without connection to another are in none."""
        groups = []
        for every in sorted({self._schedule.nodes[i].every for i in plants}):
            members = self._between([i for i in plants if self._schedule.nodes[i].every == every])
            needs = {i: self._needs(i, set(members), None) for i in members}
            for island in _islands(members, needs):
                if len(island) > 1 or any(i in needs[i] for i in island):
                    self._make_places(island)
                    whole = self._coupling.step_error is not None
                    for nodes in [island] if whole else components(island, needs):
                        groups.append(self._step(nodes, island, needs, plants))
        return groups

    def copies(self, i: int) -> set[int]:
        """Return the places of the copies of a node's outputs for groups."""
        return {places[i] for places in (self._ahead, self._now) if i in places}

    def _step(self, nodes: list[int], island: list[int], needs: Mapping[int, set[int]], plants: list[int]) -> Group:
        schedule, coupling = self._schedule, self._coupling
        order = self._sweep_order(nodes, needs, plants)
        # Other groups of the island that this one needs have been computed before.
        done: set[int] = {i for i in island if i not in nodes}
        parts: list[Part] = []
        torn: list[int] = []

        def gathers(i: int, *, late: bool) -> tuple[tuple[int, int, int], ...]:
            copies = []
            for to, origin in self._sources(i, None):
                j = self._owners.get(origin)
                if j is None or j not in island:
                    copies.append((to, origin, -1))
                    continue
                element = origin - schedule.slots[j].start["outputs"]
                now, ahead = self._now[j] + element, self._ahead[j] + element
                if late or coupling.iterated:
                    if j not in done:
                        torn.append(ahead)
                    copies.append((to, ahead, now if coupling.hold == "mean" and not late else -1))
                elif coupling.method == "gauss-seidel" and j in done and j in plants:
                    copies.append((to, ahead, -1))
                else:
                    copies.append((to, now, -1))
            return tuple(copies)

        stepped = [i for i in order if i in plants]
        for i in order:
            late = i not in plants
            if not late:
                parts.append(Part(i, "update", gathers(i, late=False), self._ahead[i]))
                if coupling.method == "jacobi":
                    if i == stepped[-1]:
                        parts += [Part(j, "ahead", (), self._ahead[j]) for j in stepped]
                        done |= set(stepped)
                    continue
            # Inputs with feedthrough of a plant (`timing="direct"`) are copied again, with the values at the end.
            again = late or (coupling.iterated and any(port.feedthrough for port in schedule.nodes[i].block.inputs))
            parts.append(Part(i, "ahead", gathers(i, late=True) if again else (), self._ahead[i]))
            done.add(i)
        torn = list(dict.fromkeys(torn))
        back = {self._ahead[i] + e: self._now[i] + e for i in nodes for e in range(self._width(i))}
        doubling: tuple[tuple[int, int, int, int, int], ...] = ()
        size = -1
        if coupling.step_error is not None:
            size = self.places.take(1)
            begins = [
                (i, schedule.slots[i].start["outputs"], self.places.take(2 * schedule.depended_on(i))) for i in nodes
            ]
            doubling = tuple(
                (begin + e, self._now[i] + e, self._ahead[i] + e, kept + 2 * e, kept + 2 * e + 1)
                for i, begin, kept in begins
                for e in range(schedule.depended_on(i))
            )
        return Group(
            nodes=tuple(nodes),
            every=schedule.nodes[nodes[0]].every,
            parts=tuple(parts),
            torn=tuple(torn),
            guesses=tuple(back[place] for place in torn),
            names=tuple(self._name(place, ahead=True) for place in torn),
            externals=tuple(stepped),
            states=(),
            words=self.places.take(WORDS * len(stepped)),
            doubling=doubling,
            size=size,
        )

    def _sweep_order(self, nodes: list[int], needs: Mapping[int, set[int]], plants: list[int]) -> list[int]:
        """Return the FMUs in the order of addition, and each block between them as soon as its inputs are computed."""
        if self._coupling.method != "iterated":
            first = [i for i in nodes if i in plants]
            return first + _order([i for i in nodes if i not in plants], needs)
        order: list[int] = []
        waiting = [i for i in nodes if i not in plants]
        for plant in [i for i in nodes if i in plants]:
            order.append(plant)
            while ready := [i for i in waiting if not needs[i] & set(nodes) - set(order)]:
                order.append(ready[0])
                waiting.remove(ready[0])
        return order + _order(waiting, needs)

    def _between(self, plants: list[int]) -> list[int]:
        """Return FMUs of one rate, and the stateless blocks of that rate on the paths from one FMU to another."""
        schedule = self._schedule
        every = schedule.nodes[plants[0]].every
        plain = {i for i in range(len(schedule.nodes)) if schedule.nodes[i].every == every and self._is_plain(i)}
        if self._coupling.method != "iterated" and self._coupling.step_error is None:
            return plants
        all_ = {*plants, *plain}
        needs = {i: self._needs(i, all_, None) for i in all_}
        feeds: dict[int, set[int]] = {i: set() for i in all_}
        for i, before in needs.items():
            for j in before:
                feeds[j].add(i)
        after = _reached(plants, feeds, plain)
        before = _reached(plants, needs, plain)
        return sorted({*plants, *(after & before & plain)})

    def _is_plain(self, i: int) -> bool:
        """Return whether a block's outputs depend only on its inputs at the same instant."""
        definition, block = self._schedule.definitions[i], self._schedule.nodes[i].block
        return (
            definition is not None
            and definition.output is not None
            and definition.update is None
            and not definition.state
            and bool(block.inputs)
            and all(port.draw is None for port in block.inputs)
            and "k" not in argument_names(definition.output)
        )

    def _make_places(self, nodes: Iterable[int]) -> None:
        for i in nodes:
            self._ahead[i] = self.places.take(self._width(i))
            substeps = self._coupling.step_error is not None
            self._now[i] = self.places.take(self._width(i)) if substeps else self._schedule.slots[i].start["outputs"]

    def _needs(self, i: int, among: set[int], feedthrough: bool | None) -> set[int]:
        owners = {self._owners.get(origin) for _, origin in self._sources(i, feedthrough)}
        return {j for j in owners if j is not None and j in among}

    def _width(self, i: int) -> int:
        return sum(p.size for p in self._schedule.nodes[i].block.outputs)

    def _state(self, i: int) -> Pair:
        start = self._schedule.slots[i].start
        return start["state"], start["parameters"]

    def _name(self, place: int, *, ahead: bool = False) -> str:
        if ahead:
            i, begin = next((i, b) for i, b in self._ahead.items() if b <= place < b + self._width(i))
        else:
            i = self._owners[place]
            begin = self._schedule.slots[i].start["outputs"]
        node = self._schedule.nodes[i]
        return f"{node.name}.{element_name(node.block.outputs, place - begin)}"


def element_name(ports: Iterable[Port], offset: int) -> str:
    """Return the name of the element of a block's outputs that lies `offset` places after the first."""
    for port in ports:
        if offset < port.size:
            return port.name + (f"[{offset}]" if port.size > 1 else "")
        offset -= port.size
    return "output"


def components(nodes: list[int], needs: Mapping[int, set[int]]) -> list[list[int]]:
    """Return the strongly connected components, each after those that it needs, otherwise in the given order."""
    reach = {i: _reached([i], needs, set(nodes)) & set(nodes) for i in nodes}
    left, result = list(nodes), []
    while left:
        for i in left:
            component = {j for j in reach[i] if i in reach[j]} | {i}
            if all(j in component or j not in left for k in component for j in reach[k]):
                result.append(sorted(component))
                left = [j for j in left if j not in component]
                break
    return result


def _islands(nodes: list[int], needs: Mapping[int, set[int]]) -> list[list[int]]:
    """Return the connected components, without regard to direction."""
    neighbours = {i: needs[i] | {j for j in nodes if i in needs[j]} for i in nodes}
    left, islands = list(nodes), []
    while left:
        island = sorted(_reached([left[0]], neighbours, set(nodes)) | {left[0]})
        islands.append(island)
        left = [i for i in left if i not in island]
    return islands


def _reached(start: Iterable[int], edges: Mapping[int, set[int]], through: set[int]) -> set[int]:
    """Return the nodes that can be reached along edges, continuing only from nodes of `through`."""
    visited: set[int] = set()
    waiting = [j for i in start for j in edges[i]]
    while waiting:
        i = waiting.pop()
        if i not in visited:
            visited.add(i)
            if i in through:
                waiting += edges[i]
    return visited


def _order(nodes: list[int], needs: Mapping[int, set[int]]) -> list[int]:
    """Return an order with few guesses: the next node is always the one that lacks the fewest others."""
    left, order = list(nodes), []
    while left:
        best = min(left, key=lambda i: (len(needs[i] & set(left)), i))
        order.append(best)
        left.remove(best)
    return order
