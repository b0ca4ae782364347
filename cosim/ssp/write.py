"""Write a diagram of FMUs as an SSP: the same diagram always gives the same bytes."""

from __future__ import annotations

import os
import secrets
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent, register_namespace

import numpy as np

from bayesftc.cosim.blocks.mathblocks import Gain
from bayesftc.cosim.blocks.sources import Constant
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.errors import SSPError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.archive import absolute, open_archive
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.ports import Port
from bayesftc.cosim.ssp.read import FMU_TYPE, SSP_FILE, Linear
from bayesftc.cosim.ssp.schema import NAMESPACE, SSC, SSD, SSV

_OSP, _OSP_TYPE = "{http://opensimulationplatform.com/SSP/OSPAnnotations}", "com.opensimulationplatform"
_STAMP = (1980, 1, 1, 0, 0, 0)
_TYPES = {"Real": "Real", "Float64": "Real", "Float32": "Real", "Boolean": "Boolean", "String": "String"}
_LARGEST_INTEGER = 2**31
_IMPLEMENTATIONS = {"co-simulation": "CoSimulation", "model exchange": "ModelExchange"}


@dataclass(frozen=True)
class _Feed:
    """The source of an input of an FMU: an output of another FMU, or a constant (no node, `transformation` of 0)."""

    node: Node | None
    output: str
    transformation: Linear


def save_ssp(diagram: Diagram, path: str | PathLike[str]) -> Path:
    """Save a diagram of FMUs as an .ssp, so that other tools can run it.

    FMUs become components, with the parameters and start values that were set. Scalar `Gain` blocks between them become linear
    transformations of connections; several in a row are combined. `Constant` blocks become start values of inputs. The file is of
    SSP 1.0, or of 2.0 if there are arrays. The step is stored in annotations that `open_ssp` and the Open Simulation Platform
    (libcosim) read; set it yourself in other tools. A tool that steps all FMUs in parallel gives the result of
    ``build("jacobi")``.

    Parameters
    ----------
    diagram : Diagram
        FMUs, all at the base step, gains between them, and constants.
    path : str or path
        The ``.ssp`` to write; it appears under its name only when it is complete.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    SSPError
        If the file cannot be written, or SSP cannot represent the diagram: other blocks, sums of signals, elements of arrays,
        FMUs at several rates, FMUs with ``timing="sampled"``.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from zipfile import ZipFile
    >>> from bayesftc import cosim, fmus
    >>> diagram = cosim.Diagram(dt=0.02)
    >>> car = diagram.add(cosim.FMU(fmus.path("CruiseControl")), "car")
    >>> push = diagram.add(cosim.Constant(100.0), "push")
    >>> diagram.connect(push["y"], car["force"])
    >>> with TemporaryDirectory() as folder:
    ...     file = cosim.save_ssp(diagram, f"{folder}/car.ssp")
    ...     print(file.name, sorted(ZipFile(file).namelist()))
    car.ssp ['SystemStructure.ssd', 'resources/CruiseControl.fmu']
    """
    path = absolute(path, "save_ssp", "the .ssp file to write", SSPError)
    if not isinstance(diagram, Diagram):
        raise SSPError(f"save_ssp has diagram={diagram!r}; it must be a Diagram of FMUs.")
    if path.suffix.lower() != SSP_FILE.suffix:
        raise SSPError(f"{path.name} is no name for an SSP; it must end in {SSP_FILE.suffix}.")
    nodes = [node for node in diagram.nodes if isinstance(node.block, FMU)]
    if not nodes:
        raise SSPError("The diagram has no FMU, but an SSP consists of FMUs; add one.")
    _check_blocks(diagram)
    resources = _resources(nodes)
    structure = _structure(diagram, nodes, resources, path.stem)
    temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}.tmp")
    try:
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED) as archive:
            with archive.open(_entry(SSP_FILE.main), "w") as file:
                ElementTree(structure).write(file, encoding="UTF-8", xml_declaration=True)
            for name, source in sorted({n: s for s, n in resources.items()}.items()):
                archive.writestr(_entry(name), source.read_bytes())
        os.replace(temporary, path)
    except OSError as error:
        raise SSPError(
            f"The SSP cannot be written to {path}: {error.strerror or error}; choose another folder."
        ) from None
    finally:
        with suppress(OSError):  # it exists only if writing has failed
            temporary.unlink(missing_ok=True)
    return path


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _STAMP)
    entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
    return entry


def _check_blocks(diagram: Diagram) -> None:
    used = {reference.node.name for reference, _ in _sources(diagram)}
    for node in diagram.nodes:
        block, label = node.block, f"The block {node.name!r}"
        if not isinstance(block, FMU | Gain | Constant):
            _refuse(
                f"{label} ({type(block).__name__}) has no equivalent in SSP, which has only FMUs, gains between them and "
                "constants. Replace it by an FMU that you export from it"
            )
        if node.every != 1:
            _refuse(
                f"{label} runs with every={node.every}, but SSP does not support several rates. Save a diagram whose blocks all "
                "run at one rate"
            )
        if isinstance(block, FMU) and block.timing == "sampled":
            _refuse(
                f"{label} makes its step before its outputs are used (timing='sampled'), which SSP cannot express. Load the "
                f"same file as {type(block).__name__}(..., timing='plant'), and check whether the delay of one step matters"
            )
        if isinstance(block, Gain) and node.name not in used:
            _refuse(f"{label} feeds no FMU and would be lost; leave it out")


