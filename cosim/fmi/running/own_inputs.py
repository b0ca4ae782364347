"""Start values of inputs that an FMU alone knows: of arrays with another size than its description says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.groups import groups
from bayesftc.cosim.fmi.binaries.library import Library
from bayesftc.cosim.fmi.reading.description import FMUVariable, Value
from bayesftc.cosim.types import Floats


def own_inputs(library: Library, component: int, inputs: Mapping[FMUVariable, Value | None]) -> dict[str, Floats]:
    """Return the values that an initialized instance has itself given to the inputs without a known one, by name.

    These are arrays of another size than the description has start values for.
    """
    found = {}
    for variable, value in inputs.items():
        if value is None:
            (group,) = groups([variable], library.description.fmi_major, "Get", library.function_address)
            values = np.zeros(group.size)
            status, _ = group.take(component, values)
            if status not in (0, 1):
                raise FMUError(
                    f"The FMU {library.description.name!r} does not say which start value its input {variable.name!r} has with "
                    "the sizes that it was given; give it one by parameters=."
                )
            found[variable.name] = values
    return found
