"""Groups of blocks that are computed together: which they are, in which order a sweep goes through them, what is guessed.

There are two kinds. A *loop* stands in the evaluation of t_k: blocks whose outputs at t_k depend on each other. A *step* takes
FMUs from t_k to t_k+1 together, and computes the blocks without a memory that lie between them along with it. In both, the
outputs that a block needs before they are computed are guessed; a sweep through the group computes them.
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
"""A copy: to one place in memory, from another."""

WORDS = 6
"""Words of memory for each FMU that is put back: its address, the functions that save, restore and free, two saved states."""


@dataclass(frozen=True)
class Part:
    """One call of a sweep.

    Attributes
    ----------
    node : int
        Whose it is.
    kind : {"output", "update", "ahead"}
        Which step function; ``ahead`` computes outputs at the end of a step.
    gathers : tuple of (int, int, int)
        Copies that bring its inputs: to, from, and a second place from which the mean is taken, or -1.
    outputs : int
        Where in memory the outputs go.
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
        The members.
    every : int
        At which multiple of the base step.
    parts : tuple of Part
        One sweep.
    torn, guesses : tuple of int
        Places of the values that are guessed, and where the first guesses come from.
    names : tuple of str
        What the guessed values are called.
    externals : tuple of int
        The FMUs among the members that make steps, and so must be put back.
    states : tuple of (int, int)
        Where the states lie of the other members that have some.
    words : int
        Where the words about the FMUs begin.
    doubling : tuple of five int
        For each output of a member: where it lies at t_k, at the beginning and at the end of a step of the group's own, at the
        end of a step of double size, and where its value at the beginning is kept. Empty without `Coupling.step_error`.
    size : int
        The place of the step size of the group's own, as a part of the whole.
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
        """Whether it stands in the evaluation of t_k."""
        return all(part.kind == "output" for part in self.parts)

    @property
    def restores(self) -> bool:
        """Whether its FMUs must be able to go back."""
        return bool(self.torn or self.doubling)


class Places:
    """Hands out places behind the memory that a diagram's blocks take."""

    def __init__(self, begin: int):
        self.end = begin

    def take(self, count: int) -> int:
        """Return where `count` new places begin."""
        begin, self.end = self.end, self.end + count
        return begin


class Grouping:
    """Finds the groups of a schedule and lays them out.

    Parameters
    ----------
    schedule : Schedule
        With its blocks laid out.
    sources : callable
        Returns the copies (to, from) that bring a node's inputs: of those that feed through, or of all.
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
            guesses=tuple(torn),  # what stood there at the step before
            names=tuple(self._name(place) for place in torn),
            externals=tuple(i for i in order if schedule.definitions[i] is None and not schedule.updates(i)),
            states=tuple(self._state(i) for i in order if schedule.definitions[i] is not None),
            words=self.places.take(WORDS * len(order)),
        )

    def steps(self, plants: list[int]) -> list[Group]:
        """Return the groups in which FMUs make their steps, in their order; FMUs that meet no other one are in none."""
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
        """Return where copies of a node's outputs begin that it has for groups."""
        return {places[i] for places in (self._ahead, self._now) if i in places}

    def _step(self, nodes: list[int], island: list[int], needs: Mapping[int, set[int]], plants: list[int]) -> Group:
        schedule, coupling = self._schedule, self._coupling
        order = self._sweep_order(nodes, needs, plants)
        done: set[int] = {
            i for i in island if i not in nodes
        }  # other groups of the island: those it needs have gone before
        parts: list[Part] = []
        torn: list[int] = []

        def gathers(i: int, *, late: bool) -> tuple[tuple[int, int, int], ...]:
            brought = []
            for to, origin in self._sources(i, None):
                j = self._owners.get(origin)
                if j is None or j not in island:
                    brought.append((to, origin, -1))
                    continue
                element = origin - schedule.slots[j].start["outputs"]
                now, ahead = self._now[j] + element, self._ahead[j] + element
                if late or coupling.iterated:
                    if j not in done:
                        torn.append(ahead)
                    brought.append((to, ahead, now if coupling.hold == "mean" and not late else -1))
                elif coupling.method == "gauss-seidel" and j in done and j in plants:
                    brought.append((to, ahead, -1))
                else:
                    brought.append((to, now, -1))
            return tuple(brought)

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
            # What feeds through a plant as well (`timing="direct"`) is brought again, as it is at the end.
            again = late or (coupling.iterated and any(port.feedthrough for port in schedule.nodes[i].block.inputs))
            parts.append(Part(i, "ahead", gathers(i, late=True) if again else (), self._ahead[i]))
            done.add(i)
        torn = list(dict.fromkeys(torn))
        back = {self._ahead[i] + e: self._now[i] + e for i in nodes for e in range(self._width(i))}
        doubling: tuple[tuple[int, int, int, int, int], ...] = ()
        size = -1
        if coupling.step_error is not None:
            size = self.places.take(1)
            lies = [
                (i, schedule.slots[i].start["outputs"], self.places.take(2 * schedule.depended_on(i))) for i in nodes
            ]
            doubling = tuple(
                (begin + e, self._now[i] + e, self._ahead[i] + e, kept + 2 * e, kept + 2 * e + 1)
                for i, begin, kept in lies
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
        """Return the FMUs as they were added, each block between them as soon as all that it needs is there."""
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
        """Return FMUs of one rate, and the blocks without a memory of that rate on the ways from one to another."""
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
        """Return whether a block's outputs depend on its inputs at the same instant alone."""
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
            own = self._coupling.step_error is not None
            self._now[i] = self.places.take(self._width(i)) if own else self._schedule.slots[i].start["outputs"]

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
    """Return what the element of a block's outputs is called that lies `offset` places behind the first."""
    for port in ports:
        if offset < port.size:
            return port.name + (f"[{offset}]" if port.size > 1 else "")
        offset -= port.size
    return "output"


def components(nodes: list[int], needs: Mapping[int, set[int]]) -> list[list[int]]:
    """Return the strongly connected components, each after those that it needs; as far as that leaves it open, in order."""
    reach = {i: _reached([i], needs, set(nodes)) & set(nodes) for i in nodes}
    left, found = list(nodes), []
    while left:
        for i in left:
            own = {j for j in reach[i] if i in reach[j]} | {i}
            if all(j in own or j not in left for k in own for j in reach[k]):
                found.append(sorted(own))
                left = [j for j in left if j not in own]
                break
    return found


def _islands(nodes: list[int], needs: Mapping[int, set[int]]) -> list[list[int]]:
    """Return the parts that nothing connects."""
    touches = {i: needs[i] | {j for j in nodes if i in needs[j]} for i in nodes}
    left, found = list(nodes), []
    while left:
        island = sorted(_reached([left[0]], touches, set(nodes)) | {left[0]})
        found.append(island)
        left = [i for i in left if i not in island]
    return found


def _reached(start: Iterable[int], edges: Mapping[int, set[int]], through: set[int]) -> set[int]:
    """Return what can be reached along edges, going on only from nodes of `through`."""
    found: set[int] = set()
    waiting = [j for i in start for j in edges[i]]
    while waiting:
        i = waiting.pop()
        if i not in found:
            found.add(i)
            if i in through:
                waiting += edges[i]
    return found


def _order(nodes: list[int], needs: Mapping[int, set[int]]) -> list[int]:
    """Return an order in which few are needed before their turn: next comes the one that lacks least."""
    left, order = list(nodes), []
    while left:
        best = min(left, key=lambda i: (len(needs[i] & set(left)), i))
        order.append(best)
        left.remove(best)
    return order
