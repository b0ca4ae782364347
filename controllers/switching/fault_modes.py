"""Fault modes: the ways in which a sensor can fail, between which `SwitchingPrecision` decides.

To write one you must:

1. make it a frozen dataclass, a subclass of `FaultMode`, whose settings all have defaults;
2. give the class a step function, ``evidence = glitches``: a plain function outside the class with exactly these arguments::

       glitches(e, present, variance, nominal, change, healthy, memory, at, settings, first)

   It returns the logarithm of a sample's density if the sensor has failed in this way. What the arguments are, and what it may
   write, say `drops` in ``mode_kernels.py`` and the table of ``docs/extend.md``. The places in its memory (`TRUST`, `SIZE`,
   ...) and `log_density` can be imported from here; the mathematics comes from `bayesftc.cosim.ops`, as in every step function;
3. return from the property ``first`` what it keeps before the first sample (trust, size, own numbers), and from
   ``settings(model, sensor)`` its settings for one sensor.

That is all in Python: ``SwitchingPrecision([Glitching(), Offset()])``; ``docs/extend.md`` has a whole one. Scenario files choose
by name from `FAULT_MODES`, over which the tests run as well: one that they shall know is added there.

In the joint form a subclass of `Offset` is estimated together with the state, from its ``jump``, ``slope`` and ``walk``; its
``evidence`` then counts only where another sensor has an offset already, or an actuator has failed. A mode with
``own_hypothesis = True`` is a subclass of `Unmodelled`, whose regression the joint form computes in place of its ``evidence``.

A mode with ``is_fault = False`` is harmless: the sensor is trusted as the mode says, but its probability is no part of
``fault_probability``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log, nan, sqrt
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bayesftc.controllers.linalg.special import LOG_2_PI
from bayesftc.controllers.models.checks import as_number, as_vector, check_number
from bayesftc.controllers.switching import mode_kernels as kernels
from bayesftc.controllers.switching.course import COURSE, COURSE_SCRATCH, ORDER
from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.controllers.switching.mode_kernels import ENTERED, FACTOR, OWN, SIZE, TRUST, log_density

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel


HEALTHY_REPEATS = 0.001
"""Share of the samples that a healthy sensor repeats exactly, where nobody says it."""

REPEATS_STRENGTH = 10.0
"""How many samples it counts as what share of repetitions is expected of a healthy sensor."""

MOST_REPEATS = 0.6
"""Largest such share that is learned: a sensor of which more repeat is frozen, or has a resolution that should be told."""


@dataclass(frozen=True)
class FaultMode:
    """Base of all fault modes.

    Parameters
    ----------
    time_to_fault : float
        Mean time in seconds until a healthy sensor fails in this way. The default is short enough that faults are found soon, and
        so long that even a fifth of it would cost healthy sensors less than 1 % of the error.
    time_to_recovery : float
        Mean time in seconds until it is healthy again.

    Both defaults are for samples up to 20 ms apart; `SwitchingPrecision.paced` lengthens them where samples are further apart.
    """

    time_to_fault: float = DefaultTime(300.0)
    time_to_recovery: float = DefaultTime(10.0)

    evidence: ClassVar[Callable[..., float]]
    arrival: ClassVar[float | None] = None
    """Probability that there is a sample; None: as of a healthy sensor."""
    needs_witness: ClassVar[bool] = False
    """Whether it is told from the state's own motion only while another sensor is healthy (in the joint form)."""
    is_fault: ClassVar[bool] = True
    """Whether the sensor has failed that is in this mode."""
    own_hypothesis: ClassVar[bool] = False
    """Whether the joint form has a hypothesis for each sensor that fails so, of which the state is inferred without it."""
    joint_only: ClassVar[bool] = False
    """Whether it takes part only where its offset is estimated together with the state, as it gains nothing elsewhere."""

    def __post_init__(self) -> None:
        for name in ("time_to_fault", "time_to_recovery"):
            check_number(self, name, above=0)

    @property
    def first(self) -> tuple[float, ...]:
        """What it keeps of a sensor, before the first sample: trust, size, and its own numbers."""
        return 0.0, nan

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """Return the settings of its step function for one sensor of a model."""
        return ()


