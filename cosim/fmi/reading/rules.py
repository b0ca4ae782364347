"""The rules of FMI for model descriptions: fmpy checks them, and broken ones that do not affect results are tolerated."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING
from zipfile import ZipFile

from bayesftc.cosim.errors import LAX, FMUError
from bayesftc.cosim.fmi.reading.archive import DESCRIPTION, Archive, read_entry

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription

_SHOWN, _LONGEST = 3, 300
_LINE = re.compile(r" \(line \d+, column \d+\)")

HARMLESS = re.compile(
    r"Element '(fmiModelDescription|Category|Tool|Annotation)', attribute '[^']*': The attribute '[^']*' is not allowed|"
    r"Element 'Annotations': This element is not expected|Element 'String', attribute 'start': The attribute 'start' is not|"
    r"The attribute '(generationDateAndTime|version|author)' is required|"
    r'must have variability != "continuous"|has no start value|but provides a start value|[Uu]nit ".*" .* is not defined'
)
"""Broken rules of FMI that are tolerated, because they do not affect results. Unknown elements, and unknown attributes of
variables, are not tolerated: they may be misspelt ones, and the schema check stops at them."""


def parse(archive: Archive, content: bytes, validate: bool) -> tuple[ModelDescription, str | None]:
    """Return the description, and a sentence that lists the broken rules that do not affect results (or None)."""
    from fmpy import read_model_description
    from fmpy.model_description import ValidationError
    from fmpy.validation import validate_model_description

    try:
        try:
            return read_model_description(_checked_xml(archive, content), validate=validate), None
        except ValidationError as error:
            broken = [str(p).removesuffix(".") for p in error.problems]
            problems = _harmful(broken)
            if not problems:
                model = read_model_description(_checked_xml(archive, content), validate=False)
                # fmpy stops at an error of the schema: run its further checks, too.
                broken += [str(p).removesuffix(".") for p in validate_model_description(model)]
                problems = _harmful(broken) or _harmful_beside_annotations(archive, content)
            if not problems:
                return model, (
                    f"The {DESCRIPTION} of {archive.path} breaks the rules of FMI, but this does not affect results: "
                    f"{_listed([*{_LINE.sub('', p): p for p in reversed(broken)}.values()][::-1])}."
                )
    except KeyError as error:
        problems = [f"it refers to a variable {error}, which it does not define"]
    except ValueError as error:
        # Python refuses numbers of thousands of digits, with a message about one of its functions.
        text = " ".join(str(error).split()).removesuffix(".")
        problems = ["it contains a number of thousands of digits" if "integer string conversion" in text else text]
    except Exception as error:  # noqa: BLE001 - fmpy raises plain Exception, and fails on missing elements
        problems = [(" ".join(str(error).split()) or type(error).__name__).removesuffix(".")]
    remedy = f"Ask its maker for a valid one, or {LAX}" if validate else "Export it again."
    raise FMUError(f"The {DESCRIPTION} of {archive.path} breaks the rules of FMI: {_listed(problems)}. {remedy}")


def _harmful(problems: Sequence[str]) -> list[str]:
    return [problem for problem in problems if not HARMLESS.search(problem)]


def _harmful_beside_annotations(archive: Archive, content: bytes) -> list[str]:
    """Return broken rules that the schema check did not reach: it leaves an element at its first child in the wrong place."""
    from xml.etree import ElementTree

    from fmpy import read_model_description
    from fmpy.model_description import ValidationError

    root = ElementTree.fromstring(content)
    for parent in list(root.iter()):
        for misplaced in parent.findall("Annotations"):
            parent.remove(misplaced)
    try:
        read_model_description(_checked_xml(archive, ElementTree.tostring(root)))
    except ValidationError as error:
        return _harmful([_LINE.sub("", str(p)).removesuffix(".") for p in error.problems])
    return []


def _listed(problems: Sequence[str]) -> str:
    more = f"; and {len(problems) - _SHOWN} more" if len(problems) > _SHOWN else ""
    return "; ".join(p if len(p) <= _LONGEST else f"{p[:_LONGEST]}..." for p in problems[:_SHOWN]) + more


def _checked_xml(archive: Archive, description: bytes) -> io.BytesIO:
    """Return an archive of the checked XML files alone, so that fmpy reads nothing else of the file."""
    content = io.BytesIO()
    with ZipFile(content, "w") as copy:
        for name in archive.kind.xml:
            if name in archive.names:
                copy.writestr(name, description if name == DESCRIPTION else read_entry(archive, name))
    return content
