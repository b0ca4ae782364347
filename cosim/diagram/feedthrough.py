"""The order in which blocks compute their outputs at t_k: each after the sources of its inputs with feedthrough."""

from __future__ import annotations

from collections.abc import Container
from itertools import pairwise

from bayesftc.cosim.blocks.linear_system import LinearSystem
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.groups import components
from bayesftc.cosim.diagram.wiring import is_controller
from bayesftc.cosim.errors import AlgebraicLoopError
from bayesftc.cosim.fmi.fmu import FMU

DELAYED = "when(..., delayed=True)"
"""How a condition of a fault is delayed in Python; a scenario file has other words for it."""


class Feedthrough:
    """The graph of direct feedthrough: which blocks need the outputs of which others at t_k.

    Parameters
    ----------
    diagram : Diagram
        The diagram, with all its connections.
    computing : container of int
        Numbers of the blocks that compute outputs, in the order of the diagram.
    """

    def __init__(self, diagram: Diagram, computing: Container[int]):
        self._nodes = diagram.nodes
        place = {node: i for i, node in enumerate(self._nodes)}
        #: For each block the blocks that need it, with the names of the first output and input between the two.
        self._edges: dict[int, dict[int, tuple[str, str]]] = {i: {} for i in range(len(self._nodes))}
        for i, node in enumerate(self._nodes):
            if i not in computing:
                continue
            for port in node.inputs:
                for element in range(port.size if port.feedthrough else 0):
                    source = diagram.source_of(node, port, element)
                    if source is not None and source[0].direction == "output":
                        output, j = source[0], place[source[0].node]
                        self._edges[j].setdefault(
                            i, (f"{output.node.name}.{output.port.name}", f"{node.name}.{port.name}")
                        )

    def is_loop(self, unit: list[int]) -> bool:
        """Return whether one entry of the order is an algebraic loop."""
        return len(unit) > 1 or unit[0] in self._edges[unit[0]]

    def order(self, *, solved: bool) -> list[list[int]]:
        """Return the blocks in the order of computation; those of an algebraic loop are one entry.

        Parameters
        ----------
        solved : bool
            Whether algebraic loops are solved, not refused.

        Raises
        ------
        AlgebraicLoopError
            If there is an algebraic loop and `solved` is false.
        """
        waiting = dict.fromkeys(range(len(self._nodes)), 0)
        for targets in self._edges.values():
            for target in targets:
                waiting[target] += 1
        order: list[list[int]] = []
        while waiting:
            ready = next(([i] for i, count in waiting.items() if count == 0), None)
            if ready is None:
                if not solved:
                    raise AlgebraicLoopError(self._loop_message(set(waiting)))
                needs = {i: {j for j in waiting if i in self._edges[j]} for i in waiting}
                ready = components(list(waiting), needs)[0]
            for i in ready:
                del waiting[i]
            order.append(ready)
            for target in [target for i in ready for target in self._edges[i] if target in waiting]:
                waiting[target] -= 1
        return order

    def _loop_message(self, stuck: set[int]) -> str:
        # Go backwards: each stuck block has a stuck predecessor, so the path must close.
        path = [min(stuck)]
        while True:
            before = next(j for j in sorted(stuck) if path[-1] in self._edges[j])
            if before in path:
                loop = [*path[path.index(before) :], before][::-1]
                break
            path.append(before)
        lines = [
            f"  {self._edges[a][b][0]} -> {self._edges[a][b][1]}  ({self._nodes[b].name} feeds it through)"
            for a, b in pairwise(loop)
        ]
        direct = [
            self._nodes[i].name for i in sorted(set(loop)) if getattr(self._nodes[i].block, "timing", "") == "direct"
        ]
        sampled = [
            node.name
            for node in (self._nodes[i] for i in sorted(set(loop)))
            if isinstance(node.block, FMU) and node.block.timing == "sampled" and not is_controller(node)
        ]
        named = [
            self._nodes[b].name
            for a, b in pairwise(loop)
            if self._edges[a][b][1].rpartition(".")[2] in self._nodes[b].block.named_sources
        ]
        systems = [
            node.name
            for node in (self._nodes[i] for i in sorted(set(loop)))
            if isinstance(node.block, StateSpace) and not isinstance(node.block.system, LinearSystem)
        ]
        return (
            "The diagram has an algebraic loop, in which each value at t_k depends on itself:\n"
            + "\n".join(lines)
            + "\nPut a UnitDelay into one of these connections, declare an input feedthrough=False if that is true, or solve "
            "the loop at each step with build(coupling='iterated')."
            + (f" A condition of {named[0]!r} can read the step before: {DELAYED}." if named else "")
            + (
                f" If the outputs of {systems[0]!r} do not depend on its inputs at the same instant, make it "
                "cosim.StateSpace(system, feedthrough=False)."
                if systems
                else ""
            )
            + (
                f" {sampled[0]!r} is an FMU with timing='sampled': its outputs belong to the beginning of a step, and take all "
                "inputs of that time. For a plant, export it without the outputs on which an input acts directly (outputs=...)."
                if sampled
                else ""
            )
            + (f" {direct[0]!r} with timing='plant' has outputs for the inputs of the step before." if direct else "")
        )
