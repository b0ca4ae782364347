"""The addresses of the FMI functions that a step calls."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Addresses:
    """Addresses of the FMI functions that a step may call; 0 for functions that the instance lacks or must not use.

    Attributes
    ----------
    do_step : int
        Makes the step.
    real_status, boolean_status : int
        For FMI 2 with variable step size: the time that a discarded step reached, and whether the FMU ends the simulation.
    enter_event_mode, update_discrete, enter_step_mode : int
        For FMI 3 with event mode.
    """

    do_step: int
    real_status: int = 0
    boolean_status: int = 0
    enter_event_mode: int = 0
    update_discrete: int = 0
    enter_step_mode: int = 0
