"""Default times, such as those of modes and alarms, which grow with the sample time, and shrink with very short ones."""

from __future__ import annotations

from typing import Self

USUAL_STEP = 0.02
"""Sample time in seconds up to which default times hold unchanged."""

FAST_STEP = 0.005
"""Sample time below which the plant is a fast one, as in power electronics: default times are then shorter, so that the number of
samples is that at this sample time."""


class DefaultTime(float):
    """A default time in seconds, which grows with long sample times and shrinks with very short ones.

    A time from the user is an ordinary number and does not change, even if it equals the default.

    Parameters
    ----------
    seconds : float
        The time.
    usual_step : float
        Sample time up to which it holds unchanged; beyond, the number of samples is that at this sample time.
    """

    usual_step: float

    def __new__(cls, seconds: float, usual_step: float = USUAL_STEP) -> Self:
        """Return the number with its usual step."""
        time = super().__new__(cls, seconds)
        time.usual_step = usual_step
        return time

    @property
    def in_words(self) -> str:
        """The time, and how few and how many samples it may be."""
        return f"{float(self)} ({self / self.usual_step:g} to {self / FAST_STEP:g} samples)"


def time_at(time: float, step: float) -> float:
    """Return a time for samples that are `step` seconds apart; a time from the user does not change."""
    if not isinstance(time, DefaultTime):
        return time
    return max(min(1.0, step / FAST_STEP), step / time.usual_step) * float(time)
