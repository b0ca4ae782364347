"""Loads on the controls, and errors of sensors that are correlated in time: additional states, estimated with the plant's.

All states have one order: plant, past signals, loads, errors of sensors, the constant. The order in which a user applies these
methods therefore does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.models.checks import Matrix, as_covariance, as_number, as_vector
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.control.balance import balanced
from bayesftc.cosim.elementary import exponential
from bayesftc.cosim.errors import ModelError, brief

if TYPE_CHECKING:
    from fractions import Fraction

    from numpy.typing import NDArray

    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

ROUNDING = 1e-13
"""Effect on a state, in balanced units, up to which it is one of rounding."""

SHORTEST_LAG = 0.9
"""Decay in a sample from which on a state counts as a lag: about 10 samples. A shorter one hardly differs from white noise."""


def with_loads(model: LinearModel, covariance: Matrix, controls: Sequence[int] | None = None) -> LinearModel:
    """Return the model with an unknown load on each control, or on some; see `LinearModel.with_disturbance`."""
    if has_loads(model):
        raise ModelError(
            "The model already estimates a disturbance of its controls. Apply with_disturbance() once, to the model without one."
        )
    chosen = list(range(model.controls)) if controls is None else list(controls)
    p, m = len(chosen), model.sensors
    walk = as_covariance("The disturbance's covariance", covariance, p)
    first = model.states - model.disturbances
    return _with_states(model, first, np.eye(p), model.effects[:, chosen], np.zeros((m, p)), walk)


def lag_of(name: str, load: Sequence[float], step: Fraction) -> tuple[float, float]:
    """Return what remains of a load after a sample, and the variance of its change, from (standard deviation, time constant).

    Raises
    ------
    ModelError
        If these are not two positive numbers, or the time constant is so short that the load is white noise.
    """
    if np.shape(load) != (2,):
        raise ModelError(
            f"loads has {name} = {brief(load)}; give two numbers, its standard deviation and its time constant in seconds: "
            f"loads={{'{name}': (0.02, 5.0)}}."
        )
    std = as_number(f"The load {name} has the standard deviation", load[0], above=0)
    time = as_number(f"The load {name} has the time constant", load[1], above=0)
    if time < float(step):
        raise ModelError(
            f"The load {name} has the time constant {time:g} s, but the sample time is {show(step)} s. What changes faster than "
            f"the samples is white noise: noise={{'{name}': {std:g}}}."
        )
    keep = exponential(-float(step) / time)
    return keep, std**2 * (1.0 - keep**2)


def loads_of(model: LinearModel) -> list[int]:
    """Return the states of the disturbances that move the plant: loads do, errors of sensors and the constant do not count."""
    first = model.states - model.disturbances
    moving = model.matrix("A")[:first, first : model.states - model.constant].any(axis=0)
    return [first + int(j) for j in np.flatnonzero(moving)]


def unmoved(A: Floats, B: Floats) -> NDArray[np.bool_]:
    """Return whether neither another state nor a control moves each state, up to rounding."""
    same, units = balanced(A)
    others = np.abs(same - np.diag(np.diag(same)))
    effects = np.abs(B) / units[:, None]
    moved = (others > ROUNDING).any(axis=1) | (effects > ROUNDING * effects.max(axis=0)).any(axis=1)
    return np.asarray(~moved)


def lagged_loads(model: LinearModel, measured: bool = False) -> list[int]:
    """Return the states of the plant that are loads: lagged noise that nothing else moves; those with sensors on request."""
    plant = model.plant_states
    A, Q = model.matrix("A")[:plant, :plant], np.diag(model.matrix("process_covariance"))[:plant]
    lags = (np.diag(A) > SHORTEST_LAG) & (np.diag(A) <= 1.0)
    moving = (A - np.diag(np.diag(A))).any(axis=0)
    found = lags & (Q > 0.0) & moving & unmoved(A, model.effects[:plant])
    return [int(i) for i in np.flatnonzero(found if measured else found & ~model.quantities[:, :plant].any(axis=0))]


def has_loads(model: LinearModel) -> bool:
    """Return whether some disturbances move the plant."""
    return bool(loads_of(model))


def with_sensor_errors(
    model: LinearModel,
    std: float | Sequence[float],
    time_constant: float | Sequence[float],
    sensors: Sequence[int] | None,
    common: bool,
) -> LinearModel:
    """Return the model with the errors as further states; see `LinearModel.with_sensor_errors`."""
    chosen = _chosen(model, sensors)
    deviations = as_vector("The sensor errors' std", std, len(chosen))
    if common and np.ndim(time_constant):
        raise ModelError(f"time_constant is {time_constant!r}; a common error has one time_constant, a number.")
    times = as_vector("The sensor errors' time_constant", time_constant, len(chosen))
    for name, values in (("std", deviations), ("time_constant", times)):
        for value in values:
            as_number(f"A sensor error has {name}", float(value), above=0)
    reads = np.zeros((model.sensors, len(chosen)))
    reads[chosen, range(len(chosen))] = 1.0
    if common:
        reads = reads @ (deviations / deviations[0])[:, None]
        deviations, times = deviations[:1], times[:1]
    decay = np.array([exponential(-float(model.step) / time) for time in times])
    last = model.states - model.constant
    loose = np.zeros((model.states, len(decay)))
    return _with_states(model, last, np.diag(decay), loose, reads, np.diag(deviations**2 * (1 - decay**2)))


def error_variances(model: LinearModel) -> Floats:
    """Return the variance of each moving state in the long run if it is an error of a sensor, else 0."""
    A, Q = (np.diag(model.moving.matrix(name)) for name in ("A", "process_covariance"))
    read = model.moving.matrix("C").any(axis=0) & (np.arange(len(A)) >= model.states - model.disturbances)
    errors = read & (np.abs(A) < 1.0)
    return np.where(errors, Q / np.where(errors, 1.0 - A**2, 1.0), 0.0)


def _chosen(model: LinearModel, sensors: Sequence[int] | None) -> list[int]:
    chosen = list(range(model.sensors)) if sensors is None else list(sensors)
    for sensor in chosen:
        as_number("A sensor error has sensor", sensor, least=0, below=model.sensors, whole=True)
    if not chosen or len(set(chosen)) < len(chosen):
        raise ModelError(f"Sensor errors have sensors={sensors!r}; name each sensor once, at least one.")
    return chosen


def _with_states(model: LinearModel, at: int, A: Floats, effect: Floats, reads: Floats, Q: Floats) -> LinearModel:
    """Return the model with k further disturbances before state `at`: their transition, effect on the states, reading, noise."""
    n, k = model.states, len(A)
    given, new = [*range(at), *range(at + k, n + k)], range(at, at + k)
    whole_A, whole_Q = np.zeros((n + k, n + k)), np.zeros((n + k, n + k))
    whole_A[np.ix_(given, given)], whole_A[np.ix_(given, new)], whole_A[np.ix_(new, new)] = model.matrix("A"), effect, A
    whole_Q[np.ix_(given, given)], whole_Q[np.ix_(new, new)] = model.matrix("process_covariance"), Q
    return replace(
        model,
        A=whole_A,
        B=np.insert(model.matrix("B"), [at] * k, 0.0, axis=0),
        C=np.insert(model.matrix("C"), [at] * k, reads, axis=1),
        process_covariance=whole_Q,
        disturbances=model.disturbances + k,
    )
