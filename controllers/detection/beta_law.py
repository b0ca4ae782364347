"""The law of one sensor's beta: its distribution without a fault, and its first passage over a threshold with one.

Without a fault beta is ``floor + innovation variance / 2 * x``, where x is a sum of squares of standard normal numbers. Its
weights are 1, rho, rho**2, ... or, with a window, 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.detection.estimator_runs import MOST_STEPS, EstimatorRuns, Fault, without_map
from bayesftc.controllers.detection.passage import MOST_STEPS as LONGEST, Passage
from bayesftc.controllers.detection.weighted_chi_square import (
    Weights,
    equal_weights,
    geometric_weights,
    quantile,
    tails,
)
from bayesftc.controllers.estimation.innovation import ABSENT, Response, response, steady_covariance
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.precision.gamma import GammaPrecision

RAREST = 1e-13
"""The search for a threshold ends at this quantile."""


class BetaLaw(ABC):
    """The distribution of beta in steady state, and a threshold on it; subclasses compute the passage over it.

    Parameters
    ----------
    precision : GammaPrecision
        The learner.
    nominal, variance, spread : float
        Variances of the sensor (nominal), of the innovation, and of the prediction (added if `precision` has belief_uncertainty).
    dt : float
        Sample time in seconds.
    """

    def __init__(self, precision: GammaPrecision, nominal: float, variance: float, spread: float, dt: float):
        self.precision, self.variance, self.dt = precision, variance, dt
        added = 0.5 * spread if precision.belief_uncertainty else 0.0
        prior = precision.prior_shape * nominal
        if precision.window is not None:
            self.sum = equal_weights(int(precision.window))
        else:
            self.sum = geometric_weights(float(precision.forgetting or 0.0))
            prior = prior if precision.forget_to == "prior" else 0.0
        self.floor = prior + added * self.sum.mean
        self.mean_beta = self.floor + 0.5 * variance * self.sum.mean
        self.threshold = np.inf

    def exceedance(self, beta: float) -> float:
        """Return the probability that beta exceeds a value at a sample, without a fault."""
        return tails(2.0 * (beta - self.floor) / self.variance, self.sum)[1]

    def set_threshold(self, false_alarms: tuple[bool, float]) -> None:
        """Set the threshold from the probability per sample that an alarm begins (True), or that there is one (False)."""
        from scipy.optimize import brentq

        begins, probability = false_alarms
        if begins:
            low, high = quantile(0.4, self.sum), quantile(RAREST, self.sum)
            x = float(
                brentq(lambda x: np.log(_begins(self.precision, self.sum, x) / probability), low, high, rtol=1e-4)
            )
        else:
            x = quantile(probability, self.sum)
        self.threshold = self.floor + 0.5 * self.variance * x
        self.onset_of_alarms = _begins(self.precision, self.sum, x)
        """Probability that an alarm begins at a sample, without a fault."""

    @abstractmethod
    def detected(self, kind: str, size: float, steps: int) -> float:
        """Return the probability of an alarm at one of the first `steps` faulty samples."""

    @abstractmethod
    def mean_delay(self, kind: str, size: float) -> float:
        """Return the expected number of samples from the first faulty one to the first alarm."""


class WhiteLaw(BetaLaw):
    """The exact law for independent innovations and a learner with a forgetting factor."""

    faults: Response = ABSENT

    def set_threshold(self, false_alarms: tuple[bool, float]) -> None:
        """See `BetaLaw.set_threshold`."""
        super().set_threshold(false_alarms)
        x = 2.0 * (self.threshold - self.floor) / self.variance
        self._passage = Passage(float(self.precision.forgetting or 0.0), x)

    def _moments(self, kind: str, size: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance of the whitened innovation at each faulty sample."""
        zero, deviation = np.zeros(steps), self.variance**0.5
        if kind == "noise":
            return zero, 1.0 + size**2 / self.variance * self.faults.noise(steps)
        if kind == "drift":
            return size * self.dt / deviation * self.faults.drift(steps), zero + 1.0
        return size / deviation * self.faults.offset(steps), zero + 1.0

    def detected(self, kind: str, size: float, steps: int) -> float:
        """See `BetaLaw.detected`."""
        return 1.0 - float(self._passage.survival(*self._moments(kind, size, steps))[-1])

    def mean_delay(self, kind: str, size: float) -> float:
        """See `BetaLaw.mean_delay`."""
        lasting = kind != "drift" or size == 0.0
        steps = len(self.faults.mean) if lasting else LONGEST
        return self._passage.mean_delay(*self._moments(kind, size, steps), settles=lasting)


