"""Start values of inputs that only the binary has: those of arrays whose size differs from the description."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.groups import groups
from bayesftc.cosim.fmi.binaries.library import Library
from bayesftc.cosim.fmi.reading.description import FMUVariable, Value
from bayesftc.cosim.types import Floats


def own_inputs(library: Library, component: int, inputs: Mapping[FMUVariable, Value | None]) -> dict[str, Floats]:
    """Return the start values, by name, of inputs for which the description has none of the right size.

    They are read from an initialized instance. These inputs are arrays resized by structural parameters.
    """
    result = {}
    for variable, value in inputs.items():
        if value is None:
            (group,) = groups([variable], library.description.fmi_major, "Get", library.function_address)
            values = np.zeros(group.size)
            status, _ = group.take(component, values)
            if status not in (0, 1):
                raise FMUError(
                    f"The FMU {library.description.name!r} does not give the start value of its input {variable.name!r} for the "
                    "sizes set by structural parameters. Give it by parameters=."
                )
            result[variable.name] = values
    return result
