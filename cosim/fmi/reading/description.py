"""The model description of an FMU as plain data: read and validated by fmpy, without loading any binary."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.units import BASE, Unit, UnitDefinition
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.reading import version1
from bayesftc.cosim.fmi.reading.aliases import check_aliases
from bayesftc.cosim.fmi.reading.archive import DESCRIPTION, Archive, read_entry
from bayesftc.cosim.fmi.reading.clocks import Clock, read_clocks
from bayesftc.cosim.fmi.reading.exchange import ExchangeInfo, read_exchange
from bayesftc.cosim.fmi.reading.rules import parse
from bayesftc.cosim.fmi.reading.structure import check_shape, check_size, check_structure
from bayesftc.cosim.fmi.reading.versions import check_version

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription, ModelVariable

Value = float | int | bool | str | tuple[Any, ...]
"""A value of a variable; for an array, tuples of tuples, row by row."""

_Scalar = float | int | bool | str
Given = _Scalar | Sequence[_Scalar | Sequence[_Scalar | Sequence[_Scalar]]] | NDArray[Any]
"""A value from the user, with a unit (``(30, "deg")``, ``([[1, 0], [0, 1]], "kg")``) or without."""

_FLOATS = frozenset({"Real", "Float64", "Float32"})
_KINDS = ("coSimulation", "modelExchange", "scheduledExecution")
_CAPABILITIES = (
    "needsExecutionTool",
    "canBeInstantiatedOnlyOncePerProcess",
    "canGetAndSetFMUstate",
    "canSerializeFMUstate",
    "providesDirectionalDerivative",
    "canHandleVariableCommunicationStepSize",
    "fixedInternalStepSize",
    "maxOutputDerivativeOrder",
    "canInterpolateInputs",
    "hasEventMode",
    "mightReturnEarlyFromDoStep",
)
_SYMBOLS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

LONGEST_IDENTIFIER = 240
"""Most bytes of a model identifier: with its suffix, it is the name of a file."""


@dataclass(frozen=True)
class FMUVariable:
    """One variable of an FMU, in the terms of the standard.

    Attributes
    ----------
    name, causality, variability, type : str
        As in the model description, with the standard's defaults filled in.
    start : float, int, bool, str, tuple or None
        Start value; of an array, tuples of tuples, row by row.
    unit, description : str or None
        As in the model description.
    shape : tuple of int
        ``()`` for a scalar; only FMI 3 has arrays. Structural parameters count with their start values.
    settable : bool
        Whether its start value may be set before initialization.
    reference : int
        The value reference, which identifies it in the binary.
    clocks : tuple of int
        Value references of its clocks (FMI 3): a clocked variable has a value only at their ticks. Mostly empty.
    alias : bool
        Whether it is another name of a variable that is listed too (FMI 3).
    dimensions : tuple of int or str
        Of an array: its size in each direction, or the name of the structural parameter that sets the size.
    items : tuple of (str, int)
        Of an enumeration: names and numbers.
    relative : bool
        Whether it is a difference, to which a unit's offset (degC) does not apply.
    bounds : (float, float)
        Its min and max; infinite if not declared.
    clock : Clock or None
        Of a clock: its declaration.
    negated : bool
        Whether its value is the negative of the binary's value under its value reference (FMI 1).
    """

    name: str
    causality: str
    variability: str
    type: str
    start: Value | None
    unit: str | None
    description: str | None
    shape: tuple[int, ...]
    settable: bool
    reference: int
    clocks: tuple[int, ...] = ()
    alias: bool = False
    dimensions: tuple[int | str, ...] = ()
    items: tuple[tuple[str, int], ...] = ()
    relative: bool = False
    bounds: tuple[float, float] = field(default=(-math.inf, math.inf), repr=False)
    clock: Clock | None = None
    negated: bool = False

    @property
    def clocked(self) -> bool:
        """Whether it has a value only at the ticks of clocks."""
        return bool(self.clocks)

    @property
    def is_float(self) -> bool:
        """Whether it consists of floating-point numbers, of 64 or 32 bits, and so can be continuous."""
        return self.type in _FLOATS

    @property
    def is_numeric(self) -> bool:
        """Whether its values are numbers."""
        return self.type not in {"String", "Binary", "Clock"}


MOST_SHOWN = 200
"""Most variables in a table for notebooks."""


@dataclass(frozen=True)
class FMUDescription:
    """The model description of an FMU.

    Attributes
    ----------
    name, fmi_version : str
        The model's name, and the version of the standard, as ``"2.0"``.
    kinds : tuple of str
        The supported ones of ``"coSimulation"``, ``"modelExchange"``, ``"scheduledExecution"``.
    platforms : tuple of str
        Platforms with binaries in the file, in FMI's spelling.
    variables : tuple of FMUVariable
        All its variables.
    capabilities : mapping
        The flags of its co-simulation kind, or of its first kind if it does not support co-simulation.
    default_experiment : mapping of str to float
        The given ones of ``startTime``, ``stopTime``, ``tolerance``, ``stepSize``.
    description, generation_tool : str or None
        As in the model description.
    timing : str or None
        ``"plant"`` or ``"sampled"``, from the vendor annotation of this package's exports.
    feedthrough : mapping of str to tuple of str, or None
        For each output, the inputs on which it depends at the same instant. None if not declared, which in the standard means
        all inputs.
    identifier, token : str
        Name of the binary, and the token (GUID) that proves that binary and description belong together.
    log_categories : tuple of str
        Categories under which it logs.
    units : mapping of str to UnitDefinition
        Its unit definitions, by name.
    exchange : ExchangeInfo or None
        Its states, derivatives and capabilities in model exchange; None if that is not supported.
    blocks : tuple of str
        Names of the blocks from which it was exported, from the vendor annotation.
    traits : mapping of str
        What an exported controller says about itself beside its variables, such as ``"fault_kinds"``, from the vendor annotation.
    origins : mapping of str to str
        Names in the diagram of signals that the export renamed, from the vendor annotation.
    finite : bool
        Whether a NaN in its outputs is an error. False if the vendor annotation declares NaN as a missing sample.
    lax : str or None
        A sentence that lists broken rules of FMI which do not affect results, if there are any.
    """

    name: str
    fmi_version: str
    kinds: tuple[str, ...]
    platforms: tuple[str, ...]
    variables: tuple[FMUVariable, ...]
    capabilities: Mapping[str, Any]
    default_experiment: Mapping[str, float]
    description: str | None = None
    generation_tool: str | None = None
    timing: str | None = None
    feedthrough: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    identifier: str = ""
    token: str = field(default="", repr=False)
    log_categories: tuple[str, ...] = field(default=(), repr=False)
    units: Mapping[str, UnitDefinition] = field(default_factory=dict, repr=False)
    exchange: ExchangeInfo | None = field(default=None, repr=False)
    blocks: tuple[str, ...] = ()
    traits: Mapping[str, Any] = field(default_factory=dict, repr=False)
    origins: Mapping[str, str] = field(default_factory=dict, repr=False)
    finite: bool = True
    lax: str | None = None

    def __repr__(self) -> str:
        kinds = ", ".join(self.kinds)
        return f"FMUDescription({self.name!r}, FMI {self.fmi_version}, {kinds}, {len(self.variables)} variables)"

    def _repr_html_(self) -> str:
        """Return a table of the variables, for notebooks."""
        rows = [
            (v.name, v.causality, v.unit or "", "" if v.start is None else v.start, v.description or "")
            for v in self.variables[:MOST_SHOWN]
        ]
        title = repr(self) if len(rows) == len(self.variables) else f"{self!r}, the first {len(rows)}"
        return table(title, rows, ("variable", "causality", "unit", "start", "description"))

    @property
    def fmi_major(self) -> int:
        """Major version of FMI: 1, 2 or 3."""
        return int(self.fmi_version[0])

    @property
    def uses_event_mode(self) -> bool:
        """Whether it uses event mode in co-simulation."""
        return "coSimulation" in self.kinds and bool(self.capabilities.get("hasEventMode"))


_lock = threading.RLock()
_known: dict[tuple[str, bool], FMUDescription] = {}


def read_description(archive: Archive, *, validate: bool = True) -> FMUDescription:
    """Read the model description of an FMU, once per process and content.

    Raises
    ------
    FMUError
        If its version is not FMI 1.0, 2.0 or 3.0, or it is not valid.
    """
    with _lock:
        key = (archive.digest, validate)
        if key not in _known:
            try:
                _known[key] = _read(archive, validate)
            except (ValueError, TypeError, LookupError, AttributeError) as error:
                # Without validation, numbers and names may be anything.
                raise FMUError(
                    f"The {DESCRIPTION} of {archive.path} breaks the rules of FMI and cannot be read ({error}); export it again."
                ) from None
        return _known[key]


def _read(archive: Archive, validate: bool) -> FMUDescription:
    from xml.etree import ElementTree

    content = read_entry(archive, DESCRIPTION)
    root = ElementTree.fromstring(content)
    version = root.get("fmiVersion", "")
    check_version(archive, version)
    check_structure(archive, root, validate=validate)
    annotations, clocks = list(root.iter("bayesftc")), read_clocks(root)
    declared = root.find("ModelVariables")
    aliases = version1.aliases(root) if version == "1.0" else {}
    if version != "1.0" and declared is not None:
        declared.clear()  # saves memory: for a large model, this tree is as large as fmpy's
    model, lax = parse(archive, content, validate)
    if version == "1.0":
        version1.complete(model, root)
    kinds = tuple(kind for kind in _KINDS if getattr(model, kind) is not None)
    for kind in kinds:
        _check_identifier(archive, getattr(model, kind).modelIdentifier or "")
    first = getattr(model, kinds[0]) if kinds else None
    experiment = model.defaultExperiment
    timings = [annotation.get("timing") for annotation in annotations]
    check_size(archive, [(v.name, tuple(v.shape or ())) for v in model.modelVariables])
    variables = tuple(
        _variable(archive, v, clocks, aliases.get(v.name) == "negatedAlias") for v in model.modelVariables
    )
    if validate and version != "3.0":
        check_aliases(archive, [v for v in variables if v.name not in aliases])
    return FMUDescription(
        name=model.modelName or archive.path.stem,
        fmi_version=version,
        kinds=kinds,
        platforms=archive.platforms(),
        variables=variables,
        capabilities={name: getattr(first, name) for name in _CAPABILITIES if hasattr(first, name)},
        default_experiment={
            name: float(text)
            for name in ("startTime", "stopTime", "tolerance", "stepSize")
            if (text := getattr(experiment, name, None)) is not None
        },
        description=model.description,
        generation_tool=model.generationTool,
        timing=next((timing for timing in timings if timing in {"plant", "sampled"}), None),
        feedthrough=_feedthrough(model),
        identifier=getattr(first, "modelIdentifier", None) or "",
        token=model.guid or "",
        log_categories=tuple(c.name for c in model.logCategories),
        units={u.name: _unit(u) for u in model.unitDefinitions},
        exchange=read_exchange(model, root, variables),
        blocks=tuple(name for annotation in annotations for name in annotation.get("blocks", "").split()),
        traits=_traits(annotations),
        lax=lax,
        finite=all(annotation.get("finite") != "false" for annotation in annotations),
        origins={s.get("name", ""): s.get("origin", "") for a in annotations for s in a.iter("Signal")},
    )


def _traits(annotations: Sequence[Any]) -> Mapping[str, Any]:
    """Return the traits of an exported controller; nothing if another tool has damaged them."""
    for annotation in annotations:
        try:
            found = json.loads(annotation.get("traits", "{}"))
        except (ValueError, RecursionError):
            continue
        if isinstance(found, dict) and found:
            return found
    return {}


def _check_identifier(archive: Archive, identifier: str) -> None:
    # It is the name of a file, read or (where sources are compiled) written.
    if len(identifier.encode()) > LONGEST_IDENTIFIER:
        raise FMUError(
            f"The {DESCRIPTION} of {archive.path} has a modelIdentifier of {len(identifier):,} characters, {identifier[:20]!r} "
            f"and so on. The name of a binary has at most {LONGEST_IDENTIFIER}. Export it again with a shorter one."
        )
    if (
        "/" in identifier
        or "\\" in identifier
        or identifier.startswith((".", "-"))
        or not (identifier + "a").isprintable()
    ):
        raise FMUError(
            f"The {DESCRIPTION} of {archive.path} has the modelIdentifier {identifier!r}, which could lead outside of the FMU. "
            "Do not use this file; ask its maker for one whose modelIdentifier is a plain name."
        )


def _variable(archive: Archive, variable: ModelVariable, clocks: Mapping[int, Clock], negated: bool) -> FMUVariable:
    check_shape(variable.name, variable.valueReference, variable.dimensions)
    settable = variable.variability != "constant" and (
        variable.causality == "input" or variable.initial in {"exact", "approx"}
    )
    settable = settable and not (negated and variable.type not in {"Real", "Integer"})
    return FMUVariable(
        name=variable.name,
        causality=variable.causality,
        variability=variable.variability,
        type=variable.type,
        start=_start(archive, variable),
        unit=_declared(variable, "unit"),
        description=variable.description,
        shape=tuple(variable.shape or ()),
        settable=settable,
        reference=variable.valueReference,
        clocks=tuple(c.valueReference for c in variable.clocks or ()),
        alias=variable.alias is not None,
        dimensions=tuple(int(d.start) if d.start is not None else d.variable.name for d in variable.dimensions),
        items=tuple((item.name, int(item.value)) for item in getattr(variable.declaredType, "items", None) or ()),
        relative=bool(_declared(variable, "relativeQuantity")),
        bounds=_bounds(variable),
        clock=clocks.get(variable.valueReference) if variable.type == "Clock" else None,
        negated=negated,
    )


def _bounds(variable: ModelVariable) -> tuple[float, float]:
    """Return the declared min and max of a variable."""
    limits = []
    for attribute, otherwise in (("min", -math.inf), ("max", math.inf)):
        declared = _declared(variable, attribute)
        try:
            limits.append(otherwise if declared is None else float(declared))
        except (TypeError, ValueError):  # the description is not validated
            limits.append(otherwise)
    low, high = (otherwise if math.isnan(x) else x for x, otherwise in zip(limits, (-math.inf, math.inf), strict=True))
    return (low, high) if low <= high else (-math.inf, math.inf)


def _declared(variable: ModelVariable, attribute: str) -> Any:
    """Return an attribute of a variable, or else of its declared type."""
    value = getattr(variable, attribute, None)
    return getattr(variable.declaredType, attribute, None) if value is None else value


def _unit(unit: Any) -> UnitDefinition:
    base, meaning = unit.baseUnit, None
    if base is not None and _is_factor(base.factor):
        powers = {name: int(getattr(base, symbol)) for symbol, name in zip(_SYMBOLS, BASE, strict=True)}
        powers = {name: power for name, power in powers.items() if power}
        meaning = Unit(powers, float(base.factor), float(base.offset), cycles="Hz" in unit.name)
    return UnitDefinition(
        meaning, {d.name: (float(d.factor), float(d.offset)) for d in unit.displayUnits if _is_factor(d.factor)}
    )


def _is_factor(value: float) -> bool:
    return math.isfinite(value) and value != 0.0


def _feedthrough(model: ModelDescription) -> dict[str, tuple[str, ...] | None]:
    result: dict[str, tuple[str, ...] | None] = {v.name: None for v in model.modelVariables if v.causality == "output"}
    for unknown in model.outputs:
        if unknown.variable is not None and unknown.dependencies is not None and unknown.variable.name in result:
            result[unknown.variable.name] = tuple(v.name for v in unknown.dependencies if v.causality == "input")
    return result


def _start(archive: Archive, variable: ModelVariable) -> Value | None:
    text: str | None = variable.start
    if text is None or (variable.shape and variable.type in {"String", "Binary"}):
        return None
    try:
        if not variable.shape:
            return _number(variable.type, text)
        values = tuple(_number(variable.type, part) for part in text.split())
        return None if None in values else shaped(values, variable.shape)
    except ValueError:
        what = f"{variable.type} of shape {tuple(variable.shape)}" if variable.shape else variable.type
        raise FMUError(
            f"The variable {variable.name!r} of {archive.path} has the start value {text[:80]!r}, which is no valid {what}; "
            "export the FMU again."
        ) from None


def _number(kind: str, text: str) -> Value | None:
    if kind in _FLOATS:
        value = float(text)
        return value if math.isfinite(value) else None
    if kind == "Boolean":
        return text in {"true", "1"}
    return text if kind in {"String", "Binary"} else int(text)


def flattened(value: Value) -> tuple[Any, ...]:
    """Return the elements of a value, row by row; a scalar has one element."""
    return tuple(x for row in value for x in flattened(row)) if isinstance(value, tuple) else (value,)


def shaped(values: tuple[Any, ...], shape: tuple[int, ...]) -> Value:
    """Return elements as tuples of tuples; a single element fills the array.

    Raises
    ------
    ValueError
        If there are too many or too few.
    """
    if len(values) == 1:
        values = values * math.prod(shape)
    if len(values) != math.prod(shape) or not values:
        raise ValueError
    for size in reversed(shape[1:]):
        values = tuple(values[i : i + size] for i in range(0, len(values), size))
    return values
