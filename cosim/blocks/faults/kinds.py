"""Faults as blocks that change one channel of a signal on its way to the receiver.

Between sensors and controller a fault is a sensor fault, between controller and plant an actuator fault, between a disturbance
and the plant a process fault. `closed_loop` has a setting for each. The sender has no information about the fault: the controller
computes with the control that it sent. Several faults of a signal are chained. A fault is *scheduled* (present while
``start <= t < stop``), or begins and ends at *random* in that window, as a two-state Markov chain. Its output ``active`` is the
ground truth for judging a detector.

To add a kind of fault you must:

1. write in ``kernels.py`` the function ``value(sample, held, age, chance, noise, settings)``, which returns the value of the
   faulty channel, by the rules for step functions (`Block`);
2. write here a frozen, keyword-only dataclass derived from `Fault`, with ``value = staticmethod(...)``. Its fields are
   numbers, the settings in the order of the function. A field's metadata has its unit; ``{u}`` is that of the signal;
3. list in its ``draws`` the random numbers that it uses: ``"chance"`` (uniform in (0, 1)), ``"noise"`` (standard
   normal);
4. if the value depends on earlier samples, set ``remembers = True``, return from ``memory(step)`` how many numbers it keeps,
   and give the function a seventh argument ``memory``. Override ``numbers`` if the function needs settings in steps;
5. override ``check`` if settings must be more than finite numbers;
6. put it into `FAULTS`, before `RandomFaults`, into ``cosim/__init__.pyi``, into
   ``docs/gallery_examples/3_faults/plot_every_fault.py`` and into the table of ``docs/explanation/concepts.md``; and with its
   formula in NumPy into `KINDS` of ``tests/cosim/blocks/faults/test_faults.py``. All other tests take the settings of the
   example in its docstring.

It is then available in random, scheduled and mixed faults, both engines and scenario files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from fractions import Fraction
from functools import partial
from math import inf, isfinite, isinf

import numpy as np

from bayesftc.cosim.base.numbers import real, reals
from bayesftc.cosim.block import Definition
from bayesftc.cosim.blocks.faults import kernels
from bayesftc.cosim.blocks.faults.base import Fault
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import Port

MOST_DELAY = 10_000_000
"""Largest number of samples in a `Delay`: 80 MB."""


@dataclass(frozen=True, kw_only=True)
class Freeze(Fault):
    """The channel keeps the last sample before the onset, to the bit, also a missing one.

    If the fault is present from the first step on, the channel keeps the first sample.

    Parameters
    ----------
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Freeze(start=0.2, stop=0.4, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u).y[0]) for u in (1.0, 2.0, 3.0, 4.0, 5.0)]
    [1.0, 2.0, 2.0, 2.0, 5.0]
    """

    value = staticmethod(kernels.frozen)


@dataclass(frozen=True, kw_only=True)
class Stuck(Fault):
    """The channel has the constant value `at`: a sensor at the end of its range, an actuator that is shut (0).

    Parameters
    ----------
    at : float
        Value of the channel, in the unit of the signal.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Stuck(sensor=1, at=0.0, start=0.1, channels=2).online(dt=0.1, compiled=False)
    >>> [fault(u=u).y.tolist() for u in ([1.0, 1.5], [2.0, 2.5])]
    [[1.0, 1.5], [2.0, 0.0]]
    """

    at: float = field(metadata={"unit": "{u}"})
    value = staticmethod(kernels.stuck)


@dataclass(frozen=True, kw_only=True)
class Injection(Fault):
    """``magnitude + amplitude * sin(2 pi age / period + phase)`` is added.

    The age is in seconds and counts from the onset, in whole steps.

    Parameters
    ----------
    magnitude : float
        Constant part of the added signal, in the unit of the signal.
    amplitude : float
        Amplitude of the sine, in the unit of the signal.
    period : float
        Time from one maximum to the next, in seconds.
    phase : float
        Phase at the onset, in radians.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Injection(magnitude=3.0, amplitude=1.0, period=0.4, channels=1).online(dt=0.1, compiled=False)
    >>> [round(float(fault(u=10.0).y[0]), 9) for _ in range(5)]
    [13.0, 14.0, 13.0, 12.0, 13.0]
    """

    magnitude: float = field(default=0.0, metadata={"unit": "{u}"})
    amplitude: float = field(default=0.0, metadata={"unit": "{u}"})
    period: float = field(default=1.0, metadata={"unit": "s"})
    phase: float = field(default=0.0, metadata={"unit": "rad"})
    value = staticmethod(kernels.injected)

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if self.period <= 0:
            raise ModelError(f"Injection has period={self.period!r}; it must be positive.")


@dataclass(frozen=True, kw_only=True)
class Bias(Fault):
    """A constant offset, `magnitude`, is added: from the beginning, or from `start` on.

    Parameters
    ----------
    magnitude : float
        The offset, in the unit of the signal.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Bias(magnitude=0.5, start=0.2, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=1.0).y[0]) for _ in range(4)]
    [1.0, 1.0, 1.5, 1.5]
    """

    magnitude: float = field(metadata={"unit": "{u}"})
    value = staticmethod(kernels.biased)


@dataclass(frozen=True, kw_only=True)
class Drift(Fault):
    """An offset that grows by `slope` each second.

    The offset is ``slope * age``. The age is the number of steps since the onset times the step size, so the first faulty
    sample is still right.

    Parameters
    ----------
    slope : float
        Growth of the offset per second.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Drift(slope=5.0, start=0.1, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=1.0).y[0]) for _ in range(4)]
    [1.0, 1.0, 1.5, 2.0]
    """

    slope: float = field(metadata={"unit": "{u}/s"})
    value = staticmethod(kernels.drifted)


@dataclass(frozen=True, kw_only=True)
class GainFault(Fault):
    """The sample is multiplied by `factor`. For an actuator, a factor below 1 is a loss of effectiveness.

    Parameters
    ----------
    factor : float
        The factor, without a unit.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.GainFault(factor=0.5, start=0.2, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=4.0).y[0]) for _ in range(4)]
    [4.0, 4.0, 2.0, 2.0]
    """

    factor: float
    value = staticmethod(kernels.scaled)


@dataclass(frozen=True, kw_only=True)
class Dropout(Fault):
    """Samples are missing: NaN.

    Parameters
    ----------
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Dropout(start=0.1, duration=0.2, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u).y[0]) for u in (1.0, 2.0, 3.0, 4.0)]
    [1.0, nan, nan, 4.0]
    """

    value = staticmethod(kernels.dropped)


@dataclass(frozen=True, kw_only=True)
class Spikes(Fault):
    """Outliers: at each step, with `probability`, `magnitude` is added with a random sign.

    With ``random_size`` each outlier is `magnitude` times a standard normal number instead. A uniform and a normal number are
    drawn at each step, whether there is an outlier or not. ``active`` is 1 between outliers as well.

    Parameters
    ----------
    magnitude : float
        Size of an outlier, in the unit of the signal.
    probability : float
        Probability of an outlier at a step, from 0 to 1.
    random_size : bool
        Whether sizes are normal numbers.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> sensor, fault = diagram.add(cosim.Constant(1.0)), diagram.add(cosim.Spikes(magnitude=5.0, channels=1), "fault")
    >>> diagram.connect(sensor["y"], fault["u"])
    >>> y = diagram.simulate(1000.0, seed=1)["fault.y"][:, 0]
    >>> float((y != 1.0).mean().round(2)), sorted(set(y.tolist()))
    (0.1, [-4.0, 1.0, 6.0])
    """

    magnitude: float = field(metadata={"unit": "{u}"})
    probability: float = 0.1
    random_size: bool = False
    value = staticmethod(kernels.spiked)
    draws = ("chance", "noise")

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if not 0 <= self.probability <= 1:
            raise ModelError(f"Spikes has probability={self.probability!r}; it must lie between 0 and 1.")


@dataclass(frozen=True, kw_only=True)
class NoiseIncrease(Fault):
    """Normal noise of standard deviation `std` is added to the sensor's noise: the variances add.

    Parameters
    ----------
    std : float
        Standard deviation of the added noise, in the unit of the signal; not negative.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> sensor = diagram.add(cosim.Gaussian(std=0.3), "sensor")
    >>> fault = diagram.add(cosim.NoiseIncrease(std=0.4, start=500.0, channels=1), "fault")
    >>> diagram.connect(sensor["y"], fault["u"])
    >>> y = diagram.simulate(1000.0, seed=1)["fault.y"]
    >>> float(y[:5000].std().round(2)), float(y[5000:].std().round(2))
    (0.31, 0.49)
    """

    std: float = field(metadata={"unit": "{u}"})
    value = staticmethod(kernels.noisier)
    draws = ("noise",)

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if self.std < 0:
            raise ModelError(f"NoiseIncrease has std={self.std!r}; it must not be negative.")


@dataclass(frozen=True, kw_only=True)
class NoiseGrowth(Fault):
    """Normal noise is added whose standard deviation grows by `slope` each second: a sensor that ages.

    The age counts from the onset, in whole steps. The variances of this noise and of the sensor's noise add.

    Parameters
    ----------
    slope : float
        Growth of the standard deviation per second.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> sensor, fault = diagram.add(cosim.Constant(0.0)), diagram.add(cosim.NoiseGrowth(slope=0.01, channels=1), "fault")
    >>> diagram.connect(sensor["y"], fault["u"])
    >>> run = diagram.simulate(1000.0, seed=1)
    >>> float(abs(run["fault.y"][:1000]).mean().round(1)), float(abs(run["fault.y"][-1000:]).mean().round(1))
    (0.4, 7.5)
    """

    slope: float = field(metadata={"unit": "{u}/s"})
    value = staticmethod(kernels.ageing)
    draws = ("noise",)

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if self.slope < 0:
            raise ModelError(f"NoiseGrowth has slope={self.slope!r}; it must not be negative.")


@dataclass(frozen=True, kw_only=True)
class Clipping(Fault):
    """Samples are limited to the range from `low` to `high`: a sensor that saturates.

    Parameters
    ----------
    low, high : float
        The limits, in the unit of the signal; by default there is none.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Clipping(high=2.0, start=0.1, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u).y[0]) for u in (3.0, 3.0, 1.0)]
    [3.0, 2.0, 1.0]
    """

    low: float = field(default=-inf, metadata={"unit": "{u}"})
    high: float = field(default=inf, metadata={"unit": "{u}"})
    value = staticmethod(kernels.clipped)

    def check(self) -> None:
        """See `Fault.check`."""
        if not self.low <= self.high:
            raise ModelError(f"Clipping has low={self.low!r} and high={self.high!r}; low must not be above high.")


@dataclass(frozen=True, kw_only=True)
class Rounding(Fault):
    """Samples are rounded to whole multiples of `resolution`, halves up: a sensor that has become coarse.

    Parameters
    ----------
    resolution : float
        Distance of two neighbouring values, in the unit of the signal; positive.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Rounding(resolution=0.5, start=0.1, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u).y[0]) for u in (1.2, 1.2, 1.25)]
    [1.2, 1.0, 1.5]
    """

    resolution: float = field(metadata={"unit": "{u}"})
    value = staticmethod(kernels.rounded)

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if self.resolution <= 0:
            raise ModelError(f"Rounding has resolution={self.resolution!r}; it must be positive.")


def _share(x: float) -> float:
    """Return 1 - exp(-x) of a positive number without cancellation (Kahan)."""
    left = exponential(-x)
    share = float(1.0 - left)
    if share == 0.0:
        return x
    return share * float(x / -logarithm(left)) if share < 1.0 else share


@dataclass(frozen=True, kw_only=True)
class Lag(Fault):
    """The channel is a low-pass filter of first order that starts at the last sample before the onset.

    At each step it moves by a share ``1 - exp(-step / time_constant)`` of the difference towards the sample. A sample that is
    missing or not finite passes through and does not change the filter's state.

    Parameters
    ----------
    time_constant : float
        Seconds, not negative; 0 for no lag.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Lag(time_constant=0.2, start=0.1, channels=1).online(dt=0.1, compiled=False)
    >>> [round(float(fault(u=u).y[0]), 3) for u in (0.0, 1.0, 1.0, 1.0)]
    [0.0, 0.393, 0.632, 0.777]
    """

    time_constant: float = field(metadata={"unit": "s"})
    value = staticmethod(kernels.lagging)
    remembers = True

    def check(self) -> None:
        """See `Fault.check`."""
        super().check()
        if self.time_constant < 0:
            raise ModelError(f"Lag has time_constant={self.time_constant!r}; it must not be negative.")

    def numbers(self, step: Fraction) -> tuple[float, ...]:
        """See `Fault.numbers`."""
        between = float(step * self.spacing)
        return (_share(between / self.time_constant) if self.time_constant else 1.0,)


@dataclass(frozen=True, kw_only=True)
class Delay(Fault):
    """The channel has the sample of `delay` seconds ago.

    If it is present during the whole run, it is the dead time of a sensor, or, as an input fault, that of an actuator. Tables and
    figures then do not count it as a fault. `loop.linear()` and the check of a model before a run include such delays.

    Parameters
    ----------
    delay : float
        Seconds, not negative; rounded to whole steps, or for a slow sensor to whole intervals between its samples.
    initial : float, optional
        Value of the channel until the first sample arrives, in the unit of the signal, NaN for a missing one; by default the
        first sample.
    sensor, start, stop, duration, latching, mean_time_to_fault, mean_time_to_recovery, channels, spacing, name
        See `Fault`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> fault = cosim.Delay(delay=0.2, start=0.2, channels=1).online(dt=0.1, compiled=False)
    >>> [float(fault(u=u).y[0]) for u in (1.0, 2.0, 3.0, 4.0, 5.0)]
    [1.0, 2.0, 1.0, 2.0, 3.0]
    """

    delay: float = field(metadata={"unit": "s"})
    initial: float | None = field(default=None, metadata={"unit": "{u}"})
    value = staticmethod(kernels.delayed)
    remembers = True

    def check(self) -> None:
        """See `Fault.check`."""
        if not isfinite(real(self.delay)):
            raise ModelError(f"Delay has delay={brief(self.delay)}; it must be a finite number of seconds.")
        if self.delay < 0:
            raise ModelError(f"Delay has delay={self.delay!r}; it must not be negative.")
        if self.initial is not None and isinf(real(self.initial)):
            raise ModelError(
                f"Delay has initial={brief(self.initial)}; it must be a number, or NaN for a missing sample."
            )

    @property
    def settings(self) -> tuple[float, ...]:
        """See `Fault.settings`; infinity stands for the first sample."""
        return real(self.delay), inf if self.initial is None else real(self.initial)

    def numbers(self, step: Fraction) -> tuple[float, ...]:
        """See `Fault.numbers`."""
        steps = self.delay / float(step)
        if steps > MOST_DELAY:
            raise ModelError(
                f"Delay has delay={self.delay!r}, which is {steps:.3g} steps; use at most {MOST_DELAY:,}. A fault that "
                "keeps the first sample for ever is a Freeze."
            )
        return (float(round(steps / self.spacing) * self.spacing), self.settings[1])

    def memory(self, step: Fraction) -> int:
        """See `Fault.memory`."""
        return int(self.numbers(step)[0]) + 2


@dataclass(frozen=True, kw_only=True)
class RandomFaults(Fault):
    """Faults of several kinds, one at a time: at each onset the kind is drawn.

    A further output ``kind`` is the number of the present kind, -1 for none.

    Parameters
    ----------
    kinds : sequence of Fault
        The kinds. Sensor, window, mean times and name are settings of the `RandomFaults`, not of a kind.
    weights : sequence of float, optional
        Relative frequencies of the kinds, in any unit; by default all are equal.
    mean_time_to_fault, mean_time_to_recovery : float, optional
        Mean times in seconds from the end of a fault to the next onset, and from the onset to the end.
    sensor, start, stop, duration, latching, channels, spacing, name
        See `Fault`.

    Raises
    ------
    ModelError
        If a setting is wrong, or a kind has its own sensor, window, mean times or name.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> kinds = [cosim.Freeze(), cosim.Bias(magnitude=3.0)]
    >>> fault = diagram.add(cosim.RandomFaults(kinds=kinds, weights=[3, 1], channels=1), "fault")
    >>> diagram.connect(diagram.add(cosim.Sine(1.0, 10.0))["y"], fault["u"])
    >>> kind = diagram.simulate(1000.0, seed=1)["fault.kind"]
    >>> {number: round(float((kind == number).mean()), 2) for number in (-1, 0, 1)}
    {-1: 0.87, 0: 0.1, 1: 0.03}
    """

    kinds: Sequence[Fault] = (Freeze(), Injection(magnitude=3.0), Drift(slope=5.0))
    weights: Sequence[float] | None = None
    mean_time_to_fault: float | None = 2.8
    mean_time_to_recovery: float | None = 0.4

    def check(self) -> None:
        """See `Fault.check`."""
        object.__setattr__(self, "kinds", tuple(self.kinds))
        if not self.kinds or not all(isinstance(k, Fault) and not isinstance(k, RandomFaults) for k in self.kinds):
            raise ModelError(
                "RandomFaults needs at least one kind of fault, such as kinds=(Freeze(), Drift(slope=5.0))."
            )
        for kind in self.kinds:
            for common in fields(Fault):
                allowed = {common.default, self.sensor} if common.name == "sensor" else {common.default}
                if getattr(kind, common.name) not in allowed:
                    raise ModelError(
                        f"RandomFaults has a {type(kind).__name__} with its own {common.name}={getattr(kind, common.name)!r}; "
                        f"give {common.name} to RandomFaults itself, or use that {type(kind).__name__} alone."
                    )
        if self.weights is not None:
            weights = reals(self.weights)
            if (
                weights.shape != (len(self.kinds),)
                or not np.isfinite(weights).all()
                or (weights < 0).any()
                or not weights.any()
            ):
                raise ModelError(
                    f"RandomFaults has weights={self.weights!r} for {len(self.kinds)} kinds; give one number for each kind, "
                    "none negative and at least one positive."
                )
            object.__setattr__(self, "weights", tuple(weights.tolist()))

    @property
    def settings(self) -> tuple[float, ...]:
        """The settings of all kinds, one kind after the other."""
        return tuple(value for kind in self.kinds for value in kind.settings)

    @property
    def drawn(self) -> tuple[str, ...]:
        """See `Fault.drawn`: those of all kinds, and one for the choice of the kind."""
        return "pick", *(name for kind in self.kinds for name in kind.draws)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``y``, ``active`` and ``kind``."""
        return (*super().outputs, Port("kind", description="Number of the kind of fault that is present, -1 for none"))

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        kinds = [replace(kind, spacing=self.spacing) for kind in self.kinds]
        settings = np.zeros((len(kinds), max(len(kind.settings) for kind in kinds) + 1))
        for row, kind in zip(settings, kinds, strict=True):
            row[: len(kind.settings)] = kind.numbers(step)
        weights = np.ones(len(self.kinds)) if self.weights is None else np.asarray(self.weights)
        parameters = {"settings": settings, "shares": np.cumsum(weights) / np.cumsum(weights)[-1]}
        memory = np.zeros((len(kinds), max(kind.memory(step) for kind in kinds)))
        kernel = partial(kernels.several_kinds, tuple(kind.kernel() for kind in self.kinds))
        records = {"draws": kernels.SEVERAL, "course": kernels.COURSE, "mixture": kernels.KINDS}
        remembers = any(kind.remembers for kind in self.kinds)
        return self.assembled(kernel, kernels.slow_kinds, step, parameters, memory, remembers, records, chosen=0.0)


FAULTS: tuple[type[Fault], ...] = (
    Freeze,
    Stuck,
    Injection,
    Bias,
    Drift,
    GainFault,
    Dropout,
    Spikes,
    NoiseIncrease,
    NoiseGrowth,
    Clipping,
    Rounding,
    Lag,
    Delay,
    RandomFaults,
)
"""All kinds; the last one mixes the others."""

__all__ = ["FAULTS", "Fault", *(fault.__name__ for fault in FAULTS)]