class SimulatedLaw(BetaLaw):
    """A law without closed form for the passage: times come from simulated runs of the estimator."""

    runs: EstimatorRuns

    def _survival(self, kind: str, size: float, steps: int) -> np.ndarray:
        fault = Fault(
            **{{"offset": "offset", "drift": "slope", "noise": "std"}[kind]: size * (self.dt if kind == "drift" else 1)}
        )
        return self.runs.survival(fault, self.threshold, steps)

    def detected(self, kind: str, size: float, steps: int) -> float:
        """See `BetaLaw.detected`."""
        return 1.0 - float(self._survival(kind, size, steps)[-1])

    def mean_delay(self, kind: str, size: float) -> float:
        """See `BetaLaw.mean_delay`; runs without an alarm are extrapolated with the alarm rate of the second half."""
        shares = self._survival(kind, size, MOST_STEPS)
        left, half = shares[-1], shares[len(shares) // 2]
        remainder = left * (len(shares) - len(shares) // 2) / np.log(half / left) if 0 < left < half else 0.0
        return float(shares.sum() + remainder)


def beta_law(precision: GammaPrecision, nominal: float, variance: float, dt: float, runs: int, seed: int) -> BetaLaw:
    """Return the law for a stream of independent innovations."""
    if precision.window is None:
        return WhiteLaw(precision, nominal, variance, 0.0, dt)
    law = SimulatedLaw(precision, nominal, variance, 0.0, dt)
    certain_model = LinearModel(
        [[0.0]], [[0.0]], [[1.0]], 0.0, nominal, 1
    )  # with a certain state the innovations are the samples
    law.runs = EstimatorRuns(certain_model, without_map(precision), 0, runs, seed, noise=variance)
    return law


def loop_law(
    precision: GammaPrecision, model: LinearModel, sensor: int, learning: bool, runs: int, seed: int
) -> BetaLaw:
    """Return the law for a sensor of a model, whose filter uses the learned precision or, without `learning`, the nominal one."""
    C, R = model.matrix("C"), model.matrix("sensor_covariance")
    spread, nominal = float(C[sensor] @ steady_covariance(model) @ C[sensor]), float(R[sensor, sensor])
    if learning:
        simulated = EstimatorRuns(model, without_map(precision), sensor, runs, seed)
        law = SimulatedLaw(precision, nominal, simulated.innovation_variance, simulated.spread, float(model.step))
        law.runs = simulated
        return law
    if precision.window is not None:
        raise ModelError("detectability does not support a window with learning=False; leave learning=True.")
    fixed = WhiteLaw(precision, nominal, nominal + spread, spread, float(model.step))
    fixed.faults = response(model, sensor)
    return fixed


def _begins(precision: GammaPrecision, sum_of: Weights, x: float) -> float:
    """Return the probability that the sum exceeds x at a sample but not at the one before, without a fault.

    With forgetting, the newest square z**2 lifts the decayed sum above x: E[Pr[(x - z**2) / rho < sum <= x]]. In a window the new
    square must be larger than the one that leaves.
    """
    from scipy.special import chdtr, chdtrc, gammaln, ndtr

    g, weights = np.polynomial.legendre.leggauss(48)
    if precision.window is None:
        rho, above = float(precision.forgetting or 0.0), tails(x, sum_of)[1]
        least, most = np.sqrt(x * (1.0 - rho)), min(np.sqrt(x), np.sqrt(x * (1.0 - rho)) + 12.0)
        z = least + 0.5 * (most - least) * (1.0 + g)
        lifted = np.array([tails((x - v * v) / rho, sum_of)[1] - above for v in z])
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        return float((most - least) * (weights * density * lifted).sum() + 2.0 * ndtr(-most) * (1.0 - above))
    shared = int(precision.window) - 1
    if shared == 0:
        return float(chdtr(1, x) * chdtrc(1, x))
    v = 0.5 * np.sqrt(x) * (1.0 + g)
    density = 2.0 * np.exp((shared - 1) * np.log(v) - 0.5 * v**2 - 0.5 * shared * np.log(2.0) - gammaln(0.5 * shared))
    remainder = x - v**2
    return float(0.5 * np.sqrt(x) * (weights * density * chdtr(1, remainder) * chdtrc(1, remainder)).sum())
