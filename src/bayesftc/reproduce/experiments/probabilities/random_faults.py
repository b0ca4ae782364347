"""Random faults of many kinds and sizes, one in each run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from bayesftc import cosim
from bayesftc.cosim.elementary import exponential, logarithm
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.settings import Probabilities


@dataclass(frozen=True)
class RandomFault:
    """A random fault of one sensor."""

    kind: str  # one of `KINDS`
    faults: tuple[cosim.Fault, ...]  # applied in this order

    def truth(self, time: Floats, sensors: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return whether the fault was present at each sample, of shape (steps, sensors)."""
        fault, faulty = self.faults[0], np.zeros((len(time), sensors), bool)
        start, stop = fault.times
        faulty[:, fault.sensor] = (start <= time) & (time < stop)
        return faulty


def _dithered(size: float, sign: float, period: float, **when: Any) -> tuple[cosim.Fault, ...]:
    return cosim.Freeze(**when), cosim.NoiseIncrease(std=size, **when)


KINDS: Mapping[str, Callable[..., tuple[cosim.Fault, ...]]] = {
    "freeze": lambda size, sign, period, **when: (cosim.Freeze(**when),),
    "freeze with dither": _dithered,
    "injection": lambda size, sign, period, **when: (cosim.Injection(magnitude=sign * size, **when),),
    "drift": lambda size, sign, period, **when: (cosim.Drift(slope=sign * size, **when),),
    "gain": lambda size, sign, period, **when: (cosim.GainFault(factor=size, **when),),
    "oscillation": lambda size, sign, period, **when: (cosim.Injection(amplitude=size, period=period, **when),),
    "noise": lambda size, sign, period, **when: (cosim.NoiseIncrease(std=sqrt(size * size - 1.0), **when),),
    "low-pass": lambda size, sign, period, **when: (cosim.Lag(time_constant=size, **when),),
}
"""Functions that make the faults of each kind from size, sign and period, for sensors with standard deviation 1."""


def random_fault(settings: Probabilities, lengths: tuple[float, float], sensors: int, seed: int) -> RandomFault:
    """Return a fault of random kind, size, onset and sensor, with a random length within `lengths`."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(exponential(rng.uniform(logarithm(low), logarithm(high))))

    kind, smallest, largest = settings.kinds[int(rng.integers(len(settings.kinds)))]
    size, sign, period = between(smallest, largest), float(rng.choice([-1.0, 1.0])), between(*settings.periods)
    start, length = float(rng.uniform(*settings.starts)), between(*lengths)
    when = {"sensor": int(rng.integers(sensors)), "start": start, "stop": start + length}
    return RandomFault(kind, KINDS[kind](size, sign, period, **when))
