"""A flattened system structure: the source of each input of each component, and the values bound to its variables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from bayesftc.cosim.base import units
from bayesftc.cosim.base.units import Unit
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import SSPError, did_you_mean
from bayesftc.cosim.ssp.read import Component, Connection, Linear, Parameter, Structure, System, shown

Path = tuple[str, ...]
Place = tuple[Path, str]
"""A connector: the path of its element (of the whole system: empty), and its name."""

_SOURCES, _SINKS = {"output", "calculatedParameter"}, {"input", "parameter"}


@dataclass(frozen=True)
class Variable:
    """Causality and unit of a variable of an FMU."""

    causality: str
    unit: str | None


@dataclass(frozen=True)
class Feed:
    """The source of an input: an output of a component, and the transformation between the two."""

    component: Path
    output: str
    transformation: Linear


@dataclass(frozen=True)
class _Edge:
    other: Place
    connection: Connection
    path: Path


class Flat:
    """A flattened system structure.

    Parameters
    ----------
    structure : Structure
        The structure to flatten.
    variables : mapping of path to mapping of name to Variable
        The variables of each component's FMU.
    where : str
        The name of the .ssd, for messages.

    Raises
    ------
    SSPError
        If a connection is not valid, or units cannot be converted.
    """

    def __init__(self, structure: Structure, variables: Mapping[Path, Mapping[str, Variable]], where: str):
        self._structure, self._variables, self._where = structure, variables, where
        self.components = dict(components(structure.system))
        self._sources: dict[Place, _Edge] = {}
        self._targets: dict[Place, list[_Edge]] = {}
        for path, component in self.components.items():
            self._check_connectors(path, component)
        self._walk(structure.system, ())

    def feeds(self, path: Path) -> Iterator[tuple[str, Feed]]:
        """Yield the connected inputs of a component, with their sources."""
        for name, variable in self._variables[path].items():
            feed = self._feed((path, name)) if variable.causality == "input" else None
            if feed is not None:
                yield name, feed

    def values(self, path: Path) -> dict[str, Parameter]:
        """Return the values bound to a component's variables; bindings of enclosing systems override the component's."""
        result: dict[str, Parameter] = {}
        for parameter in self.components[path].parameters:
            if parameter.name in self._variables[path]:
                result[parameter.name] = parameter
            else:
                self._ignored(parameter, ".".join(path), self._variables[path])
        for depth in range(len(path) - 1, -1, -1):
            for parameter in self._system(path[:depth]).parameters:
                for (owner, name), linear in self._targets_of(path[:depth], parameter.name):
                    if owner == path:
                        then = linear.after(parameter.then)
                        content = parameter.value, parameter.unit, parameter.meaning
                        result[name] = Parameter(name, parameter.type, *content, then, parameter.converts)
        return result

    def warn_of_unknown(self) -> None:
        """Warn of values that are bound to systems, but to no variable of theirs."""
        for path, system in systems(self._structure.system):
            for parameter in system.parameters:
                if not list(self._targets_of(path, parameter.name)) and not self._is_connector(path, parameter.name):
                    names = [".".join((*p[len(path) :], n)) for p in self._below(path) for n in self._variables[p]]
                    self._ignored(parameter, ".".join(path) or "the system", [*names, *system.connectors])

    def convert(self, source: str | None, target: str | None, what: str, meaning: Unit | None = None) -> Linear:
        """Return the conversion from one unit to another; the identity if one of them is not given.

        `meaning` is the definition of the source unit in the file of the value, if there is one.

        Raises
        ------
        SSPError
            If the units cannot be converted.
        """
        if source is None or target is None or source == target:
            return Linear()
        first, second = meaning or self._structure.unit(source), self._structure.unit(target)
        if first is None or second is None:
            unknown = source if first is None else target
            raise SSPError(
                f"{what} in {self._where} goes from {source} to {target}, but the unit {unknown!r} is not known. Define it under "
                "Units of the .ssd, or set suppressUnitConversion."
            )
        factors = units.gain(first, second)
        if isinstance(factors, str):
            raise SSPError(f"{what} in {self._where} goes from {source} to {target}: {factors}.")
        return Linear(*factors)

    def _check_connectors(self, path: Path, component: Component) -> None:
        for name, connector in component.connectors.items():
            label = f"The connector {'.'.join((*path, name))!r} of {self._where}"
            variable = self._variables[path].get(name)
            if variable is None:
                raise SSPError(
                    f"{label} is no variable of {component.source}; {did_you_mean(name, self._variables[path])}"
                )
            kind = "parameter" if variable.causality == "structuralParameter" else variable.causality
            if connector.kind != kind:
                raise SSPError(
                    f"{label} is of kind {connector.kind}, but in {component.source} its causality is {variable.causality}. Give "
                    "it that kind."
                )
            if connector.unit and variable.unit:
                linear = self.convert(connector.unit, variable.unit, label)
                if linear != Linear():
                    raise SSPError(
                        f"{label} is in {connector.unit}, but in {component.source} it is in {variable.unit}; give it that unit."
                    )

    def _walk(self, system: System, path: Path) -> None:
        for name, element in system.elements.items():
            if isinstance(element, System):
                self._walk(element, (*path, name))
        for connection in system.connections:
            what = f"The connection from {self._shown(path, connection, 'start')} to {self._shown(path, connection, 'end')}"
            ends = [self._place(path, system, end, what) for end in (connection.start, connection.end)]
            sources = [self._is_source(place, path, what) for place in ends]
            if sources[0] == sources[1]:
                both = "give a value" if sources[0] else "take a value"
                raise SSPError(
                    f"{what} in {self._where} joins two connectors that both {both}; join an output and an input."
                )
            source, sink = ends if sources[0] else ends[::-1]
            if sink in self._sources:
                raise SSPError(
                    f"{'.'.join((*sink[0], sink[1]))} in {self._where} has two connections that feed it; remove one of them."
                )
            self._sources[sink] = _Edge(source, connection, path)
            self._targets.setdefault(source, []).append(_Edge(sink, connection, path))

    def _place(self, path: Path, system: System, end: tuple[str | None, str], what: str) -> Place:
        element, connector = end
        if element is not None and element not in system.elements:
            raise SSPError(
                f"{what} in {self._where} names an element that does not exist; {did_you_mean(element, system.elements)}"
            )
        place = ((*path, element), connector) if element is not None else (path, connector)
        if self._kind(place) is None:
            owner = system.elements[element] if element is not None else system
            connectors = self._variables[place[0]] if isinstance(owner, Component) else owner.connectors
            raise SSPError(
                f"{what} in {self._where} names a connector that does not exist; {did_you_mean(connector, connectors)}"
            )
        return place

    def _kind(self, place: Place) -> str | None:
        path, name = place
        if path in self.components:
            variable = self._variables[path].get(name)
            return None if variable is None else variable.causality
        connector = self._system(path).connectors.get(name)
        return None if connector is None else connector.kind

    def _is_source(self, place: Place, path: Path, what: str) -> bool:
        """Return whether a connector is a source for the connections inside the system at `path`."""
        kind = self._kind(place)
        if kind == "calculatedParameter" and place[0] != path:
            raise SSPError(
                f"{what} in {self._where} passes on a parameter that is calculated at the start, which is not supported. Bind a "
                "value to the target."
            )
        if kind not in _SOURCES | _SINKS:
            raise SSPError(f"{what} in {self._where} has an end of kind {kind}; join an output and an input.")
        return (kind in _SINKS) if place[0] == path else (kind in _SOURCES)

    def _feed(self, sink: Place) -> Feed | None:
        """Return the source of an input, found backwards through the connectors of the systems between them."""
        edges: list[tuple[_Edge, Place]] = []
        place = sink
        while place not in self._outputs:
            edge = self._sources.get(place)
            if edge is None:
                return None  # unconnected, or an input of the whole system: the start value is used
            if (edge, place) in edges:
                raise SSPError(
                    f"The connections of {self._name(place)} in {self._where} form a cycle; remove one of them."
                )
            edges.append((edge, place))
            place = edge.other
        unit, total = self._unit(place), Linear()
        for edge, end in reversed(edges):
            linear, unit = self._through(edge, unit, end)
            total = linear.after(total)
        return Feed(*place, total)

    def _through(self, edge: _Edge, unit: str | None, end: Place) -> tuple[Linear, str | None]:
        """Return the transformation of a connection for a value in a unit, and the unit of the result."""
        what = f"The connection from {self._name(edge.other)} to {self._name(end)}"
        to = self._unit(end)
        converted = self.convert(unit, to, what) if edge.connection.converts else Linear()
        return edge.connection.transformation.after(converted), to or (unit if edge.connection.converts else None)

    def _targets_of(self, path: Path, name: str) -> Iterator[tuple[Place, Linear]]:
        """Yield the variables of components to which a hierarchical name refers, and the transformations of their values."""
        system = self._system(path)
        if name in system.connectors:
            yield from self._inward((path, name), Linear())
            return
        for element, inner in system.elements.items():
            rest = name.removeprefix(f"{element}.")
            if rest == name:
                continue
            below = (*path, element)
            if isinstance(inner, System):
                yield from self._targets_of(below, rest)
            elif rest in self._variables[below]:
                yield (below, rest), Linear()

    def _is_connector(self, path: Path, name: str) -> bool:
        """Return whether a hierarchical name refers to a connector of a system, which may be unconnected."""
        system = self._system(path)
        if name in system.connectors:
            return True
        inner = ((e, s) for e, s in system.elements.items() if isinstance(s, System) and name.startswith(f"{e}."))
        return any(self._is_connector((*path, e), name.removeprefix(f"{e}.")) for e, _ in inner)

    def _inward(self, place: Place, linear: Linear) -> Iterator[tuple[Place, Linear]]:
        for edge in self._targets.get(place, ()):
            if len(edge.path) < len(place[0]):
                continue  # a connection outside of the connector's system
            then = edge.connection.transformation.after(linear)
            if edge.other[0] in self.components:
                yield edge.other, then
            else:
                yield from self._inward(edge.other, then)

    @cached_property
    def _outputs(self) -> set[Place]:
        return {(p, n) for p, known in self._variables.items() for n, v in known.items() if v.causality == "output"}

    def _unit(self, place: Place) -> str | None:
        path, name = place
        if path in self.components:
            declared = self.components[path].connectors.get(name)
            return (declared and declared.unit) or self._variables[path][name].unit
        return self._system(path).connectors[name].unit

    def _system(self, path: Path) -> System:
        system = self._structure.system
        for name in path:
            inner = system.elements[name]
            assert isinstance(inner, System)
            system = inner
        return system

    def _below(self, path: Path) -> Iterator[Path]:
        return (p for p in self.components if p[: len(path)] == path)

    def _name(self, place: Place) -> str:
        return ".".join((*place[0], place[1]))

    def _shown(self, path: Path, connection: Connection, side: str) -> str:
        return shown("".join(f"{p}." for p in path), getattr(connection, side))

    def _ignored(self, parameter: Parameter, owner: str, names: Iterable[str]) -> None:
        warn_user(
            f"{self._where} binds a value to {parameter.name!r} of {owner!r}, which does not exist; SSP requires to ignore it. "
            f"Check the name: {did_you_mean(parameter.name, names)}"
        )


def components(system: System, path: Path = ()) -> Iterator[tuple[Path, Component]]:
    """Yield all components with their paths, in the order of the file."""
    for name, element in system.elements.items():
        if isinstance(element, System):
            yield from components(element, (*path, name))
        else:
            yield (*path, name), element


def systems(system: System, path: Path = ()) -> Iterator[tuple[Path, System]]:
    """Yield all systems with their paths."""
    yield path, system
    for name, element in system.elements.items():
        if isinstance(element, System):
            yield from systems(element, (*path, name))


__all__ = ["Feed", "Flat", "Variable", "components"]
