"""Mean times of modes that nobody gave: longer where samples are further apart."""

from __future__ import annotations

USUAL_STEP = 0.02
"""Seconds between samples up to which default times hold as they stand."""


class DefaultTime(float):
    """A mean time in seconds that is a default, and so grows with the sample time beyond `USUAL_STEP`.

    A time that the user gives is an ordinary number, which stays as it is, also where it equals the default.
    """

    def at_step(self, step: float) -> float:
        """Return the mean time for samples that are `step` seconds apart."""
        return max(1.0, step / USUAL_STEP) * float(self)
