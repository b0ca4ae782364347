"""Checks of the numbers in a model description: indices, value references, shapes and sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import TYPE_CHECKING, NoReturn

from bayesftc.cosim.errors import FMUError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from bayesftc.cosim.fmi.reading.archive import Archive

LARGEST = 10_000_000
"""Most elements of an array, and of all variables together."""

LARGEST_REFERENCE = 2**32 - 1
MOST_DIMENSIONS = 32
"""The limit of NumPy and of compiled code."""


def check_structure(archive: Archive, root: Element, *, validate: bool) -> None:
    """Check that all references of the model structure exist and, with `validate`, that its outputs are outputs.

    FMI 2 counts variables from 1. An index of 0 would silently select the last variable in Python.

    Raises
    ------
    FMUError
        If the model structure is not valid.
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
                    refuse(f"refers to variable number {number}, but variables are numbered from 1 to {len(variables)}")
        places = (
            [(int(u.get("index", "0")) - 1) for u in root.findall("ModelStructure/Outputs/Unknown")] if validate else []
        )
        listed = [variables[place] for place in places]
    else:
        references = {o.get("valueReference") for o in root.findall("ModelStructure/Output")} if validate else set()
        listed = [v for v in variables if v.get("valueReference") in references]
    for variable in listed:
        causality = variable.get("causality", "local")
        if causality != "output":
            refuse(f"lists {variable.get('name')!r} as an output, but its causality is {causality}")


def check_shape(name: str, reference: int, dimensions: Sequence[object]) -> None:
    """Check the value reference and the number of dimensions of a variable.

    Raises
    ------
    ValueError
        If one is out of range.
    """
    if not 0 <= reference <= LARGEST_REFERENCE:
        raise ValueError(f"the value reference of {name!r} is {reference}, but must be from 0 to {LARGEST_REFERENCE}")
    if len(dimensions) > MOST_DIMENSIONS:
        raise ValueError(f"{name!r} has {len(dimensions)} dimensions, but an array can have at most {MOST_DIMENSIONS}")


def check_size(archive: Archive, shapes: Sequence[tuple[str, tuple[int, ...]]]) -> None:
    """Check that the variables of a model, given by name and shape, fit into memory.

    Raises
    ------
    FMUError
        If they do not, or an array has a negative size.
    """
    for name, shape in shapes:
        if shape and min(shape) < 0:
            raise FMUError(
                f"The array {name!r} of the FMU {archive.path.name} has the negative size {min(shape)}; export the FMU again."
            )
    total = sum(prod(shape) for _, shape in shapes)
    if total > LARGEST:
        name, shape = max(shapes, key=lambda pair: prod(pair[1]))
        more = "" if prod(shape) > LARGEST else f", and all variables together {total:,} numbers"
        raise FMUError(
            f"{name!r} of the FMU {archive.path.name} would have the shape {shown(shape)}{more}: more than {LARGEST:,} numbers. "
            "Give smaller structural parameters, or export it with smaller arrays."
        )


def check_counts(counts: Mapping[str, int]) -> None:
    """Check that arrays of these declared sizes fit into memory.

    Raises
    ------
    ValueError
        If one does not.
    """
    for what, count in counts.items():
        if not 0 <= count <= LARGEST:
            raise ValueError(f"it declares {count:,} {what}, but must have from 0 to {LARGEST:,}")


def shown(shape: Sequence[int]) -> str:
    """Return the shape of an array as text of limited length."""
    sizes = [str(size) if size < 10**20 else "more than 1e20" for size in shape[:MOST_DIMENSIONS]]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


def _numbers(texts: Sequence[str]) -> list[int]:
    """Return the whole numbers among texts; validation reports the other texts."""
    return [int(text) for text in texts if text.lstrip("-").isdecimal()]
