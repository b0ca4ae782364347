"""All modalities of a controller together: readings, derivatives, nominal noise and weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.controllers.linalg.dense import apply
from bayesftc.controllers.models.modality import Modality
from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class Measured:
    """The evaluation of modalities in a step function with the arrays ``mean``, ``expected`` and ``G``.

    Attributes
    ----------
    functions : mapping of str to function
        The step functions to call.
    calls : mapping of str to str
        The statements that write ``expected`` (``measure``) and ``G`` (``differentiate``).
    scratch, parameters : mapping of str to array
        Scratch space, and the matrices of linear modalities.
    """

    functions: Mapping[str, Any]
    calls: Mapping[str, str]
    scratch: Mapping[str, Floats]
    parameters: Mapping[str, Floats]


def measured(modalities: Sequence[Modality], states: int) -> Measured:
    """Return the evaluation of the modalities, with their samples one after the other."""
    functions: dict[str, Any] = {}
    measure, differentiate, first = [], [], 0
    scratch, parameters = {}, {}
    for i, modality in enumerate(modalities):
        derivative, name = modality.derivative(states), f"modality{i}"
        scratch[f"{name}_y"] = np.zeros(modality.samples)
        if derivative is None:
            parameters[f"{name}_G"] = modality.jacobian_at(np.zeros(states))
            functions["apply"] = apply
            measure.append(f"apply({name}_G, mean, {name}_y)")
        else:
            functions[f"{name}_function"], functions[f"{name}_derivative"] = modality.function, derivative
            scratch[f"{name}_G"] = np.zeros((modality.samples, states))
            measure.append(f"{name}_function(mean, {name}_y)")
            differentiate.append(f"{name}_derivative(mean, {name}_G)")
        measure.append(f"place({name}_y, {first}, expected)")
        differentiate.append(f"place_rows({name}_G, {first}, G)")
        first += modality.samples
    calls = {"measure": "\n".join(measure), "differentiate": "\n".join(differentiate)}
    return Measured(functions, calls, scratch, parameters)


def jacobian_of(modalities: Sequence[Modality], mean: Floats) -> Floats:
    """Return the derivatives of all samples at a state (samples x states)."""
    return np.vstack([modality.jacobian_at(mean) for modality in modalities])


def nominal_covariance(modalities: Sequence[Modality]) -> Floats:
    """Return the nominal covariance of all samples, block by block."""
    samples = sum(modality.samples for modality in modalities)
    nominal, first = np.zeros((samples, samples)), 0
    for modality in modalities:
        last = first + modality.samples
        nominal[first:last, first:last] = np.asarray(modality.covariance)
        first = last
    return nominal


def weights_of(modalities: Sequence[Modality]) -> Floats:
    """Return `Modality.precision` for all samples."""
    return np.concatenate([np.asarray(modality.precision) for modality in modalities])
