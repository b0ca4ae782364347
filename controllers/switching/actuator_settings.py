"""Settings of the actuator modes in the joint form of `SwitchingPrecision`."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.switching.actuator_modes import ActuatorMode
from bayesftc.controllers.switching.fault_modes import FaultMode
from bayesftc.controllers.switching.given import expected_of
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import sqrt

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

SMALL = 0.01
"""Share of a control's range below which expected faults are too small: with a tenth they are found at once, with .03 late."""

ROUNDING = 1e-10
"""Share of the process noise in its largest direction up to which that in another one counts as none."""


def control_scales(model: LinearModel) -> list[float]:
    """Return the size of each control that moves the state in one sample as far as its process noise does; 0 if there is none.

    With several states it is that of the most informative direction. Directions without noise do not count: those whose share of
    the noise may be rounding, in units of the noise of each state, so that the states' units do not matter.
    """
    Q = model.matrix("process_covariance")
    size = np.sqrt(np.diag(Q))
    size[size == 0] = 1.0
    precision = np.linalg.pinv(Q / np.outer(size, size), rcond=ROUNDING, hermitian=True)
    information = [float(effect @ precision @ effect) for effect in (model.effects.T / size)]
    return [1.0 / sqrt(value) if value > 0 else 0.0 for value in information]


def check_controls(modes: Sequence[ActuatorMode], model: LinearModel, names: Sequence[str]) -> list[float]:
    """Refuse modes of controls without effect; return the scale of each control, if there are modes.

    Parameters
    ----------
    modes : sequence of ActuatorMode
        The modes of each control.
    model : LinearModel
        The model of the plant.
    names : sequence of str
        Name of each control in messages.

    Raises
    ------
    ModelError
        If a control moves no state, or none with process noise and a mode expects sizes in its units.
    """
    if not modes:
        return []
    scales = control_scales(model)
    for name, effect, scale in zip(names, model.effects.T, scales, strict=True):
        if not effect.any():
            raise ModelError(
                f"SwitchingPrecision has actuator_modes, but {name} moves no state (its column of B is zero); leave it or the "
                "actuator modes out."
            )
        for mode in modes:
            if mode.absolute and not scale:
                raise ModelError(
                    f"{type(mode).__name__} expects faults in units of the process noise, but the model has none on any state "
                    f"that {name} moves; give it a process_covariance there."
                )
    return scales


def warn_of_small_faults(modes: Sequence[ActuatorMode], model: LinearModel, low: Floats, high: Floats) -> None:
    """Warn if modes expect faults far smaller than the range of their control, which then count as faults of sensors for long.

    Parameters
    ----------
    modes : sequence of ActuatorMode
        The modes of each control.
    model : LinearModel
        The model of the plant.
    low, high : ndarray
        Limits of the controls.
    """
    absolute = [mode for mode in modes if mode.absolute]
    names = model.names.controls if model.names else [f"control {j}" for j in range(model.controls)]
    for j, scale in enumerate(control_scales(model) if absolute else []):
        span = float(high[j] - low[j])
        for mode in absolute:
            size = float(mode.expected(scale)[1]) ** 0.5
            if isfinite(span) and 0.0 < size < SMALL * span:
                warn_user(
                    f"{type(mode).__name__} expects faults of {names[j]} of about {size:.2g}, by its process noise, "
                    f"but the limits of {names[j]} are {span:.4g} apart. A larger fault is found late, and sensors are blamed "
                    f"meanwhile. Give {names[j]} process noise of its own, of about a fiftieth of that range (noise= in design)."
                )
                break


def actuator_settings(modes: Sequence[ActuatorMode], model: LinearModel) -> list[float]:
    """Return the settings of each mode of each actuator, one after the other.

    Raises
    ------
    ModelError
        See `check_controls`; or if a mode's expectation is not three numbers.
    """
    settings: list[float] = []
    for scale in check_controls(modes, model, [f"control {j} of the model" for j in range(model.controls)]):
        for mode in modes:
            mean, variance, walk = expected_of(mode, scale)
            rates = [chance(mode, name, float(model.step)) for name in ("time_to_fault", "time_to_recovery")]
            settings += [*rates, mean, mode.follows, variance, walk, mode.absolute, mode.relative, mode.takes]
    return settings


def chance(mode: FaultMode | ActuatorMode, name: str, step: float) -> float:
    """Return the probability per sample of an event with a mean time in seconds."""
    per_sample = step / float(getattr(mode, name))
    if per_sample >= 1:
        raise ModelError(
            f"{type(mode).__name__} has {name}={getattr(mode, name)!r}, which is not longer than the sample "
            f"time of {step:g} s; give more seconds, or a shorter sample time."
        )
    return per_sample
