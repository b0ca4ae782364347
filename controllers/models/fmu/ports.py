"""The inputs and outputs of an FMU that a model uses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from bayesftc.controllers.models.names import chosen, operating
from bayesftc.cosim.base.timebase import rational_step
from bayesftc.cosim.errors import ModelError, StepSizeError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.reading.ports import WATCHED
from bayesftc.cosim.ports import labels
from bayesftc.cosim.types import Floats


class FMUPorts(NamedTuple):
    """An FMU with the requested variables as ports.

    Its sample time; the values of all inputs at the operating point; indices and names of the elements of inputs and of outputs;
    the names of the elements of all inputs.
    """

    fmu: FMU
    step: Fraction
    u: Floats
    driven: tuple[list[int], tuple[str, ...]]
    seen: tuple[list[int], tuple[str, ...]]
    inputs: list[str]


def fmu_ports(
    fmu: FMU,
    inputs: Sequence[str],
    outputs: Sequence[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]],
) -> FMUPorts:
    """Choose the inputs and outputs of an FMU by name, and its sample time.

    Raises
    ------
    ModelError
        If the FMU has no input or no output, or one is named twice.
    UnknownNameError
        If it has no variable of a name.
    """
    _refuse_without_ports(fmu, outputs)
    fmu = replace(fmu, inputs=_variables(fmu, [*inputs, *at]), outputs=_variables(fmu, outputs))
    into, out = (
        [name for port in side or () for name in labels(port.name, port.shape)]  # type: ignore[union-attr]
        for side in (fmu.inputs, fmu.outputs)
    )
    start = [np.broadcast_to(port.default or 0.0, port.shape).ravel() for port in fmu.inputs or ()]  # type: ignore[union-attr, arg-type]
    u = operating(into, np.concatenate(start), at)
    driven, seen = chosen(inputs, into, "input"), chosen(outputs, out, "output")
    return FMUPorts(fmu, _fmu_step(fmu, dt), u, driven, seen, into)


def _refuse_without_ports(fmu: FMU, measured: Sequence[str]) -> None:
    """Refuse an FMU without inputs or without outputs."""
    variables = fmu.description.variables
    if not any(v.causality == "input" or v.variability == "tunable" for v in variables):
        raise ModelError(
            f"The FMU {fmu.default_name!r} has no input that could control it. Export it with an input. Without control, a "
            "StateEstimator can monitor its sensors, and `bayesftc monitor` their recording."
        )
    local = {v.name for v in variables if v.causality == "local"}
    seen = {v.name for v in variables if v.causality in ("output", *WATCHED)}
    if not any(v.causality == "output" for v in variables) and not seen.intersection(_variables(fmu, measured)):
        raise ModelError(
            f"The FMU {fmu.default_name!r} has no output that a sensor could measure. Export it with an output, or measure "
            f"one of its local variables by name{': ' + ', '.join(sorted(local)[:8]) if local else ' (it has none either)'}."
        )


def _variables(fmu: FMU, names: Sequence[str]) -> list[str]:
    """Return the FMU's variables for names of variables or of elements (``y[1]``), each once."""
    variables = {variable.name for variable in fmu.description.variables}
    return list(dict.fromkeys(name if name in variables else re.sub(r"\[[\d,]+\]$", "", name) for name in names))


def _fmu_step(fmu: FMU, dt: float | str | Fraction | None) -> Fraction:
    if dt is None:
        default_step = fmu.description.default_experiment.get("stepSize")
        if default_step is None:
            raise StepSizeError(
                "The FMU has no default step size. Give the controller's sample time in seconds: dt=..., or dt = ... in "
                "[simulation] of a scenario file."
            )
        dt = default_step
    return rational_step(dt)
