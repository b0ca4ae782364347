"""The content of an SSP as plain data: system structure, parameter values and mappings.

Files of SSP 1.0 are checked against its schemas. Of SSP 2.0, arrays and the types of FMI 3 are supported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite, prod
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, fromstring

from bayesftc.cosim.base import units
from bayesftc.cosim.base.archives import Kind
from bayesftc.cosim.base.units import Unit
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import LAX, SSPError
from bayesftc.cosim.ssp.schema import SSC, SSD, SSM, SSV, problems_of
from bayesftc.cosim.ssp.steps import Steps, step_hint, steps_of

SSP_FILE = Kind("SSP", ".ssp", "SystemStructure.ssd", SSPError, ("SystemStructure.ssd",), "ssps")
FMU_TYPE = "application/x-fmu-sharedlibrary"

Value = float | int | bool | str | tuple[Any, ...]
_DIMENSION = f"{SSC}Dimension"
_DIGITS = 19
_OF_FMI3 = {"Float64": "Real", "Float32": "Real"} | {
    f"{sign}Int{bits}": "Integer" for sign in ("", "U") for bits in (8, 16, 32, 64)
}
_SHOWN = 3
_BASE_UNITS = dict(zip(("kg", "m", "s", "A", "K", "mol", "cd", "rad"), units.BASE, strict=True))


@dataclass(frozen=True)
class Linear:
    """``factor * x + offset``."""

    factor: float = 1.0
    offset: float = 0.0

    def after(self, first: Linear) -> Linear:
        """Return the composition: this transformation of the result of `first`."""
        return Linear(self.factor * first.factor, self.factor * first.offset + self.offset)

    def __call__(self, x: float) -> float:
        """Return the transformed number."""
        return self.offset + self.factor * x


@dataclass(frozen=True)
class Connector:
    """A connector of an element: its kind, its type and unit (if given), and the sizes of an array.

    A size that depends on a structural parameter, or is not given, is None.
    """

    kind: str
    type: str | None
    unit: str | None
    dimensions: tuple[int | None, ...] = ()


@dataclass(frozen=True)
class Connection:
    """A connection of two connectors, each (element or None for the system itself, connector).

    `converts` is whether units are converted before the transformation.
    """

    start: tuple[str | None, str]
    end: tuple[str | None, str]
    transformation: Linear
    converts: bool


@dataclass(frozen=True)
class Parameter:
    """A value for a variable, with the variable's name relative to the element of the binding.

    ``type`` is Real, Integer, Boolean, String or Enumeration (with the item's name as value). For a Real, ``unit`` is the unit of
    the value, and ``then`` is applied after the conversion to the variable's unit. The value of an array is tuples of tuples.
    """

    name: str
    type: str
    value: Value
    unit: str | None = None
    meaning: Unit | None = None
    then: Linear = Linear()
    converts: bool = True


@dataclass(frozen=True)
class Component:
    """An FMU in a system: its file, its kind, its connectors, the values bound to it, and its step size."""

    source: str
    implementation: str
    connectors: Mapping[str, Connector]
    parameters: tuple[Parameter, ...]
    step: Fraction | None = None


@dataclass(frozen=True)
class System:
    """A system: its connectors, its elements by name, their connections, and the values bound to it."""

    connectors: Mapping[str, Connector]
    elements: Mapping[str, Component | System]
    connections: tuple[Connection, ...]
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True)
class Structure:
    """A system structure: the system, the unit definitions, and its step sizes from tools' annotations."""

    system: System
    units: Mapping[str, Unit] = field(default_factory=lambda: MappingProxyType({}))
    steps: Steps = field(default_factory=Steps)

    def unit(self, name: str) -> Unit | None:
        """Return the definition of a unit: from the file, else from pint. Some tools write units in brackets, ``[m3]``."""
        return self.units.get(name) or units.parse(name) or units.parse(name.removeprefix("[").removesuffix("]"))


def read_structure(content: bytes, where: str, resource: Callable[[str], bytes], *, validate: bool = True) -> Structure:
    """Read a system structure description.

    Parameters
    ----------
    content : bytes
        The text of the .ssd, checked by `_zip.check_xml`.
    where : str
        Its name, for messages.
    resource : callable
        Returns the (checked) text of a referenced file, by its relative path.
    validate : bool
        False to accept files that break the schema.

    Raises
    ------
    SSPError
        If it is not of SSP 1.0 or 2.0, breaks the schema, or contains elements that a diagram cannot represent.
    """
    return _Reader(where, resource, validate).structure(content)


def relative(source: str, where: str) -> str:
    """Return the path of a URI, relative to the .ssd.

    Raises
    ------
    SSPError
        If it is outside the .ssd's folder.
    """
    parts = urlsplit(source)
    path = unquote(parts.path).removeprefix("./")
    steps = Path(path).parts
    if (
        parts.scheme
        or parts.netloc
        or parts.query
        or parts.fragment
        or not steps
        or path.startswith("/")
        or ".." in steps
    ):
        raise SSPError(
            f"{where} refers to {source!r}, but only files beside it or in folders below can be used, as 'resources/car.fmu'."
        )
    if "\\" in path or not path.isprintable():
        raise SSPError(f"{where} refers to {source!r}, which is no path; write it with plain slashes.")
    return path


class _Reader:
    def __init__(self, where: str, resource: Callable[[str], bytes], validate: bool):
        self.where, self.resource, self.validate = where, resource, validate

    def structure(self, content: bytes) -> Structure:
        root = self.parsed(content, self.where, f"{SSD}SystemStructureDescription")
        system = root.find(f"{SSD}System")
        if system is None:
            self.refuse("has no System")
        return Structure(self.system(system, ""), dict(self.unit_definitions(root)), steps_of(root, self.where))

    def parsed(self, content: bytes, where: str, tag: str) -> Element:
        root = fromstring(content)
        version = root.get("version", "")
        if root.tag != tag or not version.startswith(("1.", "2.")):
            raise SSPError(
                f"{where} is no {tag.split('}')[1]} of SSP 1.0 or 2.0 (it is <{root.tag.split('}')[-1]}>, version "
                f"{version or 'none'}); export it as one."
            )
        if self.validate and version.startswith("1."):
            problems = list(problems_of(content))
            serious = list(problems_of(content, tidy=True)) if problems else []
            if serious:
                more = f"; and {len(serious) - _SHOWN} more" if len(serious) > _SHOWN else ""
                raise SSPError(
                    f"{where} breaks the rules of SSP: {'; '.join(serious[:_SHOWN])}{more}. Ask its maker for a valid one, or "
                    f"{LAX}"
                )
            if problems:
                warn_user(
                    f"{where} breaks the rules of SSP, but its meaning is clear: {'; '.join(problems[:_SHOWN])}. It is read "
                    "nevertheless; other tools may refuse it."
                )
        return root

    def refuse(self, what: str) -> NoReturn:
        raise SSPError(f"{self.where} {what}.")

    def system(self, element: Element, path: str) -> System:
        elements: dict[str, Component | System] = {}
        for child in element.findall(f"{SSD}Elements/*"):
            name = child.get("name", "")
            below = f"{path}{name}."
            if name in elements:
                self.refuse(f"has two elements {path + name!r} in one system; give one of them another name")
            if child.tag == f"{SSD}System":
                elements[name] = self.system(child, below)
            elif child.tag == f"{SSD}Component":
                elements[name] = self.component(child, path + name)
            else:
                self.refuse(
                    f"has {path + name!r}, a {child.tag.split('}')[-1]}, which cannot be part of a diagram; connect the "
                    "components directly"
                )
        connections = tuple(self.connection(c, path) for c in element.findall(f"{SSD}Connections/{SSD}Connection"))
        return System(self.connectors(element), elements, connections, self.bindings(element, path or "the system"))

    def component(self, element: Element, path: str) -> Component:
        kind = element.get("type", FMU_TYPE)
        source = element.get("source", "")
        if kind != FMU_TYPE or not source or source.startswith("#"):
            self.refuse(
                f"has the component {path!r} of type {kind} with source {source!r}, but only FMUs can be used. Export the "
                "component as an FMU, or copy its system into this one"
            )
        return Component(
            relative(source, f"The component {path!r} of {self.where}"),
            element.get("implementation", "any"),
            self.connectors(element),
            self.bindings(element, path),
            step_hint(element, f"The component {path!r} of {self.where}"),
        )

    def connectors(self, element: Element) -> dict[str, Connector]:
        result = {}
        for connector in element.findall(f"{SSD}Connectors/{SSD}Connector"):
            type_ = next((e for e in connector if e.tag.startswith(SSC) and e.tag != _DIMENSION), None)
            result[connector.get("name", "")] = Connector(
                connector.get("kind", ""),
                None if type_ is None else type_.tag.removeprefix(SSC),
                None if type_ is None else type_.get("unit"),
                tuple(None if d.get("size") is None else self.size(d) for d in connector.findall(_DIMENSION)),
            )
        return result

    def connection(self, element: Element, path: str) -> Connection:
        start, end = (
            (element.get(f"{side}Element") or None, element.get(f"{side}Connector", "")) for side in ("start", "end")
        )  # the system's own connector has no element, or, as OMSimulator writes it, an empty one
        what = f"the connection from {shown(path, start)} to {shown(path, end)}"
        if element.get("startIndices") is not None or element.get("endIndices") is not None:
            self.refuse(
                f"has indices in {what}, but SSP does not define their first value, so only whole arrays can be connected. "
                "Connect the array, or give the FMU a variable for the element"
            )
        converts = element.get("suppressUnitConversion", "false").strip() not in {"true", "1"}
        return Connection(start, end, self.transformation(element, what), converts)

    def transformation(self, element: Element, what: str) -> Linear:
        for child in element:
            if child.tag == f"{SSC}LinearTransformation":
                factor, offset = (self.number(child, *default) for default in (("factor", 1.0), ("offset", 0.0)))
                if not (isfinite(factor) and isfinite(offset)):
                    self.refuse(f"has a transformation of {what} that is not finite")
                return Linear(factor, offset)
            if child.tag.endswith("MappingTransformation"):
                self.refuse(
                    f"has the transformation {child.tag.removeprefix(SSC)} in {what}, but only linear transformations of real "
                    "numbers can be used"
                )
        return Linear()

    def bindings(self, element: Element, path: str) -> tuple[Parameter, ...]:
        result: list[Parameter] = []
        for binding in element.findall(f"{SSD}ParameterBindings/{SSD}ParameterBinding"):
            what = f"A parameter binding of {path!r} in {self.where}"
            values = self.inner(binding, "ParameterValues", f"{SSV}ParameterSet", what)
            if values is None:
                raise SSPError(f"{what} has neither values nor a source; add one of them.")
            prefix = binding.get("prefix", "")
            local_units = dict(self.unit_definitions(values))
            parameters = [
                self.parameter(p, prefix, local_units, what) for p in values.findall(f"{SSV}Parameters/{SSV}Parameter")
            ]
            mapping = self.inner(binding, "ParameterMapping", f"{SSM}ParameterMapping", what)
            result += parameters if mapping is None else self.mapped(parameters, mapping, what)
        return tuple(result)

    def inner(self, binding: Element, name: str, tag: str, what: str) -> Element | None:
        """Return the parameter set (or mapping) of a binding, from the file that it refers to or from the binding itself."""
        holder = binding.find(f"{SSD}{name}")
        referring = binding if name == "ParameterValues" else holder
        source = None if referring is None else referring.get("source")
        if referring is not None and source:
            if referring.get("sourceBase") == "component":
                raise SSPError(f"{what} refers to {source!r} inside a component; put that file beside the .ssd.")
            path = relative(source, what)
            return self.parsed(self.resource(path), path, tag)
        return None if holder is None else holder.find(tag)

    def parameter(self, element: Element, prefix: str, local_units: Mapping[str, Unit], what: str) -> Parameter:
        name = prefix + element.get("name", "")
        value_element = next((e for e in element if e.tag.startswith(SSV)), None)
        if value_element is None:
            raise SSPError(f"{what} gives {name!r} no value; add one.")
        kind, text = value_element.tag.removeprefix(SSV), value_element.get("value", "")
        kind = _OF_FMI3.get(kind, kind)
        unit = value_element.get("unit")
        parsers: dict[str, Callable[[str], Value]] = {
            "Real": float,
            "Integer": int,
            "Boolean": lambda t: t.strip() in {"true", "1"},
            "String": str,
            "Enumeration": str,
        }
        if kind not in parsers:
            raise SSPError(f"{what} gives {name!r} a value of type {kind}, which cannot be set here; leave it out.")
        shape = [self.size(d) for d in element.findall(_DIMENSION)]
        try:
            value = _array(text.split(), shape, parsers[kind]) if shape else parsers[kind](text)
        except ValueError:
            sized = f" and shape {tuple(shape)}" if shape else ""
            raise SSPError(f"{what} gives {name!r} the value {text!r}, which is not of type {kind}{sized}.") from None
        return Parameter(name, kind, value, unit, local_units.get(unit or ""))

    def mapped(self, parameters: list[Parameter], mapping: Element, what: str) -> list[Parameter]:
        """Apply a mapping; parameters that it does not contain keep their names."""
        targets: dict[str, list[Element]] = {}
        for entry in mapping.findall(f"{SSM}MappingEntry"):
            targets.setdefault(entry.get("source", ""), []).append(entry)
        result = []
        for parameter in parameters:
            for entry in targets.get(parameter.name, ()):
                linear = self.transformation(entry, f"the mapping of {parameter.name!r}")
                if linear != Linear() and parameter.type != "Real":
                    raise SSPError(f"{what} scales {parameter.name!r}, which is not of type Real.")
                converts = entry.get("suppressUnitConversion", "false").strip() not in {"true", "1"}
                names = entry.get("target", ""), parameter.type, parameter.value, parameter.unit, parameter.meaning
                result.append(Parameter(*names, linear, converts))
            if parameter.name not in targets:
                result.append(parameter)
        return result

    def size(self, dimension: Element) -> int:
        text = dimension.get("size", "")
        if not (text.strip().isdecimal() and text.isascii() and len(text) < _DIGITS):
            self.refuse(f"has a Dimension of size {text!r}, which is no whole number")
        return int(text)

    def number(self, element: Element, name: str, default: float) -> float:
        text = element.get(name)
        try:
            return default if text is None else type(default)(text)
        except ValueError:
            self.refuse(f"has {name}={text!r}, which is no number")

    def unit_definitions(self, root: Element) -> Iterator[tuple[str, Unit]]:
        for unit in (e for e in root if e.tag.endswith("}Units")):
            for definition in unit.findall(f"{SSC}Unit"):
                base = definition.find(f"{SSC}BaseUnit")
                if base is not None:
                    powers = {full: int(self.number(base, n, 0)) for n, full in _BASE_UNITS.items()}
                    factor, offset = self.number(base, "factor", 1.0), self.number(base, "offset", 0.0)
                    if not (isfinite(factor) and factor and isfinite(offset)):
                        self.refuse(f"defines the unit {definition.get('name')!r} with a factor of {factor:g}")
                    yield definition.get("name", ""), Unit({n: p for n, p in powers.items() if p}, factor, offset)


def _array(texts: list[str], shape: list[int], read: Callable[[str], Value]) -> tuple[Any, ...]:
    """Return the values of an array, given row by row, as tuples of tuples."""
    if len(texts) != prod(shape):
        raise ValueError(texts)
    if len(shape) == 1:
        return tuple(read(text) for text in texts)
    size = prod(shape[1:])
    return tuple(_array(texts[i * size : (i + 1) * size], shape[1:], read) for i in range(shape[0]))


def shown(path: str, end: tuple[str | None, str]) -> str:
    """Return the end of a connection as text for messages."""
    element, connector = end
    return f"{path}{element}.{connector}" if element is not None else f"{path}{connector}"


__all__ = [
    "SSP_FILE",
    "Component",
    "Connection",
    "Linear",
    "Parameter",
    "Structure",
    "System",
    "read_structure",
    "relative",
]
