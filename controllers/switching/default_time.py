"""Times that nobody gave, as those of modes and alarms: longer where samples are further apart."""

from __future__ import annotations

from typing import Self

USUAL_STEP = 0.02
"""Seconds between samples up to which default times hold as they stand."""


class DefaultTime(float):
    """A time in seconds that is a default, and so grows with the sample time where samples are far apart.

    A time that the user gives is an ordinary number, which stays as it is, also where it equals the default.

    Parameters
    ----------
    seconds : float
        The time.
    usual_step : float
        Seconds between samples up to which it holds as it stands; beyond, it is as many samples as at this step.
    """

    usual_step: float

    def __new__(cls, seconds: float, usual_step: float = USUAL_STEP) -> Self:
        """Return the number with its usual step."""
        time = super().__new__(cls, seconds)
        time.usual_step = usual_step
        return time


def time_at(time: float, step: float) -> float:
    """Return the time that holds for samples that are `step` seconds apart: one that was given is as it is."""
    return max(1.0, step / time.usual_step) * float(time) if isinstance(time, DefaultTime) else time
