"""What an FMU says of its structure by numbers, which a reader may take for others than are meant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from bayesftc.cosim.errors import FMUError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from bayesftc.cosim._fmi.archive import Archive

LARGEST_REFERENCE = 2**32 - 1
MOST_DIMENSIONS = 32
"""What NumPy and compiled code allow."""


def check_structure(archive: Archive, root: Element, *, validate: bool) -> None:
    """Check the model structure: that what it refers to is there and, with `validate`, that its outputs are outputs.

    FMI 2 counts variables from 1. To Python number 0 is the last one, and a dependency would be another one than is meant.

    Raises
    ------
    FMUError
        If it is not in order.
    """

    def refuse(what: str) -> NoReturn:
        raise FMUError(
            f"The modelDescription.xml of {archive.path} breaks the rules of FMI: its ModelStructure {what}. Export it again."
        )

    variables = root.findall("ModelVariables/*")
    if root.get("fmiVersion") == "2.0":
        for unknown in root.findall("ModelStructure/*/Unknown"):
            for number in _numbers((unknown.get("index", ""), *unknown.get("dependencies", "").split())):
                if not 1 <= number <= len(variables):
                    refuse(f"refers to the variable number {number}, but they are counted from 1 to {len(variables)}")
        places = (
            [(int(u.get("index", "0")) - 1) for u in root.findall("ModelStructure/Outputs/Unknown")] if validate else []
        )
        listed = [variables[place] for place in places]
    else:
        wanted = {o.get("valueReference") for o in root.findall("ModelStructure/Output")} if validate else set()
        listed = [v for v in variables if v.get("valueReference") in wanted]
    for variable in listed:
        causality = variable.get("causality", "local")
        if causality != "output":
            refuse(f"lists {variable.get('name')!r} among the outputs, which is of causality {causality}")


def check_shape(name: str, reference: int, dimensions: Sequence[object]) -> None:
    """Check what no binary interface can carry.

    Raises
    ------
    ValueError
        If it is so.
    """
    if not 0 <= reference <= LARGEST_REFERENCE:
        raise ValueError(f"the value reference of {name!r} is {reference}, and must be from 0 to {LARGEST_REFERENCE}")
    if len(dimensions) > MOST_DIMENSIONS:
        raise ValueError(
            f"{name!r} has {len(dimensions)} dimensions, more than the {MOST_DIMENSIONS} that an array can have"
        )


def _numbers(texts: Sequence[str]) -> list[int]:
    """Return whole numbers; what is none is found by whoever validates."""
    return [int(text) for text in texts if text.lstrip("-").isdecimal()]
