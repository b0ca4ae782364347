"""Compare the steps of a model from an FMU with the FMU's own steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from bayesftc.controllers.models.fmu.states import FMUStates
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.errors import FMUError, ModelError
from bayesftc.cosim.fmi.equations import ModelEquations
from bayesftc.cosim.fmi.prediction.prediction import Prediction
from bayesftc.cosim.types import Floats

_STEPS = 10
_PRECISE = 1e-8
"""Largest difference between the results of n and 2n substeps, in units of the states' sizes."""

_ALIKE = 1e-5
"""Largest difference between a step of the model and of the FMU, in units of the states' sizes."""

_MOST_PARTS = 256

_TIMES = (0.73, 1.3, 13.7, 1009.3)
"""Seconds at which equations must be those at t = 0; no whole multiples of a usual period."""

_SAME = 1e-8
"""Largest such difference: of a derivative times dt in units of the state's size, of an output relative to its size."""


@dataclass(frozen=True)
class Course:
    """States and inputs of the FMU's own first steps, and the states' sizes."""

    states: Floats
    inputs: Floats
    sizes: Floats


def course_of(prediction: Prediction, of: FMUStates) -> Course:
    """Run the FMU itself for some steps with moving inputs."""
    n, held = len(of.names), np.array(prediction.held)
    fmu = of.fmu if of.starts else replace(of.fmu, outputs=_variables(of), rtol=1e-9)
    moves = np.random.default_rng(0).normal(size=(_STEPS, len(held)))
    inputs = held + 0.1 * np.maximum(np.abs(held), 1.0) * moves
    shown = np.zeros(sum(port.size for port in fmu._sides[1]))
    states = np.empty((_STEPS + 1, n))
    instance = fmu.instantiate(prediction.step, fmu.default_name)
    try:
        for k in range(_STEPS + 1):
            t = float(k * prediction.step)
            status = instance.output(held, shown, t)
            states[k] = shown[:n]
            if not status and k < _STEPS:
                status = instance.update(inputs[k].copy(), shown, t)
            if status:
                raise FMUError(f"The FMU {fmu.path} failed at t = {t:g} s. {instance.explain(status)}")
    finally:
        instance.close()
    sizes = np.maximum(np.array(of.scales), np.abs(states).max(axis=0))
    return Course(states, inputs, sizes)


def enough_parts(prediction: Prediction, course: Course) -> Prediction:
    """Return the prediction with as many substeps as its precision needs.

    Raises
    ------
    ModelError
        If more than `_MOST_PARTS` are needed.
    """
    if prediction.starts:
        return prediction
    before = _followed(prediction, course)
    while prediction.parts < _MOST_PARTS:
        finer = replace(prediction, parts=2 * prediction.parts)
        after = _followed(finer, course)
        if (np.abs(after - before) / course.sizes).max() <= _PRECISE:  # False for NaN
            return prediction
        prediction, before = finer, after
    raise ModelError(
        f"The FMU {prediction.fmu.default_name!r} is stiff: {_MOST_PARTS} Runge-Kutta steps in {show(prediction.step)} s do not "
        "follow it. Give a shorter dt, or the number of substeps."
    )


def compare(prediction: Prediction, course: Course) -> None:
    """Refuse a model whose steps differ from those of the FMU.

    Raises
    ------
    ModelError
        With the state that differs most.
    """
    after = _followed(prediction, course)
    error = np.abs(after - course.states[1:]) / course.sizes
    if (error <= _ALIKE).all():
        return
    k, i = np.unravel_index(np.argmax(np.where(np.isnan(error), np.inf, error)), error.shape)
    remedy = (
        "States may be missing in states=, or it depends on time"
        if prediction.starts
        else "It depends on time, has hidden states, or needs more substeps"
    )
    raise ModelError(
        f"A step of the FMU {prediction.fmu.default_name!r} from its states is not the FMU's own step: after step {k + 1}, "
        f"{prediction.states[i]} is {after[k, i]:.6g} and not {course.states[k + 1, i]:.6g}. {remedy}."
    )


def refuse_time(of: FMUStates, course: Course, step: Fraction) -> None:
    """Refuse an FMU for model exchange whose derivatives or outputs change with time at the same states and inputs.

    Raises
    ------
    ModelError
        With the derivative or output that changes.
    """
    points = ((course.states[0], course.inputs[0]), (course.states[-1], course.inputs[-1]))
    with ModelEquations(of.fmu) as model:

        def values(t: float) -> Floats:
            return np.array([np.concatenate([model.derivatives(x, u, t), model.outputs(x, u, t)]) for x, u in points])

        first = values(0.0)
        outputs = np.maximum(np.abs(first[:, len(course.sizes) :]).max(axis=0), 1.0)
        most = _SAME * np.concatenate([course.sizes / float(step), outputs])
        names = [*(f"the derivative of {name}" for name in model.state_names), *model.output_names]
        for t in _TIMES:
            now = values(t)
            changed = np.argwhere(~(np.abs(now - first) <= most))
            if len(changed):
                k, i = changed[0]
                raise ModelError(
                    f"The FMU {of.fmu.default_name!r} depends on time, which a NonlinearModel does not: at the same states and "
                    f"inputs, {names[i]} is {first[k, i]:.6g} at t = 0 s and {now[k, i]:.6g} at t = {t:g} s. Give the FMU "
                    "that signal as an input, or write the equations as a NonlinearModel."
                )


def _followed(prediction: Prediction, course: Course) -> Floats:
    """Return the state after each step by the prediction."""
    move = replace(
        prediction, controls=len(prediction.held), scales=(1.0,) * (len(prediction.states) + len(prediction.held))
    )
    after = np.empty_like(course.states[1:])
    with move.briefly("move") as function:
        for x, u, following in zip(course.states[:-1], course.inputs, after, strict=True):
            function(x.copy(), u, following)
    return after


def _variables(of: FMUStates) -> list[str]:
    """Return the variables of the states; an array is one variable."""
    exchange = of.fmu.description.exchange
    assert exchange is not None
    return [v.name for v in exchange.states]
