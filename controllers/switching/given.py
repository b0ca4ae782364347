"""Modes that are given to `SwitchingPrecision`, a user's own among them: looked at and tried out before they are compiled."""

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
"""What the step function of every fault mode is called with, in this order."""


def as_fault_modes(given: object) -> tuple[FaultMode, ...]:
    """Return the fault modes that were given, at least one, each with a step function that can be called.

    Raises
    ------
    ModelError
        If there is none, something else among them, or one that has a hypothesis of its own and is no `Unmodelled`.
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
            raise ModelError(f"{name}.evidence: {error} It must be {form}.") from None
        if names != ARGUMENTS:
            raise ModelError(
                f"{name}.evidence has the arguments {', '.join(names) or '(none)'}; it must be a step function with exactly "
                f"these, in this order: {form}."
            )
        if mode.own_hypothesis and not isinstance(mode, Unmodelled):
            raise ModelError(
                f"The fault mode {name} has own_hypothesis = True, with which the joint form reads its settings as those of "
                "Unmodelled; derive it from Unmodelled, or leave own_hypothesis out."
            )
        _check_call(mode, "settings", "model, sensor")
    return modes


def as_actuator_modes(given: object) -> tuple[ActuatorMode, ...]:
    """Return the actuator modes that were given, each of which says how it acts and has a method ``expected(scale)``.

    Raises
    ------
    ModelError
        If there is something else among them.
    """
    wanted = "a list of actuator modes such as [LostEffect()], or none"
    modes = _listed(given, ActuatorMode, "SwitchingPrecision has actuator_modes", wanted)
    for mode in modes:
        name = type(mode).__name__
        if type(mode).expected is ActuatorMode.expected:
            raise ModelError(
                f"The actuator mode {name} does not say what to expect; give it a method expected(self, scale)."
            )
        _check_call(mode, "expected", "scale")
        if not (mode.absolute or mode.relative or mode.takes):
            raise ModelError(
                f"The actuator mode {name} does not say how it acts: the plant would get u as ever; set absolute, relative or "
                "takes of the class."
            )
    return modes


def first_of(mode: FaultMode) -> Floats:
    """Return what a mode keeps before the first sample.

    Raises
    ------
    ModelError
        If that is not at least a trust and a size.
    """
    name = f"{type(mode).__name__}.first"
    first = as_numbers(name, mode.first, "it must be a property that returns numbers: trust, size, and the mode's own")
    if first.ndim != 1 or len(first) < 2:
        raise ModelError(f"{name} is {mode.first!r}; it must return at least two numbers: trust and size (NaN: none).")
    return first


def expected_of(mode: ActuatorMode, scale: float) -> tuple[float, float, float]:
    """Return what a mode expects of its c: its mean and variance at the onset, and the variance of its walk.

    Raises
    ------
    ModelError
        If it gives something else.
    """
    told = mode.expected(scale)
    try:
        mean, variance, walk = map(float, told)
    except (TypeError, ValueError):
        mean = variance = walk = np.nan
    if not np.isfinite([mean, variance, walk]).all() or min(variance, walk) < 0:
        raise ModelError(
            f"{type(mode).__name__}.expected gave {told!r}; it must be the mean of c, its variance and that of its walk per "
            "sample."
        )
    return mean, variance, walk


def settings_of(mode: FaultMode, told: object) -> Floats:
    """Return a mode's settings for a sensor, with which its step function has been tried out.

    Compiled, one that reaches beyond what its mode keeps would read and write another mode's numbers without a word.

    Parameters
    ----------
    mode : FaultMode
        The mode.
    told : object
        What its method ``settings`` has returned.

    Raises
    ------
    ModelError
        If the settings are no numbers, or the step function cannot be computed with them.
    """
    name = type(mode).__name__
    settings = as_numbers(f"What {name}.settings returned", told, "it must be a tuple of numbers").reshape(-1)
    memory = np.concatenate([np.zeros(TRUST), first_of(mode)])
    memory[[WEIGHT, ENTERED, FACTOR, AGE]] = 0.25, 0.5, 1.0, 3.0
    sample = {"e": 0.5, "present": 1.0, "variance": 1.5, "nominal": 1.0, "change": 0.25, "healthy": -1.2}
    try:
        with np.errstate(all="ignore"):
            density = type(mode).evidence(**sample, memory=memory, at=0, settings=settings.copy(), first=0)
    except IndexError as error:
        raise ModelError(
            f"{name}.evidence reaches beyond what the mode keeps ({error}): its own are {len(memory)} numbers from memory[at] "
            f"on and {len(settings)} from settings[first] on. Return more from its first or its settings."
        ) from None
    except Exception as error:  # whatever the user's function may raise
        raise ModelError(f"{name}.evidence cannot be computed: {error}.") from error
    if not isinstance(density, Real):
        raise ModelError(
            f"{name}.evidence returned {density!r}; it must return one number, the logarithm of a density."
        )
    if not density < np.inf:  # -inf is a sample that cannot be
        raise ModelError(
            f"{name}.evidence returned {float(density)} for an ordinary sample; it must be the logarithm of a density, a number."
        )
    return settings


def _check_call(mode: Mode, method: str, arguments: str) -> None:
    """Refuse a mode whose method cannot be called with these arguments."""
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
    """Return the process modes that were given.

    Raises
    ------
    ModelError
        If there is something else among them.
    """
    wanted = "a list of process modes such as [NoisierProcess()], or none"
    return _listed(given, NoisierProcess, "SwitchingPrecision has process_modes", wanted)


def _listed(given: object, kind: type[Mode], title: str, wanted: str) -> tuple[Mode, ...]:
    if isinstance(given, Sequence) and not isinstance(given, str):
        for item in given:
            if isinstance(item, type) and issubclass(item, kind):
                raise ModelError(
                    f"{title} with the class {item.__name__} among them; give a mode made of it: {item.__name__}()."
                )
        if all(isinstance(item, kind) for item in given):
            return tuple(given)
    raise ModelError(f"{title}={given!r}; give {wanted}.")
