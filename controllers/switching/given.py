"""Checks of the modes of `SwitchingPrecision`, users' own modes included, before compilation."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import signature
from numbers import Real
from typing import TypeVar

import numpy as np

from bayesftc.controllers.models.checks import as_numbers
from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.fault_modes import FaultMode, Unmodelled
from bayesftc.controllers.switching.mode_kernels import AGE, ENTERED, FACTOR, TRUST, WEIGHT, drops
from bayesftc.controllers.switching.process_modes import NoisierProcess
from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.types import Floats, argument_names

Mode = TypeVar("Mode", FaultMode, ActuatorMode, NoisierProcess)

ARGUMENTS = argument_names(drops)
"""Arguments of the step function of every fault mode, in this order."""


def as_fault_modes(given: object) -> tuple[FaultMode, ...]:
    """Return the given fault modes, at least one, each with a step function of the right arguments.

    Raises
    ------
    ModelError
        If there are none, if something else is among them, or if one has its own hypothesis but is not an `Unmodelled`.
    """
    modes = _listed(given, FaultMode, "SwitchingPrecision has modes", "a list of fault modes such as [Offset()]")
    if not modes:
        raise ModelError(
            "SwitchingPrecision has no modes; give a list of fault modes such as [Offset()], at least one."
        )
    for mode in modes:
        name, form = type(mode).__name__, f"evidence({', '.join(ARGUMENTS)})"
        evidence = getattr(type(mode), "evidence", None)
        if evidence is None:
            raise ModelError(f"The fault mode {name} has no step function; give the class one: {form}.")
        try:
            names = argument_names(evidence)
        except KernelError as error:
            raise ModelError(f"{name}.evidence: {error} Give a step function {form}.") from None
        if names != ARGUMENTS:
            raise ModelError(
                f"{name}.evidence has the arguments {', '.join(names) or '(none)'}; it must be a step function with exactly "
                f"these, in this order: {form}."
            )
        if mode.own_hypothesis and not isinstance(mode, Unmodelled):
            raise ModelError(
                f"The fault mode {name} has own_hypothesis = True, so the joint form reads its settings as those of Unmodelled; "
                "derive it from Unmodelled, or leave own_hypothesis out."
            )
        _check_call(mode, "settings", "model, sensor")
    return modes


def as_actuator_modes(given: object) -> tuple[ActuatorMode, ...]:
    """Return the given actuator modes, each with an effect and a method ``expected(scale)``.

    Raises
    ------
    ModelError
        If something else is among them, or a mode is incomplete.
    """
    remedy = "a list of actuator modes such as [LostEffect()], or none"
    modes = _listed(given, ActuatorMode, "SwitchingPrecision has actuator_modes", remedy)
    for mode in modes:
        name = type(mode).__name__
        if type(mode).expected is ActuatorMode.expected:
            raise ModelError(f"The actuator mode {name} has no method expected(self, scale); give it one.")
        _check_call(mode, "expected", "scale")
        if not (mode.absolute or mode.relative or mode.takes):
            raise ModelError(
                f"The actuator mode {name} has no effect, because absolute, relative and takes are 0; set one of them in the "
                "class."
            )
    return modes


def first_of(mode: FaultMode) -> Floats:
    """Return the numbers of a mode before the first sample.

    Raises
    ------
    ModelError
        If they are not at least a trust and a size.
    """
    name = f"{type(mode).__name__}.first"
    first = as_numbers(
        name, mode.first, "it must be a property that returns numbers: trust, size, and further ones of the mode"
    )
    if first.ndim != 1 or len(first) < 2:
        raise ModelError(f"{name} is {mode.first!r}; return at least two numbers: trust and size (NaN: none).")
    return first


def expected_of(mode: ActuatorMode, scale: float) -> tuple[float, float, float]:
    """Return a mode's expectation of c: mean and variance at the onset, and the variance of its walk.

    Raises
    ------
    ModelError
        If the mode returns something else.
    """
    expected = mode.expected(scale)
    try:
        mean, variance, walk = map(float, expected)
    except (TypeError, ValueError):
        mean = variance = walk = np.nan
    if not np.isfinite([mean, variance, walk]).all() or min(variance, walk) < 0:
        raise ModelError(
            f"{type(mode).__name__}.expected returned {expected!r}; return the mean of c, its variance and the variance of its "
            "walk per sample."
        )
    return mean, variance, walk


def settings_of(mode: FaultMode, result: object) -> Floats:
    """Return a mode's settings for a sensor, after a trial of its step function.

    A compiled function that uses an index outside its numbers would change those of other modes without an error.

    Parameters
    ----------
    mode : FaultMode
        The mode.
    result : object
        The result of its method ``settings``.

    Raises
    ------
    ModelError
        If the settings are not numbers, or the step function cannot be computed with them.
    """
    name = type(mode).__name__
    settings = as_numbers(f"The result of {name}.settings", result, "return a tuple of numbers").reshape(-1)
    memory = np.concatenate([np.zeros(TRUST), first_of(mode)])
    memory[[WEIGHT, ENTERED, FACTOR, AGE]] = 0.25, 0.5, 1.0, 3.0
    sample = {"e": 0.5, "present": 1.0, "variance": 1.5, "nominal": 1.0, "change": 0.25, "healthy": -1.2}
    try:
        with np.errstate(all="ignore"):
            density = type(mode).evidence(**sample, memory=memory, at=0, settings=settings.copy(), first=0)
    except IndexError as error:
        raise ModelError(
            f"{name}.evidence uses an index outside its numbers ({error}). It has {len(memory)} numbers from memory[at] on and "
            f"{len(settings)} from settings[first] on. Return more from first or settings."
        ) from None
    except Exception as error:  # whatever the user's function may raise
        raise ModelError(f"{name}.evidence cannot be computed: {error}.") from error
    if not isinstance(density, Real):
        raise ModelError(f"{name}.evidence returned {density!r}; it must return one number, a log density.")
    if not density < np.inf:  # -inf is an impossible sample
        raise ModelError(
            f"{name}.evidence returned {float(density)} for an ordinary sample; return a finite log density."
        )
    return settings


def _check_call(mode: Mode, method: str, arguments: str) -> None:
    """Refuse a mode whose method does not accept these arguments."""
    name, call = f"{type(mode).__name__}.{method}", f"{method}({arguments})"
    function = getattr(mode, method)
    if not callable(function):
        raise ModelError(f"{name} is {function!r}; it must be a method {method}(self, {arguments}).")
    try:
        signature(function).bind(*arguments.split(", "))
    except TypeError:
        raise ModelError(
            f"{name} is called as {call}, but it is {method}{signature(function)}; write it as {method}(self, {arguments})."
        ) from None


def as_process_modes(given: object) -> tuple[NoisierProcess, ...]:
    """Return the given process modes.

    Raises
    ------
    ModelError
        If something else is among them.
    """
    remedy = "a list of process modes such as [NoisierProcess()], or none"
    return _listed(given, NoisierProcess, "SwitchingPrecision has process_modes", remedy)


def _listed(given: object, kind: type[Mode], title: str, remedy: str) -> tuple[Mode, ...]:
    if isinstance(given, Sequence) and not isinstance(given, str):
        for item in given:
            if isinstance(item, type) and issubclass(item, kind):
                raise ModelError(f"{title} with the class {item.__name__}; give an instance: {item.__name__}().")
        if all(isinstance(item, kind) for item in given):
            return tuple(given)
    raise ModelError(f"{title}={given!r}; give {remedy}.")
