"""The model exchange part of an FMU's description: states, derivatives, event indicators, capabilities."""

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
        The continuous states and their derivatives, in the order of the model structure. An array of FMI 3 is one of each.
        Empty for FMI 1, where only the binary gives them.
    count : int
        Number of elements of the continuous states.
    indicators : int
        Number of declared event indicators.
    needs_completed_step : bool
        Whether completedIntegratorStep must be called after every step of the integrator.
    directional : bool
        Whether it provides directional derivatives.
    can_save, can_serialise : bool
        Whether its state can be saved and restored, and turned into bytes.
    once : bool
        Whether only one instance per process is possible.
    smooth : bool
        Whether time, continuous states and inputs are its whole state: it has no event indicators and no discrete variables,
        and does not need completed steps.
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
    """Return the model exchange part of a description that fmpy has parsed, or None."""
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

    def has_flag(*attributes: str) -> bool:  # both versions' spellings; fmpy keeps only some of them
        return any(element.get(name) in {"true", "1"} for name in attributes)

    if root.get("fmiVersion", "").startswith("2"):
        needs_completed_step = not has_flag("completedIntegratorStepNotNeeded")
    else:
        needs_completed_step = has_flag("needsCompletedIntegratorStep")
    discrete = any(v.variability == "discrete" or (v.variability == "continuous" and not v.is_float) for v in variables)
    state_variables = tuple(named[d.derivative.name] for d in derivatives if hasattr(d.derivative, "name"))
    return ExchangeInfo(
        identifier=element.get("modelIdentifier") or "",
        states=state_variables,
        derivatives=tuple(named[d.name] for d in derivatives),
        count=sum(prod(v.shape) for v in state_variables),
        indicators=model.numberOfEventIndicators,
        needs_completed_step=needs_completed_step,
        directional=has_flag("providesDirectionalDerivative", "providesDirectionalDerivatives"),
        can_save=has_flag("canGetAndSetFMUstate", "canGetAndSetFMUState"),
        can_serialise=has_flag("canSerializeFMUstate", "canSerializeFMUState"),
        once=has_flag("canBeInstantiatedOnlyOncePerProcess"),
        smooth=not (model.numberOfEventIndicators or needs_completed_step or discrete),
    )


def _exchange1(model: ModelDescription) -> ExchangeInfo:
    """Return the part for FMI 1, which declares counts only, always needs completed steps, and cannot save its state."""
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
