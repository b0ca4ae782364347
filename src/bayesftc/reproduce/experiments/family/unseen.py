"""Random cases of the family: plant, sensors, faults, sizes and times depend on a seed.

They serve for evaluation; no setting of a learner is tuned on them. A new kind of fault in `KINDS`
changes the cases of every seed: measure the published table again, or name the kind among those left out, in the test.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np

from bayesftc import cosim
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.random import check_seed
from bayesftc.reproduce.experiments.family.cases import CAR, PLANTS, Case, added_noise

SENSORS = (2, 3)
"""Possible numbers of sensors of each measured output."""
TWO = 0.2
"""Share of the cases with faults of two sensors."""
LATEST = 0.8
"""Share of a run after which no fault begins."""
LENGTHS = (0.05, 0.8)
"""Shortest and longest fault, as shares of a run."""
DIGITS = 3
"""Significant digits of every random number, so that cases are readable."""

RANGES: Mapping[str, tuple[tuple[float, float], ...]] = {
    CAR: ((15.0, 25.0),),
    "servo": ((-0.5, 0.5),),
    "masses": ((0.0, 0.5), (0.0, 0.5)),
    "pendulum": ((0.0, 0.3), (-0.04, 0.04)),
    "turbine": ((0.6, 0.7),),
    "arm": ((-1.87, -1.27), (-0.003, 0.003)),
}
"""Approximate range of each measured output of a plant with healthy sensors."""


@dataclass(frozen=True)
class Draw:
    """Random numbers for a fault of one sensor."""

    random: np.random.Generator = field(repr=False)
    sd: float  # standard deviation of the sensor
    # Range of its output.
    low: float
    high: float

    def uniform(self, low: float, high: float) -> float:
        """Return a uniform number of a range."""
        return rounded(self.random.uniform(low, high))

    def size(self, low: float, high: float) -> float:
        """Return a positive number of a range, with a uniform logarithm."""
        return rounded(exponential(self.random.uniform(logarithm(low), logarithm(high))))

    def sds(self, low: float, high: float) -> float:
        """Return such a number in standard deviations of the sensor, in the sensor's unit."""
        return rounded(self.size(low, high) * self.sd)

    def either(self, *of: Any) -> Any:
        """Return one of several values."""
        return of[int(self.random.integers(len(of)))]


def rounded(value: float) -> float:
    """Return a number with few digits."""
    return float(f"{value:.{DIGITS}g}")


def _injection(draw: Draw) -> dict[str, float]:
    constant = {"magnitude": draw.either(-1, 1) * draw.sds(0.5, 30)}
    swings = {"amplitude": draw.sds(0.5, 30), "period": draw.size(0.1, 10), "phase": draw.uniform(0, 2 * np.pi)}
    return draw.either(constant, swings, {**constant, **swings})  # type: ignore[no-any-return]


def _spikes(draw: Draw) -> dict[str, Any]:
    sizes = {"magnitude": draw.sds(3, 100), "probability": draw.size(0.01, 0.3)}
    return {**sizes, "random_size": draw.either(False, True)}


def _clipping(draw: Draw) -> dict[str, float]:
    return {draw.either("low", "high"): draw.uniform(draw.low, draw.high)}


KINDS: Mapping[type[cosim.Fault], Callable[[Draw], dict[str, Any]]] = {
    cosim.Freeze: lambda draw: {},
    cosim.Stuck: lambda draw: {"at": draw.uniform(2 * draw.low - draw.high, 2 * draw.high - draw.low)},
    cosim.Injection: _injection,
    cosim.Bias: lambda draw: {"magnitude": draw.either(-1, 1) * draw.sds(0.5, 30)},
    cosim.Drift: lambda draw: {"slope": draw.either(-1, 1) * draw.sds(0.3, 30)},
    cosim.GainFault: lambda draw: {"factor": draw.uniform(-1, 2)},
    cosim.Dropout: lambda draw: {},
    cosim.Spikes: _spikes,
    cosim.NoiseIncrease: lambda draw: {"std": rounded(added_noise(draw.size(1.5, 30)) * draw.sd)},
    cosim.NoiseGrowth: lambda draw: {"slope": draw.sds(0.3, 30)},
    cosim.Clipping: _clipping,
    cosim.Rounding: lambda draw: {"resolution": draw.sds(0.5, 30)},
    cosim.Lag: lambda draw: {"time_constant": draw.size(0.03, 3)},
    cosim.Delay: lambda draw: {"delay": draw.size(0.03, 3)},
}
"""The random settings of each kind of fault; a bias is present from the first step on. Sizes are from half a standard deviation,
below which a fault has little effect, to thirty; times are from a sample or two to a large part of a run."""


def unseen_cases(seed: int) -> Iterator[Case]:
    """Give an endless sequence of cases, the same for the same seed; the noise of the runs has separate seeds."""
    check_seed(seed)
    for number in count(1):
        random = np.random.default_rng([seed, number])
        name = Draw(random, 1.0, 0.0, 1.0).either(*PLANTS)
        sensors = int(random.choice(SENSORS))
        total = sensors * len(PLANTS[name].measured)
        failing = random.permutation(total)[: 1 + int(random.random() < TWO)]
        faults = tuple(_fault(random, name, int(sensor)) for sensor in failing)
        words = " and ".join(f"{type(f).__name__} of {f.sensor}" for f in faults)
        yield Case(f"unseen {number}: {name}, {total} sensors, {words}", faults, plant=name, sensors=sensors)


def _fault(random: np.random.Generator, name: str, sensor: int) -> cosim.Fault:
    plant = PLANTS[name]
    output = sensor % len(plant.measured)
    draw = Draw(random, plant.std[output], *RANGES[name][output])
    kind = draw.either(*KINDS)
    start = 0.0 if kind is cosim.Bias else draw.uniform(plant.settled, LATEST * plant.duration)
    stop = rounded(start + draw.size(*LENGTHS) * plant.duration)
    return kind(sensor=sensor, start=start, stop=stop, **KINDS[kind](draw))  # type: ignore[no-any-return]
