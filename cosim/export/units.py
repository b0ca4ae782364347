"""Units of a diagram's signals (also of ports that declare none), and of settings that refer to them."""

from __future__ import annotations

import re
from collections.abc import Mapping

from bayesftc.cosim.diagram.diagram import Diagram

Key = tuple[str, str]
"""Block and port."""

Units = Mapping[Key, str]


def units_of(diagram: Diagram) -> Units:
    """Return the unit of each port that declares one, or is connected to ports of one unit.

    Units are passed on along connections, and through blocks whose ports share one unit (`Block.one_unit`), such as a fault or a
    delay. If ports of different units are connected, as in a combined vector, the unit is not known.
    """
    groups: dict[Key, set[Key]] = {}
    units: dict[Key, str] = {}

    def join(one: Key, other: Key) -> None:
        group = groups.setdefault(one, {one}) | groups.setdefault(other, {other})
        for key in group:
            groups[key] = group

    for node in diagram.nodes:
        for port in (*node.block.inputs, *node.block.outputs):
            if port.unit:
                units[node.name, port.name] = port.unit
        sharing = [(node.name, name) for name in node.block.one_unit]
        for key in sharing[1:]:
            join(sharing[0], key)
    for (name, input_name, _), (source, _) in diagram.connections():
        if (
            groups.get((name, input_name)) is None
            or (source.node.name, source.port.name) not in groups[name, input_name]
        ):
            join((name, input_name), (source.node.name, source.port.name))
    result = dict(units)
    for key, group in groups.items():
        group_units = {units[other] for other in group if other in units}
        if key not in units and len(group_units) == 1:
            result[key] = group_units.pop()
    return result


def unit_of_setting(text: str, node: str, units: Units) -> str | None:
    """Return the unit of a block's setting, where ``{u}`` is the unit of its port ``u``; None if that is not known."""
    ports = {port: units.get((node, port)) for port in re.findall(r"{(\w+)}", text)}
    return re.sub(r"{(\w+)}", lambda port: str(ports[port[1]]), text) or None if all(ports.values()) else None
