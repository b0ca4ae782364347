"""A mode of a sensor that is no fault: noise that swells for a moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesftc.controllers.fault_modes import Noisier


@dataclass(frozen=True)
class Burst(Noisier):
    """The noise swells for a moment and passes, as a wheel's does on a bump: such a sensor has not failed.

    Samples of a burst are trusted as little as those of a noisier sensor, from which only its brevity tells it.
    `SwitchingPrecision` itself knows no harmless modes, and its ``fault_probability`` counts all; a monitor of recordings
    (`bayesftc.monitoring`) leaves bursts out.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        Mean time in seconds between two bursts, and how long one lasts.
    scale, shape, forgetting
        See `Noisier`.
    """

    time_to_fault: float = 5.0
    time_to_recovery: float = 0.3
    forgetting: float = 0.9

    is_fault: ClassVar[bool] = False
    """Whether the sensor has failed that is in this mode."""
