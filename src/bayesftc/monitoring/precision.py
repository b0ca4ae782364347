"""The default learner of a monitor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.controllers.switching.fault_modes import (
    HEALTHY_REPEATS,
    Burst,
    Drifting,
    DroppedOut,
    Frozen,
    Noisier,
    Offset,
    Unmodelled,
)
from bayesftc.controllers.switching.learner import SwitchingPrecision

RARE = 3600.0
"""Mean time in seconds to a fault of each kind."""

UNKNOWN = 100.0
"""How much rarer an `Unmodelled` fault is: it also explains errors that sensors share and the model lacks."""


def default_precision(
    loss: Sequence[float],
    resolution: Sequence[float],
    repeats: float | Sequence[float] = HEALTHY_REPEATS,
    *,
    joint: bool = False,
) -> SwitchingPrecision:
    """Return the default learner of a monitor: every kind of fault once in an hour, and harmless bursts of noise.

    The faults of a recording are not known, so offsets may be large and drifts fast. Times are in seconds and sizes in the
    sensors' standard deviations, so the learner fits any quantity. It is the per-sensor form by default: in a recorded drive, the
    joint form also suspected sensors that share errors with the faulty one.

    Parameters
    ----------
    loss : sequence of float
        As for `SwitchingPrecision`.
    resolution : sequence of float
        Resolution of each sensor, in its unit.
    repeats : float or sequence of float
        Share of the samples that a healthy sensor repeats, for all or for each.
    joint : bool
        Whether sensors are judged together: two that agree then outvote a third one that drifts slowly. Only then is there the
        mode `Unmodelled`, for a sensor that lags, say. The noise of two sensors is then as stated, and not learned.

    Returns
    -------
    SwitchingPrecision
        The learner.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> learner = monitoring.default_precision(loss=[0.01, 0.8], resolution=[0.0, 0.5])
    >>> learner.joint, learner.modes[0].resolution, learner.modes[0].time_to_fault
    (False, (0.0, 0.5), 3600.0)
    """
    rare = {"time_to_fault": DefaultTime(RARE)}
    modes = (
        Frozen(**rare, dither=0.001, resolution=tuple(resolution), healthy_repeats=repeats),
        Offset(**rare, jump=30.0, walk=0.02),
        Drifting(**rare, slope=0.1),
        *([Unmodelled(time_to_fault=DefaultTime(UNKNOWN * RARE))] if joint else []),
        Noisier(**rare, scale=5.0),
        DroppedOut(**rare),
        Burst(scale=5.0),
    )
    learner = SwitchingPrecision(modes, loss=tuple(loss), joint=joint, outages=True)
    # Of two sensors only the difference tells. Learned noise sides with the one that seems quieter, too surely.
    return replace(learner, noise_factor=1.0) if joint and len(loss) == 2 else learner
