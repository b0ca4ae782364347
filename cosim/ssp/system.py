"""System structures of SSP 1.0 and 2.0: connected FMUs, opened as a diagram and saved for other tools."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from math import isfinite
from os import PathLike
from pathlib import Path, PurePosixPath
from stat import S_ISREG
from typing import Literal

from bayesftc.cosim.base import units
from bayesftc.cosim.base.archives import LARGEST_XML, check_xml
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.blocks.mathblocks import Gain
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.nodes import Node
from bayesftc.cosim.errors import SSPError, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.reading.archive import absolute, extract, open_archive, read_entry
from bayesftc.cosim.fmi.reading.description import FMUDescription
from bayesftc.cosim.ports import Port
from bayesftc.cosim.ssp.flat import Feed, Flat, Path as Place, Variable, components
from bayesftc.cosim.ssp.read import SSP_FILE, Component, Linear, Parameter, Structure, Value, read_structure
from bayesftc.cosim.ssp.steps import every
from bayesftc.cosim.ssp.write import save_ssp

_KINDS: dict[str, Literal["co-simulation", "model exchange"] | None] = {
    "any": None,
    "CoSimulation": "co-simulation",
    "ModelExchange": "model exchange",
}


def open_ssp(
    path: str | PathLike[str],
    *,
    dt: float | str | Fraction | None = None,
    variant: str = SSP_FILE.main,
    isolate: bool = False,
    validate: bool = True,
) -> Diagram:
    """Return the diagram that an .ssp or .ssd describes: its FMUs, with their parameters, connected.

    Nested systems are flattened: the FMU ``b`` of the system ``a`` becomes the block ``a.b``. Arrays (of SSP 2.0) become vector
    and matrix ports. If units differ or a connection has a linear transformation, a `Gain` is added between the two FMUs. Inputs
    of the whole system stay unconnected: they keep their start values, and can be connected.

    SSP does not define the algorithm. All FMUs are plants (their outputs at t_k are read before the step). So ``build("jacobi")``
    gives the results of tools that step all FMUs in parallel; the default is Gauss-Seidel.

    Parameters
    ----------
    path : str or path
        An ``.ssp`` file, or an ``.ssd`` with its referenced files beside it or in folders below.
    dt : float, str or Fraction, optional
        The base step in seconds, which SSP does not define. By default it comes from annotations of this package, of the Open
        Simulation Platform (``FixedStepAlgorithm``) or of OMSimulator (``FixedStepMaster``). A component with a ``StepSizeHint``
        runs at that multiple of the base step.
    variant : str
        Which ``.ssd`` of an ``.ssp`` to open; its references are relative to it.
    isolate : bool
        Run each FMU in a separate process (see `FMU`).
    validate : bool
        False to accept files that break the schemas of SSP 1.0 and FMI, at your own risk.

    Returns
    -------
    Diagram
        Not built yet: controllers, sensors and faults can be added. The FMUs of an ``.ssp`` are in this user's cache.

    Raises
    ------
    SSPError
        If the file is missing, damaged or hostile, or breaks the rules of SSP. If neither the file nor `dt` gives a step. If it
        has elements that a diagram cannot represent: signal dictionaries, components that are no FMUs, nonlinear mappings,
        connections of some elements of arrays.
    FMUError
        If one of its FMUs cannot be used.

    Warns
    -----
    UserWarning
        If values are bound to names that do not exist: SSP requires to ignore them.

    Examples
    --------
    >>> from bayesftc import cosim, fmus
    >>> diagram = cosim.Diagram(dt=0.02)
    >>> lead = diagram.add(cosim.FMU(fmus.path("CruiseControl"), parameters={"force": 100.0}), "lead")
    >>> follower = diagram.add(cosim.FMU(fmus.path("CruiseControl")), "follower")
    >>> diagram.connect(lead["v"], follower["disturbance"])
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = cosim.save_ssp(diagram, folder + "/two_cars.ssp")
    ...     cosim.open_ssp(file).build("jacobi")
    <Diagram of 2 blocks at 0.02 s: lead, follower>
    """
    path = absolute(path, "open_ssp", "an .ssp or .ssd file", SSPError)
    where, place_files, resource = _located(path, variant)
    structure = read_structure(resource(Path(where).name), where, resource, validate=validate)
    sources = {p: c.source for p, c in components(structure.system)}
    if not sources:
        raise SSPError(f"{where} of {path} has no components; add FMUs to run.")
    folder = place_files()  # after all XML was read and checked
    files = {p: folder / source for p, source in sources.items()}
    for place, file in files.items():
        if not file.is_file():
            raise SSPError(
                f"The component {'.'.join(place)!r} of {where} refers to {file.name}, which does not exist; add it."
            )
    descriptions = {file: describe(file, validate=validate) for file in dict.fromkeys(files.values())}
    variables = {place: _variables(descriptions[file]) for place, file in files.items()}
    flat = Flat(structure, variables, where)
    flat.warn_of_unknown()
    diagram = Diagram(_base_step(structure, list(descriptions.values()), where) if dt is None else dt)
    feeds = {place: dict(flat.feeds(place)) for place in files}
    nodes = {}
    for place, component in flat.components.items():
        values = {p.name: _value(p, flat, variables[place][p.name], place) for p in flat.values(place).values()}
        connected = [
            *feeds[place],
            *(f.output for inputs in feeds.values() for f in inputs.values() if f.component == place),
        ]
        block = _fmu(files[place], component, values, connected, isolate, validate)
        nodes[place] = diagram.add(block, "_".join(".".join(place).split()), every(component.step, diagram.step))
        _check_sizes(block, component, nodes[place].name, where)
    for place, node in nodes.items():
        for name, feed in feeds[place].items():
            _connect(diagram, nodes[feed.component], feed, node, name, where)
    return diagram


def _located(path: Path, variant: str) -> tuple[str, Callable[[], Path], Callable[[str], bytes]]:
    """Return the name of the .ssd, a function that returns its folder, and one that reads XML relative to it."""
    if path.suffix.lower() == ".ssd":
        return path.name, lambda: path.parent, lambda name: _beside(path, name)
    archive = open_archive(path, SSP_FILE)
    if variant not in archive.names:
        variants = [name for name in archive.names if name.endswith(".ssd")]
        raise SSPError(f"{path} has no {variant!r}; {did_you_mean(variant, variants)}")

    beside = PurePosixPath(variant).parent

    def resource(name: str) -> bytes:
        entry = str(beside / name)
        if entry not in archive.names:
            raise SSPError(f"{variant} of {path} refers to {entry!r}, which is not in the file; add it.")
        return read_entry(archive, entry)

    return variant, lambda: extract(archive, variant) / beside, resource


def _beside(path: Path, name: str) -> bytes:
    file = path.parent / name
    try:
        status = file.stat()
        if not S_ISREG(status.st_mode):
            raise SSPError(f"{file} is no file; check the path.")
        if status.st_size > LARGEST_XML:
            raise SSPError(f"{file} has more than {LARGEST_XML:,} bytes; split it, or check that it is the right file.")
        content = file.read_bytes()
    except OSError as error:
        raise SSPError(f"{file} cannot be read ({error.strerror}); check the path.") from None
    return check_xml(content, str(file), SSP_FILE)


def _variables(description: FMUDescription) -> dict[str, Variable]:
    return {v.name: Variable(v.causality, v.unit) for v in description.variables}


def _base_step(structure: Structure, descriptions: Sequence[FMUDescription], where: str) -> Fraction:
    """Return the base step of the SSP; raise SSPError if it has none, as all results depend on it."""
    steps = structure.steps
    if steps.fixed is not None:
        return steps.fixed
    recommended = {text for d in descriptions if (text := d.default_experiment.get("stepSize"))}
    hints = {show(c.step) for _, c in components(structure.system) if c.step is not None}
    advice = [
        f"its FMUs recommend {' and '.join(sorted(map(str, recommended)))} s" if recommended else "",
        f"its components have steps of {' and '.join(sorted(hints))} s" if hints else "",
        f"its solver has variable steps of up to {steps.longest} s" if steps.longest else "",
    ]
    hint = "; ".join(part for part in advice if part)
    raise SSPError(
        f"{where} gives no step size{f' ({hint})' if hint else ''}; give dt=... in seconds, as in "
        f"open_ssp(path, dt={next(iter(sorted(map(str, recommended))), '0.01')})."
    )


def _fmu(
    file: Path,
    component: Component,
    values: dict[str, Value],
    connected: Sequence[str],
    isolate: bool,
    validate: bool,
) -> FMU:
    """Return the block of a component; variables in `connected` become ports even if they are not by default."""
    block = FMU(file, parameters=values, validate=validate, kind=_KINDS[component.implementation])
    ports = {side: [p.name for p in getattr(block, side) if isinstance(p, Port)] for side in ("inputs", "outputs")}
    causality = {v.name: f"{v.causality}s" for v in block.description.variables}
    for name in connected:
        names = ports[causality[name]]
        if name not in names:
            names.append(name)
    timing = None if block.kind == "model exchange" else "plant"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the docstring of open_ssp states that all FMUs are plants
        return replace(block, **ports, timing=timing, isolate=isolate)  # type: ignore[arg-type]


def _check_sizes(block: FMU, component: Component, name: str, where: str) -> None:
    """Compare the declared sizes of connectors with those of the FMU's arrays."""
    shapes = {p.name: p.shape for side in (block.inputs, block.outputs) for p in side or () if isinstance(p, Port)}
    for port, connector in component.connectors.items():
        shape, declared = shapes.get(port), connector.dimensions
        if shape is None or not declared:
            continue
        if len(shape) != len(declared) or any(d not in {None, n} for d, n in zip(declared, shape, strict=True)):
            sizes = " x ".join("?" if d is None else str(d) for d in declared)
            raise SSPError(
                f"{where} declares {name}.{port} as an array of {sizes}, but in {component.source} its shape is {shape}. Set the "
                "structural parameter for its size."
            )