def _refuse(what: str) -> NoReturn:
    raise SSPError(f"The diagram cannot be saved as an SSP. {what}.")


def _sources(diagram: Diagram) -> list[tuple[Any, int]]:
    sources = [
        diagram.source_of(node, port, element)
        for node in diagram.nodes
        for port in node.block.inputs
        for element in range(port.size)
    ]
    return [source for source in sources if source is not None]


def _resources(nodes: list[Node]) -> dict[Path, str]:
    """Return a name in the SSP for each FMU file; files of the same name but different content get a number."""
    names: dict[Path, str] = {}
    digests: dict[str, str] = {}
    for node in nodes:
        file = Path(_fmu(node).path)
        digest, number = open_archive(file).digest, 1
        name = f"resources/{file.name}"
        while digests.setdefault(name, digest) != digest:
            number += 1
            name = f"resources/{file.stem}_{number}{file.suffix}"
        names[file] = name
    return names


def _fmu(node: Node) -> FMU:
    assert isinstance(node.block, FMU)
    return node.block


def _structure(diagram: Diagram, nodes: list[Node], resources: dict[Path, str], name: str) -> Element:
    for prefix, kind in (("ssd", "Description"), ("ssv", "ParameterValues"), ("ssc", "Common")):
        register_namespace(prefix, f"{NAMESPACE}{kind}")
    register_namespace("osp", _OSP[1:-1])
    root = Element(f"{SSD}SystemStructureDescription", version="1.0", name=name, generationTool="bayesftc")
    system = SubElement(root, f"{SSD}System", name="system")
    elements = SubElement(system, f"{SSD}Elements")
    connections = Element(f"{SSD}Connections")
    for node in nodes:
        _add_component(elements, connections, diagram, node, resources[Path(_fmu(node).path)])
    if len(connections):
        system.append(connections)
    SubElement(_annotation(system, "bayesftc"), "bayesftc", step=str(diagram.step))
    algorithm = SubElement(_annotation(SubElement(root, f"{SSD}DefaultExperiment"), _OSP_TYPE), f"{_OSP}Algorithm")
    SubElement(algorithm, f"{_OSP}FixedStepAlgorithm", baseStepSize=repr(float(diagram.step)))
    if next(root.iter(f"{SSC}Dimension"), None) is not None:  # more tools read SSP 1.0, but it has no arrays
        for versioned in (root, *root.iter(f"{SSV}ParameterSet")):
            versioned.set("version", "2.0")
    indent(root)
    return root


def _annotation(owner: Element, kind: str) -> Element:
    return SubElement(SubElement(owner, f"{SSD}Annotations"), f"{SSC}Annotation", type=kind)


def _add_component(elements: Element, connections: Element, diagram: Diagram, node: Node, source: str) -> None:
    block = _fmu(node)
    attributes = {"name": node.name, "type": FMU_TYPE, "source": source}
    component = SubElement(elements, f"{SSD}Component", attributes, implementation=_IMPLEMENTATIONS[str(block.kind)])
    connectors = Element(f"{SSD}Connectors")
    values: dict[str, Any] = dict(block.parameters or {})
    for port in _ports(block.inputs):
        feed = _feed(diagram, node, port)
        tunable = port.name in block.tunable
        if feed is not None and feed.node is None:
            values[port.name] = feed.transformation.offset
        elif feed is not None and tunable:
            _refuse(
                f"{node.name}.{port.name} is a connected parameter, which SSP does not support; leave it unconnected"
            )
        elif feed is not None:
            _add_connection(connections, feed, node.name, port.name)
        if not tunable:
            _add_connector(connectors, node, port, "input")
    for port in _ports(block.outputs):
        _add_connector(connectors, node, port, "output")
    if len(connectors):
        component.append(connectors)
    if values:
        _add_values(component, node, values)


def _ports(side: Sequence[str | Port] | None) -> list[Port]:
    return [port for port in side or () if isinstance(port, Port)]


def _add_connector(connectors: Element, node: Node, port: Port, kind: str) -> None:
    type_ = next(v.type for v in _fmu(node).description.variables if v.name == port.name)
    if type_ == "Enumeration":
        _refuse(
            f"{node.name}.{port.name} is an enumeration, which is not supported as a port of an SSP; leave it out of the FMU's "
            "ports"
        )
    # The unit is in the FMU, so it is not repeated here.
    connector = SubElement(connectors, f"{SSD}Connector", name=port.name, kind=kind)
    SubElement(connector, f"{SSC}{_TYPES.get(type_, 'Integer')}")
    _add_dimensions(connector, port.shape)


def _add_dimensions(element: Element, shape: Sequence[int]) -> None:
    for size in shape:
        SubElement(element, f"{SSC}Dimension", size=str(size))


