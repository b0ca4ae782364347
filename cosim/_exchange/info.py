"""What the description of an FMU says of its model exchange: states, derivatives, event indicators, capabilities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription

    from bayesftc.cosim._fmi.description import FMUVariable


@dataclass(frozen=True)
class ExchangeInfo:
    """The model exchange part of a description.

    Attributes
    ----------
    identifier : str
        Name of the binary.
    states, derivatives : tuple of FMUVariable
        The continuous states and their derivatives, in the order of the model structure; an array of FMI 3 is one of each.
    indicators : int
        How many event indicators it declares.
    needs_completed_step : bool
        Whether it wants to be told of every completed step of the integrator.
    directional : bool
        Whether it gives directional derivatives.
    can_save, can_serialise : bool
        Whether its state can be read and set, and turned into bytes.
    once : bool
        Whether a process can have one instance only.
    smooth : bool
        Whether time, continuous states and inputs are all that it remembers: it declares no event indicators, no discrete
        variables, and no interest in completed steps.
    """

    identifier: str
    states: tuple[FMUVariable, ...]
    derivatives: tuple[FMUVariable, ...]
    indicators: int
    needs_completed_step: bool
    directional: bool
    can_save: bool
    can_serialise: bool
    once: bool
    smooth: bool


def read_exchange(model: ModelDescription, root: Element, variables: tuple[FMUVariable, ...]) -> ExchangeInfo | None:
    """Return the model exchange part of a description that fmpy has parsed; None where it has none."""
    element = root.find("ModelExchange")
    if element is None or model.modelExchange is None:
        return None
    named = {v.name: v for v in variables}
    derivatives = [u.variable for u in model.derivatives if u.variable is not None]

    def says(*attributes: str) -> bool:  # both versions' spellings; fmpy keeps only some of them
        return any(element.get(name) in {"true", "1"} for name in attributes)

    if root.get("fmiVersion", "").startswith("2"):
        completed = not says("completedIntegratorStepNotNeeded")
    else:
        completed = says("needsCompletedIntegratorStep")
    discrete = any(v.variability == "discrete" or (v.variability == "continuous" and not v.is_float) for v in variables)
    return ExchangeInfo(
        identifier=element.get("modelIdentifier") or "",
        states=tuple(named[d.derivative.name] for d in derivatives if hasattr(d.derivative, "name")),
        derivatives=tuple(named[d.name] for d in derivatives),
        indicators=model.numberOfEventIndicators,
        needs_completed_step=completed,
        directional=says("providesDirectionalDerivative", "providesDirectionalDerivatives"),
        can_save=says("canGetAndSetFMUstate", "canGetAndSetFMUState"),
        can_serialise=says("canSerializeFMUstate", "canSerializeFMUState"),
        once=says("canBeInstantiatedOnlyOncePerProcess"),
        smooth=not (model.numberOfEventIndicators or completed or discrete),
    )