@dataclass(frozen=True)
class Frozen(FaultMode):
    """The sensor repeats its last sample.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    repeats : float
        Share of the samples that repeat exactly, between 0 and 1; the others have a dither.
    dither : float
        Standard deviation of the dither, in those of the sensor's noise.
    resolution : float or sequence of float
        Resolution of the sensors in their unit, for all or for each: a healthy sensor repeats itself, too, if that is coarse.
    healthy_repeats : float or sequence of float
        Share of the samples that a healthy sensor repeats exactly, as expected before the first one, for all sensors or for each.
        It is learned while the sensor is healthy; this counts as ten samples. Where a resolution is given, no more than this is
        learned: the resolution explains the rest. With 0 none is.
    """

    repeats: float = 0.9
    dither: float = 0.01
    resolution: float | Sequence[float] = 0.0
    healthy_repeats: float | Sequence[float] = HEALTHY_REPEATS

    evidence: ClassVar[Callable[..., float]] = kernels.freezes

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "repeats", above=0, below=1)
        check_number(self, "dither", above=0)
        for name, below in (("resolution", None), ("healthy_repeats", 1)):
            given = getattr(self, name)
            several = isinstance(given, list | tuple | np.ndarray)
            for value in given if several else (given,):
                as_number(f"Frozen has {name}", value, least=0, below=below)
            object.__setattr__(self, name, tuple(given) if several else given)

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        nominal = float(model.matrix("sensor_covariance")[sensor, sensor])
        resolution = as_vector("The resolution of Frozen", self.resolution, model.sensors)
        width = max(float(resolution[sensor]), 1e-9 * sqrt(nominal))
        spread = 2 * self.dither**2 * nominal + width**2 / 6
        near = log(1 - self.repeats) - 0.5 * (log(spread) + LOG_2_PI)
        return 0.5 * width, log(self.repeats / width), near, spread

    def healthy(self, model: LinearModel, sensor: int) -> tuple[float, float, float, float]:
        """Return what is expected of the repetitions of a healthy sensor of a model.

        The width within which two samples count as equal, in the sensor's unit; how many repetitions of how many samples are
        expected before the first one; and the largest share that is learned.
        """
        half = self.settings(model, sensor)[0]
        told = as_vector("The resolution of Frozen", self.resolution, model.sensors)[sensor] > 0
        share = float(as_vector("healthy_repeats of Frozen", self.healthy_repeats, model.sensors)[sensor])
        most = share if told or share == 0 else max(MOST_REPEATS, share)
        return 2.0 * half, share * REPEATS_STRENGTH, REPEATS_STRENGTH, most


@dataclass(frozen=True)
class Offset(FaultMode):
    """An unknown offset, which may drift, is added at once: injection and bias.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`. Jumps are twice as frequent as other faults, for many of them are short (`SwitchingPrecision`).
    jump : float
        Standard deviation of the offset at its onset, in those of the sensor's noise; if the first innovation is larger, that.
    slope : float
        Standard deviation of its rate, in those of the sensor's noise per sample.
    walk : float
        Standard deviation of the offset's own random walk, in those of the sensor's noise per sample.
    """

    time_to_fault: float = DefaultTime(150.0)
    jump: float = 1.0
    slope: float = 0.0
    walk: float = 0.01

    evidence: ClassVar[Callable[..., float]] = kernels.shifts

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("jump", "slope", "walk"):
            check_number(self, name, least=0)

    @property
    def first(self) -> tuple[float, ...]:
        """See `FaultMode.first`."""
        return (0.0,) * 6

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        return self.jump**2, self.slope**2, self.walk**2, float(self.jump > 0)


@dataclass(frozen=True)
class Drifting(Offset):
    """An offset begins at zero and grows, so slowly at first that nothing jumps.

    Parameters
    ----------
    time_to_fault, time_to_recovery, jump, slope, walk
        See `Offset`.
    """

    time_to_fault: float = DefaultTime(300.0)
    jump: float = 0.0
    slope: float = 0.02
    walk: float = 0.0

    needs_witness: ClassVar[bool] = True


@dataclass(frozen=True)
class Ramping(Offset):
    """An offset begins at zero and grows by more than a slow drift: after a few samples it is beyond the noise.

    In the joint form; sensor by sensor an `Offset` does as well.

    Parameters
    ----------
    time_to_fault, time_to_recovery, jump, slope, walk
        See `Offset`.
    """

    time_to_fault: float = DefaultTime(300.0)
    jump: float = 0.0
    slope: float = 0.3
    walk: float = 0.0

    joint_only: ClassVar[bool] = True


@dataclass(frozen=True)
class DroppedOut(FaultMode):
    """The sensor sends nothing.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    arrives : float
        Probability of a sample all the same.
    """

    arrives: float = 0.001

    evidence: ClassVar[Callable[..., float]] = kernels.drops

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "arrives", above=0, below=1)

    @property
    def arrival(self) -> float:  # type: ignore[override]
        """Probability that there is a sample."""
        return self.arrives


