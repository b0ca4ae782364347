"""Units of settings that refer to the units of a block's ports."""

from __future__ import annotations

import re

from bayesftc.cosim.diagram.roles import Units


def unit_of_setting(text: str, node: str, units: Units) -> str | None:
    """Return the unit of a block's setting, where ``{u}`` is the unit of its port ``u``; None if that is not known."""
    ports = {port: units.get((node, port)) for port in re.findall(r"{(\w+)}", text)}
    return re.sub(r"{(\w+)}", lambda port: str(ports[port[1]]), text) or None if all(ports.values()) else None
