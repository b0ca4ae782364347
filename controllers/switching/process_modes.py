"""Process modes: times in which the plant is moved by more than its process noise, as by a kick or on a rough road.

A learner that does not know of them takes what all sensors see alike for faults of all of them. `SwitchingPrecision` decides
between these modes and those of sensors and actuators: the precision of the transition model switches.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.cosim.errors import ModelError


@dataclass(frozen=True)
class NoisierProcess:
    """The model says less of the plant's states than usual: by default for a single sample and by far, which is a kick.

    Either their process noise is larger (`scale`), or the past tells less of them (`fading`), as in a filter with a fading
    memory. A fading memory covers models that are wrong in any direction.

    Parameters
    ----------
    time_to_fault : float
        Mean time in seconds until it begins; by default a hundred times that of a sensor's fault: the last sensor that works
        cannot tell its own offset from a kick.
    time_to_recovery : float
        Mean time in seconds for which it lasts beyond its first sample.
    scale : float
        Standard deviation of the process noise meanwhile, in nominal ones. That of a kick by default reaches four times as far;
        the larger it is, the sooner a plant that is later than its model makes the loop unstable.
    fading : float
        Factor of the predicted covariance of the plant's states at each sample meanwhile (Sorenson and Sacks, Information
        Sciences 3, 1971); steps without a sample of any sensor do not count, nor those at which
        it reaches a hundred times the variance of a sensor's noise, as that of a state which no sensor sees any more.

    Raises
    ------
    ModelError
        If neither scale nor fading is above 1.
    """

    time_to_fault: float = DefaultTime(30000.0)
    time_to_recovery: float = 0.0
    scale: float = 50.0
    fading: float = 1.0

    def __post_init__(self) -> None:
        check_number(self, "time_to_fault", above=0)
        check_number(self, "time_to_recovery", least=0)
        check_number(self, "scale", least=1, most=1e6)
        check_number(self, "fading", least=1, most=1e6)
        if self.scale == 1 and self.fading == 1:
            raise ModelError(
                "NoisierProcess has scale 1 and fading 1: that is no mode; make one of them larger than 1."
            )

    def settings(self, step: float) -> tuple[float, float, float, float]:
        """Return the probabilities per sample with which it begins and ends, the variance that it adds, and the part that fades.

        The variance is in nominal ones, the part in those of the belief.
        The time that it lasts counts from its first sample on and may be 0: so a mean time T has the probability
        step / (step + T).
        """
        begins, ends = step / (step + self.time_to_fault), step / (step + self.time_to_recovery)
        return begins, ends, self.scale**2 - 1.0, self.fading - 1.0


PROCESS_MODES: tuple[NoisierProcess, ...] = (
    NoisierProcess(),
    NoisierProcess(time_to_fault=DefaultTime(3000.0), time_to_recovery=DefaultTime(10.0), scale=1.0, fading=1.3),
    NoisierProcess(time_to_fault=DefaultTime(3000.0), time_to_recovery=DefaultTime(10.0), scale=1.0, fading=2.0),
)
"""What the plant does by default: kicks; and longer times in which the model says less than it should, as one of a wrong mass."""


__all__ = ["PROCESS_MODES", "NoisierProcess"]
