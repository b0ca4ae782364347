"""A nonlinear model whose equations are those of an FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import Matrix, as_covariance, as_number
from bayesftc.controllers.models.fmu.check import compare, course_of, enough_parts, refuse_time
from bayesftc.controllers.models.fmu.ports import fmu_ports
from bayesftc.controllers.models.fmu.states import FMUStates, states_by_steps, states_of_equations
from bayesftc.controllers.models.linear import SignalNames
from bayesftc.controllers.models.linearization import covariance_by_inputs
from bayesftc.controllers.models.names import Names, check_by_name, names_of, sensors_of
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.prediction.prediction import Prediction
from bayesftc.cosim.types import Floats, Kernel


def model_of_fmu(
    fmu: Any,
    *,
    measured: Names,
    actuated: Names,
    states: Mapping[str, str] | Sequence[str] | None,
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]] | None,
    substeps: int | None,
    noise: Mapping[str, float | Sequence[float]] | None,
    disturbance: Matrix | None,
    sensors: int | Sequence[int] | None,
    sensor_std: float | Sequence[float],
) -> dict[str, Any]:
    """Return the arguments of the model; see `NonlinearModel.from_fmu`."""
    check_by_name(noise=noise, at=at)
    if substeps is not None:
        as_number("The model has substeps", substeps, least=1, most=10_000, whole=True)
    driven, seen = names_of(actuated, "actuated"), names_of(measured, "measured")
    fmu = _usable(fmu)
    noisy = [name for name in noise or {} if name not in driven]
    fmu, step, u, (columns, inputs), (rows, _), _ = fmu_ports(fmu, [*driven, *noisy], seen, dt, at or {})
    p = _count(fmu, driven)
    if fmu.kind == "model exchange":
        if states is not None:
            raise ModelError(
                f"The FMU {fmu.path} is for model exchange, so its states are known; leave states= out, or export it for "
                "co-simulation only."
            )
        of = states_of_equations(fmu, step)
    else:
        if substeps is not None:
            raise ModelError("substeps= is for FMUs for model exchange; in co-simulation the FMU integrates itself.")
        of = states_by_steps(fmu, states, step)
    order, variances = sensors_of(rows, sensors, sensor_std)
    prediction = _prediction(of, p, order, step, u)
    course = course_of(prediction, of)
    if fmu.kind == "model exchange":
        refuse_time(of, course, step)
    prediction = enough_parts(prediction, course) if substeps is None else replace(prediction, parts=substeps)
    compare(prediction, course)
    n = len(of.names)
    wide = replace(prediction, controls=len(u), scales=(*of.scales, *_sizes(u)))
    F, B = np.empty((n, n)), np.empty((n, len(u)))
    with wide.briefly("move_slopes") as slopes:
        slopes(course.states[0], u, F, B)
    Q = covariance_by_inputs(B[:, columns], u[columns], inputs, range(p), noise)
    loads = 0
    if disturbance is not None:
        loads = p
        Q = np.block(
            [[Q, np.zeros((n, p))], [np.zeros((p, n)), as_covariance("The disturbance's covariance", disturbance, p)]]
        )
        prediction = replace(prediction, loads=loads)
    known = [of.names.index(name) if name in of.names else -1 for name in of.outputs]
    f, f_jacobian = moving(prediction)
    g, g_jacobian = reading(prediction, [known[i] for i in order])
    return {
        "f": f,
        "g": g,
        "states": n + loads,
        "controls": p,
        "sensors": len(order),
        "process_covariance": Q,
        "sensor_covariance": variances,
        "dt": step,
        "f_jacobian": f_jacobian,
        "g_jacobian": g_jacobian,
        "disturbances": loads,
        "names": SignalNames(inputs[:p], tuple(of.outputs[i] for i in order), of.names),
        "start": (*course.states[0].tolist(), *[0.0] * loads),
    }


def moving(prediction: Prediction) -> tuple[Kernel, Kernel]:
    """Return the step functions of the next state and of its derivatives."""
    move, slopes = prediction.function("move"), prediction.function("move_slopes")

    def f(x, u, x_next):
        move(x, u, x_next)

    def f_jacobian(x, u, F, B):
        slopes(x, u, F, B)

    return f, f_jacobian


def reading(prediction: Prediction, places: Sequence[int]) -> tuple[Kernel, Kernel]:
    """Return the step functions of the readings and of their derivatives; `places` has the state that a sensor shows, or -1."""
    if all(place >= 0 for place in places):
        shown, n = tuple(places), len(prediction.states) + prediction.loads

        def g_of_states(x, y):
            for i in range(len(shown)):
                y[i] = x[shown[i]]

        def g_of_states_jacobian(x, C):
            for i in range(len(shown)):
                for j in range(n):
                    C[i, j] = 0.0
                C[i, shown[i]] = 1.0

        return g_of_states, g_of_states_jacobian
    read, slopes = prediction.function("read"), prediction.function("read_slopes")

    def g(x, y):
        read(x, y)

    def g_jacobian(x, C):
        slopes(x, C)

    return g, g_jacobian


def _usable(fmu: Any) -> FMU:
    """Return the block, for model exchange if the file supports it."""
    block: FMU = fmu if isinstance(fmu, FMU) else FMU(fmu) if isinstance(fmu, str | PathLike) else _no_fmu(fmu)
    if block.isolate:
        raise ModelError(
            f"The FMU {block.path} is isolated, but a model calls its FMU thousands of times a second, in this process. Give the "
            "model a block without isolate=True; the plant's may stay isolated."
        )
    if block.description.fmi_major == 1:
        raise ModelError(
            f"The FMU {block.path} is of FMI 1.0, where a model cannot set the state. Export it as FMI 2.0 or 3.0, or use "
            "LinearModel.from_fmu."
        )
    if block.description.exchange is not None:
        return replace(block, kind="model exchange", timing="plant", rtol=None)
    return block


def _no_fmu(fmu: object) -> FMU:
    raise ModelError(f"NonlinearModel.from_fmu needs an FMU block or the path of an .fmu file, not {fmu!r}.")


def _count(fmu: FMU, driven: Sequence[str]) -> int:
    """Return the number of controls, the first inputs; refuse elements of arrays, which cannot be set alone."""
    ports = {port.name: port for port in fmu._sides[0]}
    for name in driven:
        if name not in ports:
            raise ModelError(f"{name!r} is one element of an array; name the whole array in actuated=.")
    return sum(ports[name].size for name in driven)


def _sizes(u: Floats) -> tuple[float, ...]:
    return tuple(np.maximum(np.abs(u), 1.0).tolist())


def _prediction(of: FMUStates, controls: int, order: Sequence[int], step: Fraction, u: Floats) -> Prediction:
    return Prediction(
        of.fmu,
        of.names,
        of.starts,
        controls,
        0,
        tuple(of.places[i] for i in order),
        step,
        1,
        tuple(u.tolist()),
        (*of.scales, *_sizes(u[:controls])),
    )


__all__ = ["model_of_fmu"]
