"""Mean times of modes that nobody gave: longer where samples are further apart."""

from __future__ import annotations

from typing import Self

USUAL_STEP = 0.02
"""Seconds between samples up to which default times hold as they stand."""


class DefaultTime(float):
    """A mean time in seconds that is a default, and so grows with the sample time where samples are far apart.

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

    def at_step(self, step: float) -> float:
        """Return the mean time for samples that are `step` seconds apart."""
        return max(1.0, step / self.usual_step) * float(self)
