"""Messages about port values that an FMU cannot set or read."""

from __future__ import annotations

from collections.abc import Sequence

from bayesftc.cosim.fmi.binaries.groups import Group, type_range
from bayesftc.cosim.fmi.reading.description import FMUVariable

_SHOWN = 3


def function_of(groups: Sequence[Group], elements: Sequence[tuple[str, FMUVariable]], begin: int) -> str:
    """Return which function has failed, and for which variables.

    Parameters
    ----------
    groups : sequence of Group
        The inputs or outputs.
    elements : sequence of (str, FMUVariable)
        Name and variable of each of their elements.
    begin : int
        First element of the group that has failed.
    """
    group = next((g for g in groups if g.begin == begin), None)
    if group is None:
        return "An FMI function"
    names = dict.fromkeys(variable.name for _, variable in elements[begin : begin + group.size])
    quoted = [repr(name) for name in names]
    return f"{group.name} of {' and '.join([*quoted[:_SHOWN], *(['more'] if quoted[_SHOWN:] else [])])}"


def misfit(elements: Sequence[tuple[str, FMUVariable]], place: int, major: int, *, is_input: bool) -> str:
    """Return which input does not fit its type, or which output does not fit a double, and what to do.

    Parameters
    ----------
    elements : sequence of (str, FMUVariable)
        Name and variable of each element of the inputs or outputs.
    place : int
        The element.
    major : int
        2 or 3: the version of FMI.
    is_input : bool
        Whether it is an input.
    """
    name, variable = elements[place]
    if not is_input:
        return (
            f"The output {name!r} is connected, but its value is a whole number of 2**53 or more, which a double cannot "
            "represent exactly. Connect another output, or export it as a Float64."
        )
    low, high = type_range(variable, major)
    required = (
        f"a number up to {high:g}" if variable.type == "Float32" else f"a whole number from {low:.0f} to {high:.0f}"
    )
    what = f"The input {name!r}" if variable.causality == "input" else f"The tunable parameter {name!r}"
    return f"{what} is {variable.type} and must be {required}, but its value is not. Put a block before it that rounds or limits."
