"""Which inputs an output depends on at the same time, by the paths of direct feedthrough between them."""

from __future__ import annotations

from bayesftc.cosim._export.program import Program
from bayesftc.cosim._opening import OUTSIDE
from bayesftc.cosim.block import argument_names


def feeding(program: Program) -> dict[str, frozenset[str]]:
    """Return, for each output, the names of the inputs and parameters that its value at t_k is computed from.

    An output is taken to depend on all that its block reads to compute outputs, its inputs with ``feedthrough=True``.
    """
    schedule = program.schedule
    sources: dict[int, frozenset[str]] = {}  # by place in memory
    for i, node in enumerate(schedule.nodes):
        if node.name == OUTSIDE:
            begin = schedule.slots[i].start["outputs"]
            names = [signal.name for signal in program.inputs for _ in signal.places]
            sources |= {begin + j: frozenset({name}) for j, name in enumerate(names)}
    for call in schedule.evaluate:
        node = schedule.nodes[call.node]
        kernel = schedule.kernel(call)
        if node.name == OUTSIDE or kernel is None:
            continue
        read = set(argument_names(kernel))
        found = {t.name for t in program.tunables if t.node == call.node and t.parameter in read}
        found |= {name for _, origin in call.gathers for name in sources.get(origin, ())}
        begin = schedule.slots[call.node].start["outputs"]
        size = sum(port.size for port in node.block.outputs)
        sources |= dict.fromkeys(range(begin, begin + size), frozenset(found))
    return {
        signal.name: frozenset(name for at in signal.places for name in sources.get(at, ()))
        for signal in program.outputs
    }


def keeps_state_in_outputs(program: Program) -> bool:
    """Return whether computing outputs changes the state of a block: it must then be done once a step."""
    from bayesftc.cosim._contract import stored_into

    return any(
        kernel is not None and not stored_into(kernel.__code__).isdisjoint(definition.state)
        for call in program.schedule.evaluate
        if (kernel := program.schedule.kernel(call)) is not None
        and (definition := program.schedule.definitions[call.node]) is not None
    )
