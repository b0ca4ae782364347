"""Process modes: times with more process noise than nominal, such as a kick or a rough road.

A learner without them attributes a common deviation of all sensors to faults of all sensors. `SwitchingPrecision` distinguishes
these modes from those of sensors and actuators: the precision of the transition model switches.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import square


@dataclass(frozen=True)
class NoisierProcess:
    """The model predicts the plant's states less precisely than usual: by default a kick, large and for a single sample.

    Either the process noise has another `scale`, or the past counts less (`fading`), as in a filter with a fading memory. A
    fading memory covers models that are wrong in any direction.

    Parameters
    ----------
    time_to_fault : float
        Mean time in seconds until it begins. By default it is a hundred times that of a sensor fault, because the last working
        sensor cannot distinguish its own offset from a kick.
    time_to_recovery : float
        Mean duration in seconds after the first sample.
    scale : float
        Standard deviation of the process noise in this mode, in nominal ones. A kick may reach four times that far. With a
        larger scale, a plant slower than its model makes the loop unstable sooner. Below 1 the process is quieter, where the
        nominal noise may be stated too large.
    fading : float
        Factor of the predicted covariance of the plant's states at each sample in this mode (Sorenson and Sacks, Information
        Sciences 3, 1971). Steps without a sample of any sensor do not count. Steps do not count either if the covariance reaches
        a hundred times the variance of a sensor's noise, as for a state that no sensor sees any more, nor for a state whose
        variance reaches a hundred times that without any sample.

    Raises
    ------
    ModelError
        If scale and fading are 1, or out of their range.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision(process_modes=[controllers.NoisierProcess()], alike=0.0)
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y in (0.0, 0.1, -0.1, 0.0, 1.6):  # at last a kick moves all three sensors
    ...     out = step(y=[y, y + 0.05, y - 0.05])
    >>> out.process_mode_probability.round(2).tolist(), out.x_hat.round(1).tolist()  # nominal, kick, a kick has just ended
    ([0.0, 1.0, 0.0], [1.6])
    """

    time_to_fault: float = DefaultTime(30000.0)
    time_to_recovery: float = 0.0
    scale: float = 50.0
    fading: float = 1.0

    def __post_init__(self) -> None:
        check_number(self, "time_to_fault", above=0)
        check_number(self, "time_to_recovery", least=0)
        check_number(self, "scale", above=0, most=1e6)
        check_number(self, "fading", least=1, most=1e6)
        if self.scale == 1 and self.fading == 1:
            raise ModelError(
                "NoisierProcess has scale 1 and fading 1, which has no effect; make one of them larger than 1, or scale smaller."
            )

    def settings(self, step: float) -> tuple[float, float, float, float]:
        """Return the probabilities per sample of begin and end, the added variance, and the faded part.

        The variance is in units of the nominal one, the part in units of the belief's. The duration T counts from the first
        sample on and may be 0, so that its probability per sample is step / (step + T).
        """
        begins, ends = step / (step + self.time_to_fault), step / (step + self.time_to_recovery)
        return begins, ends, square(self.scale) - 1.0, self.fading - 1.0


PROCESS_MODES: tuple[NoisierProcess, ...] = (
    NoisierProcess(),
    NoisierProcess(time_to_fault=DefaultTime(3000.0), time_to_recovery=DefaultTime(10.0), scale=1.0, fading=1.3),
    NoisierProcess(time_to_fault=DefaultTime(3000.0), time_to_recovery=DefaultTime(10.0), scale=1.0, fading=2.0),
)
"""The default modes: kicks, and longer times with a less precise model, such as one with a wrong mass."""


__all__ = ["PROCESS_MODES", "NoisierProcess"]
