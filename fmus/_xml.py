"""Common parts of the model descriptions of FMI 2 and FMI 3, and the build description."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from bayesftc.fmus.spec import Model, Variable

# Constant, so that building twice gives the same bytes: the earliest time that a zip file supports.
GENERATED = "1980-01-01T00:00:00Z"
LOG_CATEGORIES = {
    "logStatusWarning": "Calls that have no effect",
    "logStatusDiscard": "Questions that have no answer",
    "logStatusError": "Calls that are refused, and why",
}


def write(root: ET.Element) -> bytes:
    """Serialise an element as an indented document that ends in a newline."""
    ET.indent(root)
    text: str = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def description_root(model: Model, fmi: str, token: dict[str, str]) -> ET.Element:
    """Open ``fmiModelDescription`` with the attributes that both versions have."""
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": fmi,
            "modelName": model.name,
            **token,
            "description": model.description,
            "generationTool": "bayesftc",
            "generationDateAndTime": GENERATED,
            "variableNamingConvention": "structured",
        },
    )


def add_units(root: ET.Element, model: Model) -> None:
    """Add the unit definitions, each with its exponents of the base units where they are known."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in model.units:
        exponents = {base: getattr(unit, base) for base in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        attributes = {name: str(power) for name, power in exponents.items() if power}
        attributes |= {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
        attributes |= {"offset": repr(unit.offset)} if unit.offset else {}
        element = ET.SubElement(definitions, "Unit", {"name": unit.name})
        if unit.defined:  # a base unit without exponents would mean a number
            ET.SubElement(element, "BaseUnit", attributes)


def variable_attributes(variable: Variable, reference: int) -> dict[str, str]:
    """Return the common attributes of a variable's element."""
    return {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }


def add_log_categories(root: ET.Element) -> None:
    """Add the categories under which the wrappers log."""
    categories = ET.SubElement(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", {"name": name, "description": description})


def add_experiment(root: ET.Element, model: Model) -> None:
    """Add the default experiment."""
    times = {"startTime": 0.0, "stopTime": model.stop_time, "stepSize": model.step}
    ET.SubElement(root, "DefaultExperiment", {name: repr(float(time)) for name, time in times.items()})


def add_annotation(parent: ET.Element, model: Model) -> None:
    """Add the vendor annotation ``bayesftc``: timing, names of the exported blocks and signals, a controller's traits."""
    blocks = {"blocks": " ".join(model.blocks)} if model.blocks else {}
    traits = {"traits": model.traits} if model.traits not in {"", "{}"} else {}
    finite = {} if model.finite else {"finite": "false"}
    element = ET.SubElement(parent, "bayesftc", {"timing": model.timing, **blocks, **traits, **finite})
    for variable in model.variables:
        if variable.origin:
            ET.SubElement(element, "Signal", {"name": variable.name, "origin": variable.origin})


def build_description(model: Model, sources: Sequence[str]) -> bytes:
    """Write ``sources/buildDescription.xml`` of FMI 3: the files to compile, without options of a compiler."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": model.name})
    files = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in sources:
        ET.SubElement(files, "SourceFile", {"name": name})
    for library in model.libraries:
        ET.SubElement(configuration, "Library", {"name": library, "external": "true"})
    return write(root)
