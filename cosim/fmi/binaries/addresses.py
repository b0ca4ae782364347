"""The addresses of the FMI functions that a step calls."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Addresses:
    """Addresses of the FMI functions that a step may call; 0 where the instance does not have them or is not to use them.

    Attributes
    ----------
    do_step : int
        Makes the step.
    real_status, boolean_status : int
        FMI 2, where steps of any size can be made: say how far a discarded step came, and whether the FMU wants to end.
    enter_event_mode, update_discrete, enter_step_mode : int
        FMI 3, where event mode is used.
    """

    do_step: int
    real_status: int = 0
    boolean_status: int = 0
    enter_event_mode: int = 0
    update_discrete: int = 0
    enter_step_mode: int = 0
