"""Validation against the schemas of SSP 1.0."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from typing import Any

NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructure"
SSD, SSV, SSM, SSC = (
    f"{{{NAMESPACE}{kind}}}" for kind in ("Description", "ParameterValues", "ParameterMapping", "Common")
)

_SCHEMAS = {SSD: "Description", SSV: "ParameterValues", SSM: "ParameterMapping"}
_ELEMENT = ("Connectors", "ElementGeometry", "ParameterBindings")
_ORDER = {
    f"{SSD}SystemStructureDescription": ("System", "Enumerations", "Units", "DefaultExperiment", "Annotations"),
    f"{SSD}Component": (*_ELEMENT, "Annotations"),
    f"{SSD}System": (
        *_ELEMENT,
        *("Elements", "Connections", "SignalDictionaries", "SystemGeometry", "GraphicalElements", "Annotations"),
    ),
}
_LISTS = {f"{SSD}{name}" for name in ("Connectors", "ParameterBindings", "Connections", "Annotations")}


def problems_of(content: bytes, *, tidy: bool = False) -> Iterator[str]:
    """Yield the schema violations of a file, and of parameter sets and mappings in it.

    Parameters
    ----------
    content : bytes
        The text of an .ssd, .ssv or .ssm, checked by `_zip.check_xml`.
    tidy : bool
        Ignore violations whose meaning is clear: parts of an element in another order, and empty lists, as OMSimulator writes
        them.
    """
    from lxml import etree

    try:
        root = etree.fromstring(content, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:  # lxml is stricter than the first parser
        yield str(error.msg).removesuffix(".")
        return
    if tidy:
        _tidy(root)
    inner = [root, *root.iter(f"{SSV}ParameterSet", f"{SSM}ParameterMapping")]
    for element in dict.fromkeys(inner):
        kind = _SCHEMAS.get(element.tag[: element.tag.index("}") + 1])
        schema = _schema(kind) if kind else None
        if schema is not None and not schema.validate(etree.fromstring(etree.tostring(element))):
            for problem in schema.error_log:
                yield f"line {element.sourceline + problem.line - 1}: {problem.message.removesuffix('.')}"


def _tidy(root: Any) -> None:
    for element in [e for e in root.iter(*_LISTS) if not len(e)]:
        element.getparent().remove(element)
    for element in root.iter(*_ORDER):
        order = [f"{SSD}{name}" for name in _ORDER[element.tag]]
        parts = [e for e in element if e.tag in order]
        if len(parts) == len(element):  # else no order is valid, and the line numbers must stay
            element[:] = sorted(parts, key=lambda e: order.index(e.tag))


@cache
def _schema(kind: str) -> Any:
    import fmpy.ssp
    from lxml import etree

    folder = os.path.join(os.path.dirname(fmpy.ssp.__file__), "schema")
    return etree.XMLSchema(file=os.path.join(folder, f"SystemStructure{kind}.xsd"))


__all__ = ["NAMESPACE", "SSC", "SSD", "SSM", "SSV", "problems_of"]