def _value(parameter: Parameter, flat: Flat, variable: Variable, place: Place) -> Value:
    """Return a bound value in the variable's unit."""
    value = parameter.value
    if parameter.type != "Real" or isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return tuple(_value(replace(parameter, value=part), flat, variable, place) for part in value)
    target = variable.unit if parameter.converts else None
    what = f"The value of {'.'.join((*place, parameter.name))!r}"
    return parameter.then(flat.convert(parameter.unit, target, what, parameter.meaning)(value))


def _connect(diagram: Diagram, source: Node, feed: Feed, target: Node, name: str, where: str) -> None:
    output, input_ = source[feed.output], target[name]
    if output.port.shape != input_.port.shape:
        raise SSPError(
            f"{where} connects {output.name}, of shape {output.port.shape}, to {input_.name}, of shape {input_.port.shape}. "
            "Connect ports of the same shape; check the structural parameters."
        )
    between = (output.port.unit, input_.port.unit)
    differ = None not in between and units.difference(*between) is not None  # type: ignore[arg-type]
    if feed.transformation == Linear() and not differ:
        diagram.connect(output, input_)
        return
    factor, offset = feed.transformation.factor, feed.transformation.offset
    if not (isfinite(factor) and isfinite(offset)):
        raise SSPError(
            f"{where} transforms {output.name} on the way to {input_.name} by numbers that are not finite; correct them."
        )
    if len(output) > 1:
        raise SSPError(f"{where} transforms the array {output.name} on the way to {input_.name}; do this in the FMU.")
    gain = diagram.add(Gain(factor, offset=offset), f"{target.name}.{name}.transformation")
    diagram.connect(output, gain["u"])
    diagram.connect(gain["y"], input_)


__all__ = ["open_ssp", "save_ssp"]
