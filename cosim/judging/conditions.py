"""Faults on a condition that was not fulfilled during a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from bayesftc.cosim.blocks.faults.conditions import When
from bayesftc.cosim.blocks.faults.kinds import Fault
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.types import Floats


def never_began(diagram: Diagram, signals: Mapping[str, Floats]) -> Iterator[str]:
    """Yield a sentence for each fault on a condition that was absent in all recorded rows.

    Parameters
    ----------
    diagram : Diagram
        The diagram with the faults.
    signals : mapping of name to array
        The result of its run. A fault whose ``active`` is not recorded is left out.
    """
    for node in diagram.nodes:
        block, active = node.block, f"{node.name}.active"
        if (
            isinstance(block, Fault)
            and isinstance(block.start, When)
            and active in signals
            and not signals[active].any()
        ):
            yield f"The fault {node.name!r} did not occur: it begins on the condition {block.start}."
