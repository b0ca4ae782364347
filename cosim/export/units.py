"""Units of a diagram's signals, also of ports that have none of their own, and of settings that are measured in them."""

from __future__ import annotations

import re
from collections.abc import Mapping

from bayesftc.cosim.diagram.diagram import Diagram

Key = tuple[str, str]
"""Block and port."""

Units = Mapping[Key, str]


def units_of(diagram: Diagram) -> Units:
    """Return the unit of each port that has one, or is connected to ports of one.

    It travels along connections, and through blocks some of whose ports have one unit, whichever it is (`Block.one_unit`): a
    fault, a delay. Where ports of different units meet, as in a vector that is put together, nothing is said.
    """
    groups: dict[Key, set[Key]] = {}
    units: dict[Key, str] = {}

    def join(one: Key, other: Key) -> None:
        together = groups.setdefault(one, {one}) | groups.setdefault(other, {other})
        for key in together:
            groups[key] = together

    for node in diagram.nodes:
        for port in (*node.block.inputs, *node.block.outputs):
            if port.unit:
                units[node.name, port.name] = port.unit
        alike = [(node.name, name) for name in node.block.one_unit]
        for key in alike[1:]:
            join(alike[0], key)
    for (name, fed, _), (source, _) in diagram._sources.items():
        if groups.get((name, fed)) is None or (source.node.name, source.port.name) not in groups[name, fed]:
            join((name, fed), (source.node.name, source.port.name))
    found = dict(units)
    for key, together in groups.items():
        known = {units[other] for other in together if other in units}
        if key not in units and len(known) == 1:
            found[key] = known.pop()
    return found


def unit_of_setting(text: str, node: str, units: Units) -> str | None:
    """Return the unit of a block's setting, in which ``{u}`` stands for that of its port ``u``; None where nobody knows it."""
    ports = {port: units.get((node, port)) for port in re.findall(r"{(\w+)}", text)}
    return re.sub(r"{(\w+)}", lambda port: str(ports[port[1]]), text) or None if all(ports.values()) else None