@dataclass(frozen=True)
class Noisier(FaultMode):
    """The sensor's noise has another precision, which is gamma distributed and learned: the paper's learner as a mode.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    scale : float
        Expected standard deviation of the noise at the onset, in nominal ones.
    shape : float
        Shape of the gamma distribution at the onset; the smaller, the less is taken for known.
    forgetting : float
        Forgetting factor in (0, 1] per sample.
    """

    scale: float = 4.0
    shape: float = 1.0
    forgetting: float = 0.98

    evidence: ClassVar[Callable[..., float]] = kernels.scatters

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "scale", above=0)
        check_number(self, "shape", above=0)
        check_number(self, "forgetting", above=0, most=1)

    @property
    def first(self) -> tuple[float, ...]:
        """See `FaultMode.first`."""
        return min(self.scale**-2, 1.0), self.scale, self.shape, self.shape * self.scale**2

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        return self.shape, self.shape * self.scale**2, self.forgetting


@dataclass(frozen=True)
class Unmodelled(FaultMode):
    """The sensor has failed in a way that has no mode of its own; how its samples then go is learned.

    Its innovations are a linear regression on a constant, on their predecessor and on the prediction, with noise of any scale.
    That fits a sensor that is frozen with a dither, filtered, late, swapped, oscillating or of another gain; and a share of its
    samples repeats exactly, as of one that clips. In the joint form the state is inferred without this sensor meanwhile, in a
    hypothesis for each sensor. The fault's size is the root mean square of the innovations, in nominal standard deviations.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    scale, shape : float
        Expected standard deviation of the regression's noise at the onset, in nominal ones, and shape of the gamma distribution
        of its precision.
    forgetting : float
        Forgetting factor of the regression in (0, 1] per sample.
    fading : float
        Factor per sample by which the slow part of the prediction is left out.
    means, deviations : sequence of float
        Means and standard deviations of the three coefficients at the onset: of the constant, of the last innovation, of the
        prediction. The latter are in those of the regression's noise.
    repeats : float
        Share of the samples that repeat exactly, between 0 and 1, as expected at the onset; it is learned (in the joint form).
    repeats_strength : float
        How many samples that share counts as.
    """

    scale: float = 1.0
    shape: float = 1.0
    forgetting: float = 0.97
    fading: float = 0.99
    means: Sequence[float] = (0.0, 0.8, 0.0)
    deviations: Sequence[float] = (3.0, 0.5, 0.3)
    repeats: float = 0.1
    repeats_strength: float = 5.0

    own_hypothesis: ClassVar[bool] = True
    evidence: ClassVar[Callable[..., float]] = kernels.goes_its_way

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("scale", "shape", "repeats_strength"):
            check_number(self, name, above=0)
        check_number(self, "repeats", above=0, below=1)
        for name in ("forgetting", "fading"):
            check_number(self, name, above=0, most=1)
        for name in ("means", "deviations"):
            given = as_vector(f"The {name} of Unmodelled", getattr(self, name), ORDER)
            object.__setattr__(self, name, tuple(map(float, given)))
        for value in self.deviations:
            as_number("Unmodelled has deviations", value, above=0)

    @property
    def first(self) -> tuple[float, ...]:
        """See `FaultMode.first`."""
        return 0.0, self.scale, *[0.0] * (COURSE + COURSE_SCRATCH)

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        weights = [deviation**-2 for deviation in self.deviations]
        explained = sum(weight * mean**2 for weight, mean in zip(weights, self.means, strict=True))
        rate = self.shape * self.scale**2 + 0.5 * explained
        repeats = self.repeats * self.repeats_strength, self.repeats_strength
        return self.forgetting, self.fading, self.shape, rate, *self.means, *weights, *repeats


@dataclass(frozen=True)
class Burst(Noisier):
    """The noise swells for a moment and passes, as a wheel's does on a bump: such a sensor has not failed.

    Samples of a burst are trusted as little as those of a noisier sensor, from which only its brevity tells it.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        Mean time in seconds between two bursts, and how long one lasts; by default at least three samples.
    scale, shape, forgetting
        See `Noisier`.
    """

    time_to_fault: float = DefaultTime(5.0, usual_step=0.1)
    time_to_recovery: float = DefaultTime(0.3, usual_step=0.1)
    forgetting: float = 0.9

    is_fault: ClassVar[bool] = False


FAULT_MODES: tuple[type[FaultMode], ...] = (Frozen, Offset, Drifting, Ramping, Unmodelled, Noisier, DroppedOut, Burst)
"""To add a fault mode, write it by the rules above and name it here."""

__all__ = [
    "ENTERED", "FACTOR", "FAULT_MODES", "OWN", "SIZE", "TRUST", "Burst", "Drifting", "DroppedOut", "FaultMode", "Frozen",
    "Noisier", "Offset", "Ramping", "Unmodelled", "log_density",
]  # fmt: skip
