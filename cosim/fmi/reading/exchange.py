"""What the description of an FMU says of its model exchange: states, derivatives, event indicators, capabilities."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

from bayesftc.cosim.fmi.reading.structure import check_counts

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription

    from bayesftc.cosim.fmi.reading.description import FMUVariable


@dataclass(frozen=True)
class ExchangeInfo:
    """The model exchange part of a description.

    Attributes
    ----------
    identifier : str
        Name of the binary.
    states, derivatives : tuple of FMUVariable
        The continuous states and their derivatives, in the order of the model structure; an array of FMI 3 is one of each. Of FMI
        1 none: there the binary says which they are.
    count : int
        How many numbers the continuous states are.
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
    count: int
    indicators: int
    needs_completed_step: bool
    directional: bool
    can_save: bool
    can_serialise: bool
    once: bool
    smooth: bool


def read_exchange(model: ModelDescription, root: Element, variables: tuple[FMUVariable, ...]) -> ExchangeInfo | None:
    """Return the model exchange part of a description that fmpy has parsed; None where it has none."""
    if model.modelExchange is None:
        return None
    states = model.numberOfContinuousStates if model.fmiVersion == "1.0" else 0
    check_counts({"continuous states": states, "event indicators": model.numberOfEventIndicators})
    if model.fmiVersion == "1.0":
        return _exchange1(model)
    element = root.find("ModelExchange")
    if element is None:
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
    held = tuple(named[d.derivative.name] for d in derivatives if hasattr(d.derivative, "name"))
    return ExchangeInfo(
        identifier=element.get("modelIdentifier") or "",
        states=held,
        derivatives=tuple(named[d.name] for d in derivatives),
        count=sum(prod(v.shape) for v in held),
        indicators=model.numberOfEventIndicators,
        needs_completed_step=completed,
        directional=says("providesDirectionalDerivative", "providesDirectionalDerivatives"),
        can_save=says("canGetAndSetFMUstate", "canGetAndSetFMUState"),
        can_serialise=says("canSerializeFMUstate", "canSerializeFMUState"),
        once=says("canBeInstantiatedOnlyOncePerProcess"),
        smooth=not (model.numberOfEventIndicators or completed or discrete),
    )


def _exchange1(model: ModelDescription) -> ExchangeInfo:
    """Return that of FMI 1: it declares numbers alone, always wants to be told of steps, and cannot save its state."""
    return ExchangeInfo(
        identifier=model.modelExchange.modelIdentifier or "",
        states=(),
        derivatives=(),
        count=model.numberOfContinuousStates,
        indicators=model.numberOfEventIndicators,
        needs_completed_step=True,
        directional=False,
        can_save=False,
        can_serialise=False,
        once=False,
        smooth=False,
    )
