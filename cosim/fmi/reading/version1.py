"""Model descriptions of FMI 1.0, converted to the terms of FMI 2."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from fmpy.model_description import ModelDescription, ModelVariable

ALIASES = ("alias", "negatedAlias")

_FLAGS = ("canHandleVariableCommunicationStepSize", "canInterpolateInputs", "canBeInstantiatedOnlyOncePerProcess")


def complete(model: ModelDescription, root: Element) -> None:
    """Complete fmpy's reading of a description of FMI 1.0, in place.

    FMI 1 has no calculated parameters, no ``initial`` and no model structure. Variables with a start value may be set before
    initialization, and each output lists the inputs that it depends on. Co-simulation FMUs declare their capabilities in a
    separate element. They have no saved states, directional derivatives or events.

    Parameters
    ----------
    model : fmpy.model_description.ModelDescription
        The description as fmpy has read it.
    root : Element
        The description.
    """
    from fmpy.model_description import Unknown

    for variable in model.modelVariables:
        _complete_variable(variable)
    inputs = {v.name: v for v in model.modelVariables if v.causality == "input"}
    named = {v.name: v for v in model.modelVariables if v.causality == "output"}
    for element in root.findall("ModelVariables/ScalarVariable"):
        variable, direct = named.get(element.get("name", "")), element.find("DirectDependency")
        if variable is not None and direct is not None:
            names = [(name.text or "").strip() for name in direct.findall("Name")]
            model.outputs.append(Unknown(variable=variable, dependencies=[inputs[n] for n in names if n in inputs]))
    if model.coSimulation is not None:
        element_of_capabilities = root.find("Implementation/*/Capabilities")
        capabilities = {} if element_of_capabilities is None else element_of_capabilities.attrib
        for name in _FLAGS:
            setattr(model.coSimulation, name, capabilities.get(name) in {"true", "1"})
        model.coSimulation.maxOutputDerivativeOrder = int(capabilities.get("maxOutputDerivativeOrder", "0"))
        model.coSimulation.needsExecutionTool = root.find("Implementation/CoSimulation_Tool") is not None


def _complete_variable(variable: ModelVariable) -> None:
    if variable.variability == "continuous" and variable.type != "Real":
        variable.variability = "discrete"  # FMI 1's default is continuous, for all types
    if variable.causality == "parameter" and variable.start is None:
        variable.causality = "calculatedParameter"
    if variable.causality in {"none", "internal"}:
        variable.causality = "local"
    settable = variable.start is not None and variable.variability != "constant"
    variable.initial = "exact" if settable else "calculated"


def aliases(root: Element) -> dict[str, str]:
    """Return ``alias`` or ``negatedAlias`` by name, for the variables that declare it."""
    declared = ((v.get("name", ""), v.get("alias", "")) for v in root.findall("ModelVariables/ScalarVariable"))
    return {name: alias for name, alias in declared if alias in ALIASES}