def _feed(diagram: Diagram, node: Node, port: Port) -> _Feed | None:
    """Return the source of an input: an FMU's output, found backwards through gains, or a constant."""
    target, element, total = node, 0, Linear()
    where = f"{node.name}.{port.name}"
    if port.shape:
        return _feed_of_array(diagram, node, port)
    while True:
        source = diagram.source_of(target, port, element)
        if source is None:
            if target is node:
                return None
            _refuse(f"{target.name}.{port.name}, which feeds {where}, has no source; connect it")
        reference, source_element = source
        block = reference.node.block
        if isinstance(block, FMU):
            if reference.port.shape:
                _refuse(
                    f"{where} is fed by an element of {reference.name}, but an SSP connects whole arrays only. Give the FMU a "
                    "variable for the element"
                )
            return _Feed(reference.node, reference.port.name, total)
        if isinstance(block, Constant):
            return _Feed(None, "", Linear(0.0, total(block.value)))
        assert isinstance(block, Gain)
        row = np.atleast_2d(np.asarray(block.gain, float))[source_element]
        columns = np.flatnonzero(row)
        if len(columns) > 1:
            _refuse(
                f"The block {reference.node.name!r} adds signals on the way to {where}, which SSP cannot express; do this in "
                "an FMU"
            )
        if not len(columns):
            return _Feed(None, "", Linear(0.0, total(block.offset)))
        total = total.after(Linear(float(row[columns[0]]), float(block.offset)))
        target, port, element = reference.node, block.inputs[0], int(columns[0])


def _feed_of_array(diagram: Diagram, node: Node, port: Port) -> _Feed | None:
    """Return the output that feeds a whole array; None if the array is not connected."""
    sources = [diagram.source_of(node, port, i) for i in range(port.size)]
    first = sources[0]
    if all(source is None for source in sources):
        return None
    whole = first is not None and isinstance(first[0].node.block, FMU) and first[0].port.shape == port.shape
    if whole and first is not None:
        origin = first[0].node, first[0].port
        whole = all(s is not None and (s[0].node, s[0].port) == origin and s[1] == i for i, s in enumerate(sources))
    if first is None or not whole:
        _refuse(
            f"{node.name}.{port.name} is an array, and an SSP can connect it only to a whole array of an FMU with the same "
            "shape. Connect such an array, or leave it unconnected"
        )
    return _Feed(first[0].node, first[0].port.name, Linear())


def _add_connection(connections: Element, feed: _Feed, target: str, name: str) -> None:
    assert feed.node is not None
    ends = {"startElement": feed.node.name, "startConnector": feed.output, "endElement": target, "endConnector": name}
    if feed.transformation == Linear():
        SubElement(connections, f"{SSD}Connection", ends)
        return
    # The gain includes the conversion of units, so tools must not convert them again.
    connection = SubElement(connections, f"{SSD}Connection", {**ends, "suppressUnitConversion": "true"})
    numbers = {"factor": repr(feed.transformation.factor), "offset": repr(feed.transformation.offset)}
    SubElement(connection, f"{SSC}LinearTransformation", numbers)


def _add_values(component: Element, node: Node, values: dict[str, Any]) -> None:
    variables = {v.name: v for v in _fmu(node).description.variables}
    bindings = SubElement(component, f"{SSD}ParameterBindings")
    inline = SubElement(SubElement(bindings, f"{SSD}ParameterBinding"), f"{SSD}ParameterValues")
    parameter_set = SubElement(
        inline, f"{SSV}ParameterSet", version="1.0", name="initialValues"
    )  # ecos needs this name
    parameters = SubElement(parameter_set, f"{SSV}Parameters")
    for name, value in values.items():
        shape = np.shape(value)
        elements = [_written(f"{node.name}.{name}", variables[name], part) for part in np.asarray(value, object).flat]
        if not elements:
            continue  # an empty array
        if shape and elements[0][0] in {"String", "Enumeration"}:
            _refuse(f"{node.name}.{name} is an array of strings, which an SSP cannot separate; leave it out")
        parameter = SubElement(parameters, f"{SSV}Parameter", name=name)
        SubElement(parameter, f"{SSV}{elements[0][0]}", value=" ".join(text for _, text in elements))
        _add_dimensions(parameter, shape)


def _written(where: str, variable: FMUVariable, value: Any) -> tuple[str, str]:
    """Return the type and the text of a value; a number from a constant block is converted to the variable's type."""
    if variable.type == "String":
        return "String", value
    kind = _TYPES.get(variable.type, "Integer")
    if kind == "Real":
        return kind, repr(float(value))
    if kind == "Boolean":
        return kind, "true" if value else "false"
    if value != int(value) or not -_LARGEST_INTEGER <= value < _LARGEST_INTEGER:
        _refuse(f"{where} is {value}, but integers in SSP have 32 bits; use a smaller whole number")
    items = {number: item for item, number in variable.items}
    return ("Enumeration", items[int(value)]) if items else (kind, str(int(value)))


__all__ = ["save_ssp"]
