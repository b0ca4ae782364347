"""Fault modes: the ways in which a sensor can fail, which `SwitchingPrecision` distinguishes.

To write one you must:

1. make it a frozen dataclass, a subclass of `FaultMode`, whose settings all have defaults;
2. give the class a step function, ``evidence = glitches``: a plain function outside the class with exactly these arguments::

       glitches(e, present, variance, nominal, change, healthy, memory, at, settings, first)

   It returns the log density of a sample if the sensor has failed in this way. `drops` in ``mode_kernels.py`` and the table of
   ``docs/reference/extend.md`` describe the arguments and what the function may write. The places in its memory (`TRUST`, `SIZE`,
   ...) and `log_density` can be imported from here. The mathematics comes from `bayesftc.cosim.ops`, as in every step function;
3. return from the property ``first`` its numbers before the first sample (trust, size, further ones), and from
   ``settings(model, sensor)`` its settings for one sensor.

This suffices in Python: ``SwitchingPrecision([Glitching(), Offset()])``; ``docs/reference/extend.md`` has an example. Scenario
files and tests use `FAULT_MODES`; add the mode to it for them, to ``controllers/__init__.pyi``, and to the table of
``docs/explanation/precision.md`` with the default of each setting.

In the joint form a subclass of `Offset` is estimated together with the state, from its ``jump``, ``slope`` and ``walk``. Its
``evidence`` is then used only where another sensor already has an offset, or an actuator has failed. A mode with
``own_hypothesis = True`` is a subclass of `Unmodelled`, whose regression the joint form computes in place of its ``evidence``.

A mode with ``is_fault = False`` is harmless: it determines the sensor's precision, but its probability is no part of
``fault_probability``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bayesftc.controllers.linalg.special import LOG_2_PI
from bayesftc.controllers.models.checks import as_number, as_vector, check_number
from bayesftc.controllers.switching import mode_kernels as kernels
from bayesftc.controllers.switching.course import COURSE, COURSE_SCRATCH, ORDER
from bayesftc.controllers.switching.default_time import DefaultTime
from bayesftc.controllers.switching.mode_kernels import ENTERED, FACTOR, OWN, SIZE, TRUST, log_density
from bayesftc.cosim.ops import log, sqrt, square

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel


HEALTHY_REPEATS = 0.001
"""Default share of the samples that a healthy sensor repeats exactly."""

REPEATS_STRENGTH = 10.0
"""Weight of the expected share of repetitions, in samples."""

MOST_REPEATS = 0.6
"""Largest share that is learned; a sensor with more repetitions is frozen, or has a resolution that should be given."""

OFFSET_VARIANCES = 3
"""Number of the settings of `Offset` that are variances, the first ones."""


@dataclass(frozen=True)
class FaultMode:
    """Base of all fault modes.

    The default times are for samples 5 to 20 ms apart; `SwitchingPrecision.paced` adapts them to longer and shorter sample times.

    Parameters
    ----------
    time_to_fault : float
        Mean time in seconds until a healthy sensor fails in this way. The default is short enough to find faults soon. It is also
        long enough: with healthy sensors, even a fifth of it would increase the error by less than 1 %.
    time_to_recovery : float
        Mean time in seconds until it is healthy again.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from bayesftc.cosim.ops import log
    >>> from bayesftc import controllers
    >>> def any_value(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    ...     return settings[first]
    >>> @dataclass(frozen=True)
    ... class LooseContact(controllers.FaultMode):  # any value within a span of 200 units
    ...     evidence = any_value
    ...     def settings(self, model, sensor):
    ...         return (-log(200.0),)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([LooseContact(), controllers.Offset()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> for y in (0.1, -31.0, 75.2, 5.1):
    ...     out = step(y=[y, 0.0], u=0.0)
    >>> out.mode_probability[0].round(2).tolist()  # healthy, loose contact, offset
    [0.0, 1.0, 0.0]
    """

    time_to_fault: float = DefaultTime(300.0)
    time_to_recovery: float = DefaultTime(10.0)

    evidence: ClassVar[Callable[..., float]]
    arrival: ClassVar[float | None] = None
    """Share of the samples of a healthy sensor that arrive; None: all of them."""
    needs_witness: ClassVar[bool] = False
    """Whether only another healthy sensor can distinguish it from the state's motion (in the joint form)."""
    is_fault: ClassVar[bool] = True
    """Whether this mode counts as a fault of the sensor."""
    size_in_noise: ClassVar[bool] = False
    """Whether its size is a multiple of the standard deviation of the sensor's noise, and not in the sensor's unit."""
    size_from_belief: ClassVar[bool] = False
    """Whether this multiple is of the distance of the samples from the belief, in which a healthy sensor has about 1 as well."""
    own_hypothesis: ClassVar[bool] = False
    """Whether the joint form has a hypothesis for each sensor in this mode, which infers the state without that sensor."""
    joint_only: ClassVar[bool] = False
    """Whether it is used only where its offset is estimated together with the state."""

    def __post_init__(self) -> None:
        for name in ("time_to_fault", "time_to_recovery"):
            check_number(self, name, above=0)

    @property
    def size_scale(self) -> str:
        """What its size is in, see `PrecisionLearner.fault_sizes`; empty for a mode that is no fault."""
        if not self.is_fault:
            return ""
        return "distance" if self.size_from_belief else "noise" if self.size_in_noise else "unit"

    @property
    def first(self) -> tuple[float, ...]:
        """Its numbers for a sensor before the first sample: trust, size, and further ones."""
        return 0.0, nan

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """Return the settings of its step function for one sensor of a model."""
        return ()

    def alone(self, others: float) -> float:
        """Return the probability that no second fault begins with a sample, given the sum of the probabilities of all others.

        A faulty sensor fails in another way as often as a healthy one. The learner follows no second fault, but counts it. If it
        did not, a fault that changes nothing, as an offset of nearly zero, would become more probable with each sample at which a
        healthy sensor might have failed, and did not. A harmless mode must be short: nothing is counted during it.
        """
        return 1.0 - others if self.is_fault else 1.0


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
        Standard deviation of the dither, in units of the sensor's noise.
    resolution : float or sequence of float
        Resolution of the sensors in their unit, for all or for each. A healthy sensor of coarse resolution also repeats itself.
        With 0 it is learned, as the greatest common measure of the sensor's changes.
    healthy_repeats : float or sequence of float
        Expected share of the samples that a healthy sensor repeats exactly, for all sensors or for each. It is learned while the
        sensor is healthy; the expected share counts as ten samples. With 0 nothing is learned.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Frozen(), controllers.Offset()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((20, 2))
    >>> y[15:, 0] = y[15, 0]  # the first sensor freezes
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.mode_probability[0].round(2).tolist()  # healthy, frozen, offset
    [0.0, 1.0, 0.0]
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
            values = getattr(self, name)
            several = isinstance(values, list | tuple | np.ndarray)
            for value in values if several else (values,):
                as_number(f"Frozen has {name}", value, least=0, below=below)
            object.__setattr__(self, name, tuple(values) if several else values)

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        nominal = float(model.matrix("sensor_covariance")[sensor, sensor])
        resolution = as_vector("The resolution of Frozen", self.resolution, model.sensors)
        width = max(float(resolution[sensor]), 1e-9 * sqrt(nominal))
        spread = 2 * square(self.dither) * nominal + square(width) / 6
        near = log(1 - self.repeats) - 0.5 * (log(spread) + LOG_2_PI)
        return 0.5 * width, log(self.repeats / width), near, spread

    def healthy(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """Return the settings for the repetitions of a healthy sensor of a model.

        They are the width within which two samples count as equal, in the sensor's unit; the expected numbers of repetitions and
        of samples before the first one; the largest share that is learned; and 1 if the sensor may be coarser than that width,
        else 0.
        """
        half = self.settings(model, sensor)[0]
        has_resolution = as_vector("The resolution of Frozen", self.resolution, model.sensors)[sensor] > 0
        share = float(as_vector("healthy_repeats of Frozen", self.healthy_repeats, model.sensors)[sensor])
        most = 0.0 if share == 0 else max(MOST_REPEATS, share)
        finds = float(share > 0 and not has_resolution)
        return 2.0 * half, share * REPEATS_STRENGTH, REPEATS_STRENGTH, most, finds


@dataclass(frozen=True)
class Offset(FaultMode):
    """An unknown offset, which may drift, begins suddenly: injection and bias.

    By default jumps are twice as frequent as other faults, because many of them are short (`SwitchingPrecision`).

    The unit of ``jump``, ``slope`` and ``walk`` is the standard deviation of the sensor's noise. In the joint form it is the
    geometric mean of those of all sensors that measure the same (equal rows of C); with a separate unit for each sensor, a small
    offset would be attributed to the most accurate one.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    jump : float
        Standard deviation of the offset at its onset, or the first innovation if that is larger.
    slope : float
        Standard deviation of its rate per sample.
    walk : float
        Standard deviation of the offset's random walk per sample.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 1e-6, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Offset(), controllers.Noisier()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((30, 3))
    >>> y[15:, 0] += 0.5  # from 1.5 s on
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.mode_probability[0].round(1).tolist(), round(float(out.fault_size[0]), 1)  # healthy, offset, noisier
    ([0.0, 1.0, 0.0], 0.5)
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
        return square(self.jump), square(self.slope), square(self.walk), float(self.jump > 0)


@dataclass(frozen=True)
class Drifting(Offset):
    """An offset that begins at zero and grows slowly, without a jump.

    Parameters
    ----------
    time_to_fault, time_to_recovery, jump, slope, walk
        See `Offset`.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 1e-6, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Drifting()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((60, 3))
    >>> y[:, 0] += 0.2 * np.clip(0.1 * np.arange(60) - 2.0, 0.0, None)  # from 2 s on by 0.2 per second
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.fault_kind.tolist()  # 1: drifting
    [1.0, 0.0, 0.0]
    """

    time_to_fault: float = DefaultTime(300.0)
    jump: float = 0.0
    slope: float = 0.02
    walk: float = 0.0

    needs_witness: ClassVar[bool] = True


@dataclass(frozen=True)
class Ramping(Offset):
    """An offset that begins at zero and grows faster than a slow drift: after a few samples it exceeds the noise.

    It is used in the joint form only; in the per-sensor form an `Offset` is as good. A drift of several times `slope` per sample
    counts as `Unmodelled`: for drifts of 5 standard deviations per sample give ``slope=3``.

    Parameters
    ----------
    time_to_fault, time_to_recovery, jump, slope, walk
        See `Offset`.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 1e-6, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Ramping()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((30, 3))
    >>> y[:, 0] += 0.4 * np.clip(0.1 * np.arange(30) - 1.0, 0.0, None)  # from 1 s on by 0.4 per second
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.fault_probability.round(1).tolist(), round(float(out.fault_size[0]), 1)
    ([1.0, 0.0, 0.0], 0.7)
    """

    time_to_fault: float = DefaultTime(300.0)
    jump: float = 0.0
    slope: float = 0.3
    walk: float = 0.0

    joint_only: ClassVar[bool] = True


@dataclass(frozen=True)
class DroppedOut(FaultMode):
    """The sensor sends no samples.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    arrives : float
        In this mode, the share of the samples of a healthy sensor that still arrive.

    Examples
    --------
    >>> import math
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.DroppedOut()], loss=0.05)  # 5 % of the samples get lost
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> [round(float(step(y=[math.nan, 0.0]).fault_probability[0]), 2) for _ in range(4)]
    [0.0, 0.03, 0.36, 0.92]
    """

    arrives: float = 0.001

    evidence: ClassVar[Callable[..., float]] = kernels.drops

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "arrives", above=0, below=1)

    @property
    def arrival(self) -> float:  # type: ignore[override]
        """See `FaultMode.arrival`."""
        return self.arrives


@dataclass(frozen=True)
class Noisier(FaultMode):
    """The sensor's noise has another precision, gamma distributed and learned: the paper's learner as a mode.

    Parameters
    ----------
    time_to_fault, time_to_recovery
        See `FaultMode`.
    scale : float
        Expected standard deviation of the noise at the onset, in nominal ones.
    shape : float
        Shape of the gamma distribution at the onset; a smaller one means less prior knowledge.
    forgetting : float
        Forgetting factor in (0, 1] per sample.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Offset(), controllers.Noisier()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((80, 2))
    >>> y[30:, 0] *= 5.0  # the noise grows to five times the nominal one
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.mode_probability[0].round(1).tolist(), round(float(out.fault_size[0]), 1)  # healthy, offset, noisier
    ([0.0, 0.0, 1.0], 4.7)
    """

    scale: float = 4.0
    shape: float = 1.0
    forgetting: float = 0.98

    size_in_noise: ClassVar[bool] = True
    evidence: ClassVar[Callable[..., float]] = kernels.scatters

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number(self, "scale", above=0)
        check_number(self, "shape", above=0)
        check_number(self, "forgetting", above=0, most=1)

    @property
    def first(self) -> tuple[float, ...]:
        """See `FaultMode.first`."""
        return min(1.0 / square(self.scale), 1.0), self.scale, self.shape, self.shape * square(self.scale)

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        return self.shape, self.shape * square(self.scale), self.forgetting


@dataclass(frozen=True)
class Unmodelled(FaultMode):
    """The sensor has failed in a way without a mode of its own; the course of its samples is learned.

    Its innovations are a linear regression on a constant, on the last innovation and on the prediction, with noise of any scale.
    This fits a sensor that jumps to a constant, is frozen with a dither, filtered, late, swapped, oscillating or of another gain.
    A share of its samples repeats exactly, as with clipping. In the joint form each sensor has such a hypothesis, which infers
    the state without that sensor. The fault's size is the root mean square of the innovations, in nominal standard deviations.

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
        Factor per sample of the high-pass filter that removes the slow part of the prediction.
    means, deviations : sequence of float
        Means and standard deviations of the three coefficients at the onset: of the constant, of the last innovation, of the
        prediction. The standard deviations are in units of the regression's noise.
    repeats : float
        Expected share at the onset of samples that repeat exactly, between 0 and 1; it is learned (in the joint form).
    repeats_strength : float
        Weight of that share in samples.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Offset(), controllers.Unmodelled()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> y = 0.1 * np.random.default_rng(0).standard_normal((40, 3))
    >>> y[15:, 0] += np.sin(0.7 * np.arange(25))  # the first sensor oscillates
    >>> out = [step(y=sample) for sample in y][-1]
    >>> out.mode_probability[0].round(2).tolist()  # healthy, offset, unmodelled
    [0.0, 0.0, 1.0]
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
    size_in_noise: ClassVar[bool] = True
    size_from_belief: ClassVar[bool] = True
    evidence: ClassVar[Callable[..., float]] = kernels.regresses

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("scale", "shape", "repeats_strength"):
            check_number(self, name, above=0)
        check_number(self, "repeats", above=0, below=1)
        for name in ("forgetting", "fading"):
            check_number(self, name, above=0, most=1)
        for name in ("means", "deviations"):
            values = as_vector(f"The {name} of Unmodelled", getattr(self, name), ORDER)
            object.__setattr__(self, name, tuple(map(float, values)))
        for value in self.deviations:
            as_number("Unmodelled has deviations", value, above=0)

    @property
    def first(self) -> tuple[float, ...]:
        """See `FaultMode.first`."""
        return 0.0, self.scale, *[0.0] * (COURSE + COURSE_SCRATCH + 1), 1.0

    def settings(self, model: LinearModel, sensor: int) -> tuple[float, ...]:
        """See `FaultMode.settings`."""
        weights = [1.0 / square(deviation) for deviation in self.deviations]
        explained = sum(weight * square(mean) for weight, mean in zip(weights, self.means, strict=True))
        rate = self.shape * square(self.scale) + 0.5 * explained
        repeats = self.repeats * self.repeats_strength, self.repeats_strength
        return self.forgetting, self.fading, self.shape, rate, *self.means, *weights, *repeats


@dataclass(frozen=True)
class Burst(Noisier):
    """The noise increases for a moment, as that of a wheel on a bump; the sensor is not faulty.

    Samples of a burst have the same low precision as those of a noisier sensor; a burst differs only in its short duration.

    Parameters
    ----------
    time_to_fault, time_to_recovery : float
        Mean time in seconds between two bursts, and mean duration of one; by default at least three samples.
    scale, shape, forgetting
        See `Noisier`.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[1.0]], [[0.0]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> learner = controllers.SwitchingPrecision([controllers.Noisier(), controllers.Burst()])
    >>> step = controllers.StateEstimator(model, learner).online(compiled=False)
    >>> out = [step(y=[y, 0.0]) for y in (0.1, -0.1, 0.05, 0.9)][-1]
    >>> out.mode_probability[0].round(2).tolist()  # healthy, noisier, burst
    [0.0, 0.0, 0.99]
    >>> out.fault_probability.round(2).tolist()
    [0.0, 0.0]
    """

    time_to_fault: float = DefaultTime(5.0, usual_step=0.1)
    time_to_recovery: float = DefaultTime(0.3, usual_step=0.1)
    forgetting: float = 0.9

    is_fault: ClassVar[bool] = False


FAULT_MODES: tuple[type[FaultMode], ...] = (Frozen, Offset, Drifting, Ramping, Unmodelled, Noisier, DroppedOut, Burst)
"""To add a fault mode, write it by the rules above and list it here."""

__all__ = [
    "ENTERED",
    "FACTOR",
    "FAULT_MODES",
    "OWN",
    "SIZE",
    "TRUST",
    "Burst",
    "Drifting",
    "DroppedOut",
    "FaultMode",
    "Frozen",
    "Noisier",
    "Offset",
    "Ramping",
    "Unmodelled",
    "log_density",
]
