"""The best that any detector can do on a stream whose faults are known but for their time: the exact posterior, by particles."""

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

    It knows what `SwitchingPrecision` is told (how often faults come and go) and, in addition, how large they are. Modes are
    discrete, so nothing is drawn from a proposal: each hypothesis branches into all that can follow from it, the odds are summed
    over these, and only then their number is reduced (Fearnhead and Clifford 2003). The plant's state is integrated by a Kalman
    filter for each hypothesis, which is exact: all else is linear and normally distributed. The sensors are judged together, for
    each hypothesis is about all of them. Without reduction and merging this is the exact posterior.

    By Neyman and Pearson's lemma nothing computed from the same samples ranks faulty above healthy ones more often. The control
    does not matter, as long as it is known: the loop's response to it is subtracted, and a frozen sensor is known by its
    repeating itself.

    Raises
    ------
    ModelError
        If there are more than three sensors, or they have a resolution.
    """

    # Of the experiment that the streams are from.
    settings: Detection
    car: Car
    faults: Faults  # their true sizes
    particles: int  # number of hypotheses that are kept
    # How far apart hypotheses with the same modes and ages are that are merged, in standard deviations of the state. They
    # differ in what is long past, and say the same of what is to come; without merging most particles repeat each other, and
    # those that matter are lost.
    tolerance: float = 0.1

    def __post_init__(self) -> None:
        if self.car.sensors > MOST_SENSORS:
            raise ModelError(
                f"There are {self.car.sensors} sensors; hypotheses about more than {MOST_SENSORS} together are too many to keep."
            )
        if self.car.resolution:
            raise ModelError(
                "The sensors have a resolution; the bound is for those that repeat themselves only when frozen."
            )

    def log_odds(self, y: Floats, u: Floats, seed: int = 0) -> Floats:
        """Return the log odds of a fault of each sensor at each step, infinite where it is certain; of the shape of `y`.

        `y` (steps x sensors) has the samples as they reach the controller, `u` (steps) the control from each step on; `seed` is
        that of the resampling.
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
