"""``modelDescription.xml`` of FMI 3.0."""

from xml.etree import ElementTree as ET

from bayesftc.fmus import _xml
from bayesftc.fmus.spec import Model, Variable


def _add_variable(parent: ET.Element, variable: Variable, reference: int) -> None:
    attributes = _xml.variable_attributes(variable, reference)
    if variable.unit is not None:
        attributes["unit"] = variable.unit.name
    if variable.calculated:
        attributes["initial"] = "calculated"
    else:
        attributes["start"] = " ".join(repr(float(start)) for start in variable.starts)
    element = ET.SubElement(parent, "Float64", attributes)
    for length in variable.shape:
        ET.SubElement(element, "Dimension", {"start": str(length)})


def model_description(model: Model, token: str) -> bytes:
    """Write the model description.

    Parameters
    ----------
    model : Model
        The model.
    token : str
        The instantiation token.

    Returns
    -------
    bytes
        The document.
    """
    root = _xml.description_root(model, "3.0", {"instantiationToken": token})
    interface = {
        "modelIdentifier": model.name,
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "canHandleVariableCommunicationStepSize": "false" if model.fixed_step else "true",
        "hasEventMode": "false",
    }
    if model.fixed_step:
        interface["fixedInternalStepSize"] = repr(float(model.step))
    ET.SubElement(root, "CoSimulation", interface)
    _xml.add_units(root, model)
    _xml.add_log_categories(root)
    _xml.add_experiment(root, model)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(model.variables):
        _add_variable(variables, variable, reference)
    ET.SubElement(
        variables,
        "Float64",
        {
            "name": "time",
            "valueReference": str(len(model.variables)),
            "description": "Time",
            "causality": "independent",
            "variability": "continuous",
            "unit": "s",
        },
    )

    structure = ET.SubElement(root, "ModelStructure")
    for element, dependencies in (
        ("Output", [v.dependencies for v in model.outputs]),
        ("InitialUnknown", [v.initial_dependencies for v in model.outputs]),
    ):
        for variable, names in zip(model.outputs, dependencies, strict=True):
            references = sorted(model.index(name) for name in names)
            attributes = {
                "valueReference": str(model.index(variable.name)),
                "dependencies": " ".join(map(str, references)),
            }
            ET.SubElement(structure, element, attributes)
    annotation = ET.SubElement(ET.SubElement(root, "Annotations"), "Annotation", {"type": "bayesftc"})
    _xml.add_annotation(annotation, model)
    return _xml.write(root)
