"""What descriptions of FMI 1.0 say otherwise than those of FMI 2, brought into the words of FMI 2."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from fmpy.model_description import ModelDescription, ModelVariable

ALIASES = ("alias", "negatedAlias")

_FLAGS = ("canHandleVariableCommunicationStepSize", "canInterpolateInputs", "canBeInstantiatedOnlyOncePerProcess")


def complete(model: ModelDescription, root: Element) -> None:
    """Complete what fmpy has read of a description of FMI 1.0, in place.

    FMI 1 knows no calculated parameters, no ``initial`` and no model structure: what has a start value may be set before
    initialization, and an output names the inputs that it depends on by itself. FMUs for co-simulation have their capabilities in
    an element of their own, and have no saved states, directional derivatives or events.

    Parameters
    ----------
    model : fmpy.model_description.ModelDescription
        What fmpy has read.
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
        found = root.find("Implementation/*/Capabilities")
        capabilities = {} if found is None else found.attrib
        for name in _FLAGS:
            setattr(model.coSimulation, name, capabilities.get(name) in {"true", "1"})
        model.coSimulation.maxOutputDerivativeOrder = int(capabilities.get("maxOutputDerivativeOrder", "0"))
        model.coSimulation.needsExecutionTool = root.find("Implementation/CoSimulation_Tool") is not None


def _complete_variable(variable: ModelVariable) -> None:
    if variable.variability == "continuous" and variable.type != "Real":
        variable.variability = "discrete"  # the default is continuous, for all types
    if variable.causality == "parameter" and variable.start is None:
        variable.causality = "calculatedParameter"
    if variable.causality in {"none", "internal"}:
        variable.causality = "local"
    settable = variable.start is not None and variable.variability != "constant"
    variable.initial = "exact" if settable else "calculated"


def aliases(root: Element) -> dict[str, str]:
    """Return which variables declare that they are another name of a variable, or the negative of one, by name."""
    found = ((v.get("name", ""), v.get("alias", "")) for v in root.findall("ModelVariables/ScalarVariable"))
    return {name: alias for name, alias in found if alias in ALIASES}
