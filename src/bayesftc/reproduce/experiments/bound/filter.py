"""The best possible detector if only the times of the faults are unknown: the exact posterior, by particles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import log, log1p
from typing import Any

import numpy as np

from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.bound import kernels
from bayesftc.reproduce.settings import Car, Detection
from bayesftc.reproduce.shared.streams import KINDS, Faults

MOST_SENSORS = 3


@dataclass(frozen=True)
class PosteriorFilter:
    """A Rao-Blackwellised particle filter over the modes of all sensors, with their onsets.

    Like `SwitchingPrecision` in this experiment it has the mean times to faults and recovery; in addition it has the faults'
    sizes. Modes are discrete, so no proposal is needed: each hypothesis branches into all its successors, the odds are summed
    over these, and then their number is reduced (Fearnhead and Clifford 2003). Each hypothesis has a Kalman filter of the plant's
    state, which is exact: all else is linear and normally distributed. A hypothesis is about all sensors, so they are judged
    together. Without reduction and merging this is the exact posterior.

    By the lemma of Neyman and Pearson no function of the same samples ranks faulty samples above healthy ones more often. The
    control has no effect as long as it is known: the loop's response to it is subtracted. A frozen sensor shows by repetition.

    Raises
    ------
    ModelError
        If there are more than three sensors, or they have a resolution.
    """

    settings: Detection
    car: Car
    faults: Faults  # the true sizes
    particles: int  # number of hypotheses that are kept
    # Distance within which hypotheses with the same modes and ages are merged, in standard deviations of the state. They differ
    # only in the distant past and predict the same. Without merging most particles are nearly equal, and important ones are lost.
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        if self.car.sensors > MOST_SENSORS:
            raise ModelError(
                f"There are {self.car.sensors} sensors. The bound supports at most {MOST_SENSORS}, because of the number of "
                "hypotheses."
            )
        if self.car.resolution:
            raise ModelError(
                "The sensors have a resolution. The bound needs sensors that repeat a sample only when frozen: set it to 0."
            )

    def log_odds(self, y: Floats, u: Floats, seed: int = 0) -> Floats:
        """Return the log odds of a fault of each sensor at each step, infinite if it is certain, in the shape of `y`.

        `y` (steps x sensors) has the samples at the controller, `u` (steps) the control from each step on. `seed` is the seed of
        the resampling.
        """
        steps, sensors = y.shape
        capacity = self.particles * 3**sensors
        floats = np.zeros((2, 3, capacity))
        floats[0, 1:, 0] = self.settings.offset, self.car.initial_variance
        codes = np.zeros((2, sensors, capacity), dtype=np.int64)
        found = np.empty((steps, sensors))
        uniform = np.random.default_rng(check_seed(seed)).random(steps)
        arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in (y, u, uniform, self._model())]
        table, keys = np.empty(4 * capacity + 1, dtype=np.int64), np.empty(capacity, dtype=np.int64)
        _compiled()(*arrays, self.particles, self.tolerance, floats, codes, np.empty(capacity), table, keys, found)
        return found

    def _model(self) -> Floats:
        s, car = self.settings, self.car
        fails, recovers = car.step / s.mean_time_to_fault, car.step / s.mean_time_to_recovery
        chances = log1p(-fails), log(fails / len(KINDS)), log(recovers), log1p(-recovers)
        sizes = self.faults.injection, self.faults.drift * car.step
        plant = 1.0 - car.drag / car.mass * car.step, car.step / car.mass, car.process_variance
        return np.array([*chances, car.sensor_variance, *sizes, *plant])


@cache
def _compiled() -> Any:
    from bayesftc.cosim.stepping.compiler import compile_function

    track: Any = kernels.track
    return compile_function(track, kernels.SIGNATURE)
