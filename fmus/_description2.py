"""``modelDescription.xml`` of FMI 2.0."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from bayesftc.fmus import _xml
from bayesftc.fmus.spec import Model, Variable


def _add_variable(parent: ET.Element, variable: Variable, reference: int) -> None:
    attributes = _xml.variable_attributes(variable, reference)
    if variable.calculated:
        attributes["initial"] = "calculated"
    real = {"unit": variable.unit.name} if variable.unit is not None else {}
    if not variable.calculated:
        real["start"] = repr(float(variable.starts[0]))
    ET.SubElement(ET.SubElement(parent, "ScalarVariable", attributes), "Real", real)


def model_description(model: Model, token: str, sources: Sequence[str]) -> bytes:
    """Write the model description.

    Parameters
    ----------
    model : Model
        The model, all of whose variables are numbers.
    token : str
        The GUID.
    sources : sequence of str
        The C files to compile, relative to ``sources/``.

    Returns
    -------
    bytes
        The document.
    """
    root = _xml.description_root(model, "2.0", {"guid": token})
    interface = ET.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": model.name,
            "canHandleVariableCommunicationStepSize": "false" if model.fixed_step else "true",
            "canBeInstantiatedOnlyOncePerProcess": "false",
            "canNotUseMemoryManagementFunctions": "true",
            "canGetAndSetFMUstate": "true",
            "canSerializeFMUstate": "true",
        },
    )
    files = ET.SubElement(interface, "SourceFiles")
    for name in sources:
        ET.SubElement(files, "File", {"name": name})
    _xml.add_units(root, model)
    _xml.add_log_categories(root)
    _xml.add_experiment(root, model)
    annotations = ET.SubElement(root, "VendorAnnotations")
    _xml.add_annotation(ET.SubElement(annotations, "Tool", {"name": "bayesftc"}), model)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(model.variables):
        _add_variable(variables, variable, reference)

    def add_unknowns(element: ET.Element, name: str, known: Sequence[tuple[Variable, tuple[str, ...]]]) -> None:
        unknowns = ET.SubElement(element, name)
        for variable, dependencies in known:
            # FMI 2 counts variables from one here.
            indices = sorted(model.index(name) + 1 for name in dependencies)
            attributes = {"index": str(model.index(variable.name) + 1), "dependencies": " ".join(map(str, indices))}
            ET.SubElement(unknowns, "Unknown", attributes)

    structure = ET.SubElement(root, "ModelStructure")
    if model.outputs:
        add_unknowns(structure, "Outputs", [(v, v.dependencies) for v in model.outputs])
        add_unknowns(structure, "InitialUnknowns", [(v, v.initial_dependencies) for v in model.outputs])
    return _xml.write(root)
