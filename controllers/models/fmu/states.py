"""The states of an FMU that a model can set: those of model exchange, or start values of co-simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.ports import labels

_REMEDY = "Use LinearModel.from_fmu, or write the equations as a NonlinearModel."


@dataclass(frozen=True)
class FMUStates:
    """An FMU with the states of a model.

    Attributes
    ----------
    fmu : FMU
        The block; for co-simulation its first outputs are the states.
    names : tuple of str
        Names of the states, element by element.
    starts : tuple of str
        For co-simulation: the variables that set them.
    outputs : tuple of str
        Names of the measured outputs, element by element.
    places : tuple of int
        Their numbers among the outputs that an instance has.
    scales : tuple of float
        The states' orders of magnitude.
    """

    fmu: FMU
    names: tuple[str, ...]
    starts: tuple[str, ...]
    outputs: tuple[str, ...]
    places: tuple[int, ...]
    scales: tuple[float, ...]


def states_of_equations(fmu: FMU, step: Fraction) -> FMUStates:
    """Return the states of a model exchange FMU.

    Raises
    ------
    ModelError
        If it has events, discrete states, inputs that are not continuous, no states, or outputs that depend on inputs.
    """
    description, info = fmu.description, fmu.description.exchange
    assert info is not None
    title = f"The FMU {fmu.default_name!r}"
    if info.indicators:
        raise ModelError(
            f"{title} has {info.indicators} event indicators: it switches or jumps, which a NonlinearModel does not describe. "
            f"{_REMEDY}"
        )
    discrete = [v.name for v in description.variables if v.variability == "discrete" and v.causality != "input"]
    if discrete:
        raise ModelError(
            f"{title} has the discrete variable {discrete[0]!r}, which changes at events; a NonlinearModel describes continuous "
            f"states only. {_REMEDY}"
        )
    driven = {port.name for port in fmu._sides[0]}
    for v in description.variables:
        if v.name in driven and (v.variability != "continuous" or not v.is_float):
            raise ModelError(
                f"{title} changes the input {v.name!r} at events only (it is {v.variability}, of type {v.type}). Use a "
                "continuous input."
            )
    with ModelEquations(fmu) as model:
        if not len(model.x0):
            raise ModelError(f"{title} has no state, so there are no dynamics to predict.")
        if model.next_event < np.inf:
            raise ModelError(
                f"{title} has an event at t = {model.next_event:g} s: it depends on time, which a NonlinearModel does not. "
                f"{_REMEDY}"
            )
        D = model.jacobians(model.x0, model.u0).D
        if np.any(np.abs(D) > 1e-12):
            i, j = np.argwhere(np.abs(D) > 1e-12)[0]
            raise ModelError(
                f"The output {model.output_names[i]} of the FMU {fmu.default_name!r} depends directly on the input "
                f"{model.input_names[j]}, which the model y = g(x) cannot represent. Measure another output, or delay the input."
            )
        scales = np.maximum(np.abs(model.x0), model.nominals)
        places = tuple(range(len(model.output_names)))
        return FMUStates(fmu, model.state_names, (), model.output_names, places, tuple(scales.tolist()))


def states_by_steps(fmu: FMU, states: Mapping[str, str] | Sequence[str] | None, step: Fraction) -> FMUStates:
    """Return the states of a co-simulation FMU, and the variables that set them before initialization.

    Raises
    ------
    ModelError
        If the FMU cannot save its state, has events, or a state cannot be set.
    UnknownNameError
        If it has no variable of a name.
    """
    description = fmu.description
    title = f"The FMU {fmu.default_name!r}"
    if not description.capabilities.get("canGetAndSetFMUstate"):
        raise ModelError(
            f"{title} is for co-simulation and cannot save its state (canGetAndSetFMUstate), so a model cannot begin at a "
            "state. Export it for model exchange, or with that capability, or use LinearModel.from_fmu."
        )
    if description.capabilities.get("hasEventMode") and description.fmi_major == 3:
        raise ModelError(f"{title} has events (hasEventMode), which a NonlinearModel does not describe. {_REMEDY}")
    pairs = _pairs(fmu, states)
    variables = {v.name: v for v in description.variables}
    for name, start in pairs.items():
        for role in (name, start):
            if role not in variables:
                raise UnknownNameError(f"{title} has no variable {role!r}; {did_you_mean(role, variables)}")
            if variables[role].shape or variables[role].type not in {"Real", "Float64"}:
                raise ModelError(
                    f"{role!r} of {title[0].lower()}{title[1:]} is no single real number; name such variables in states=."
                )
        if not variables[start].settable:
            raise ModelError(
                f"{start!r} of {title[0].lower()}{title[1:]} cannot be set before initialization. Name a parameter that sets it, "
                f"as states={{{name!r}: ...}}, or export the FMU for model exchange."
            )
    with_states = replace(fmu, outputs=[*pairs, *(port.name for port in fmu._sides[1] if port.name not in pairs)])
    names, shown = _elements(fmu), _elements(with_states)
    places, scales = tuple(shown.index(name) for name in names), (1.0,) * len(pairs)
    return FMUStates(with_states, tuple(pairs), tuple(pairs.values()), names, places, scales)


def _elements(fmu: FMU) -> tuple[str, ...]:
    """Return the names of the elements of the outputs."""
    return tuple(name for port in fmu._sides[1] for name in labels(port.name, port.shape))


def _pairs(fmu: FMU, states: Mapping[str, str] | Sequence[str] | None) -> dict[str, str]:
    """Return for each state the variable that sets it."""
    if isinstance(states, Mapping):
        pairs = dict(states)
    elif states is not None:
        names = [states] if isinstance(states, str) else list(states)
        pairs = {name: name for name in names}
    else:
        settable = {v.name: v for v in fmu.description.variables if v.settable and v.type in {"Real", "Float64"}}
        seen = [v for v in fmu.description.variables if v.causality in {"output", "local"} and not v.shape]
        pairs = {v.name: f"{v.name}_0" for v in seen if f"{v.name}_0" in settable}
        pairs = pairs or {v.name: v.name for v in seen if v.name in settable}
    if not pairs or not all(isinstance(name, str) for pair in pairs.items() for name in pair):
        raise ModelError(
            f"The states of the FMU {fmu.default_name!r} are not known. Give its variables that are states, each with the one "
            "that sets it before initialization: states={'angle': 'angle_0', ...}."
        )
    return pairs
