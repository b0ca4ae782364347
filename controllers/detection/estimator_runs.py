"""Many runs of a state estimator at once, by its step functions on arrays over all runs.

If the model is true, the errors of an estimator do not depend on the plant's state and inputs. The plant therefore rests at zero,
and only errors are simulated: the belief's mean is the error of the belief, a sample is its sensor's noise and fault.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.estimator import StateEstimator
from bayesftc.controllers.estimation.innovation import slowest, steady_covariance
from bayesftc.cosim.stepping.batch_ops import OPERATIONS
from bayesftc.cosim.stepping.tracing import rebound
from bayesftc.cosim.types import argument_names

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.controllers.precision.gamma import GammaPrecision
    from bayesftc.cosim.types import Floats

WARM = 12.0
"""Settling time of the runs, in time constants of the slower one of filter and learner."""

MOST_STEPS = 5_000

THIN = 0.8
"""Runs with an alarm are removed when at most this share of the computed runs is without one."""


@dataclass(frozen=True)
class Fault:
    """A fault added to one sensor's samples: offset + slope * age + noise of a standard deviation, age in steps."""

    offset: float = 0.0
    slope: float = 0.0
    std: float = 0.0


class EstimatorRuns:
    """Runs of one estimator that have settled without a fault.

    Parameters
    ----------
    model : LinearModel
        The model, which is also the truth.
    precision : GammaPrecision
        The learner.
    sensor : int
        The faulty sensor.
    runs, seed : int
        Number of runs, and seed of their noise.
    noise : float, optional
        True variance of that sensor's noise; by default that of the model.
    """

    def __init__(
        self,
        model: LinearModel,
        precision: GammaPrecision,
        sensor: int,
        runs: int,
        seed: int,
        noise: float | None = None,
    ):
        P = steady_covariance(model)
        estimator = StateEstimator(model, precision, initial_covariance=P)
        definition = estimator.define(model.step)
        assert definition.output is not None
        assert definition.update is not None
        self._steps = [rebound(kernel, OPERATIONS) for kernel in (definition.output, definition.update)]
        self._names = [argument_names(kernel) for kernel in (definition.output, definition.update)]
        self._fixed: dict[str, Any] = {
            name: np.atleast_1d(np.asarray(value, float)) for name, value in definition.parameters.items()
        }
        ports = (*estimator.inputs, *estimator.outputs)
        initial = {
            **{port.name: np.zeros(port.shape) for port in ports},
            **{name: np.asarray(value, float) for name, value in {**definition.state, **definition.scratch}.items()},
            "outputs": np.zeros(sum(port.size for port in estimator.outputs)),
        }
        R = model.matrix("sensor_covariance").copy()
        if noise is not None:
            R[sensor, sensor] = noise
        self._sensor_root, self._process_root = np.linalg.cholesky(R), _root(model.matrix("process_covariance"))
        self._sensor, self._runs, self._seed = sensor, runs, seed
        remembered = float(precision.window or 0) or 1.0 / (1.0 - float(precision.forgetting or 0.0))
        self.warm_steps = min(int(WARM * max(remembered, 1.0 / (1.0 - slowest(model)))) + 1, MOST_STEPS)
        self._state = {name: _rows(np.atleast_1d(value), runs) for name, value in initial.items()}
        # The errors begin as those of the steady filter at nominal precision; only the learner's effect must settle.
        self._state["mean"] = _rows_of(_root(P) @ np.random.default_rng(seed).standard_normal((len(P), runs)))
        squares = spread = 0.0
        last = max(self.warm_steps // 4, 1)
        for k in range(self.warm_steps):
            self._advance(self._state, k, Fault(), 0, np.arange(runs))
            if k >= self.warm_steps - last:
                squares += float(np.mean(self._state["e"][sensor] ** 2)) / last
                spread += float(np.mean(self._state["spread"][sensor, sensor])) / last
        self.innovation_variance = squares
        """Mean square of the sensor's innovation without a fault."""
        self.spread = spread
        """Mean variance of its prediction, as estimated by the filter."""

    @property
    def beta(self) -> Floats:
        """Beta of every run at the last sample before the onset."""
        return np.asarray(self._state["beta"][self._sensor])

    def survival(self, fault: Fault, threshold: float, steps: int) -> Floats:
        """Return the share of runs without an alarm up to each sample after the onset, among those without one just before.

        It ends early when no run is left.
        """
        quiet = self.beta <= threshold
        state, kept, started = self._state, np.arange(self._runs), np.count_nonzero(quiet)
        state = {name: array.copy() for name, array in state.items()}
        shares: list[float] = []
        for age in range(steps if started else 0):
            if np.count_nonzero(quiet) <= THIN * len(
                kept
            ):  # removing every run at its alarm would take more time than it saves
                state, kept, quiet = (
                    _select_runs(state, quiet),
                    kept[quiet],
                    np.ones(np.count_nonzero(quiet), dtype=bool),
                )
            self._advance(state, self.warm_steps + age, fault, age, kept)
            quiet = quiet & (state["beta"][self._sensor] <= threshold)
            shares.append(np.count_nonzero(quiet) / started)
            if not shares[-1]:
                break
        return np.array(shares)

    def _advance(self, state: dict[str, Any], k: int, fault: Fault, age: int, kept: Any) -> None:
        """Advance some runs by one sample; the noise of a run does not depend on the other runs or the fault."""
        m, n = len(self._sensor_root), len(self._process_root)
        draw = np.random.default_rng([self._seed, k]).standard_normal((m + n + 1, self._runs))[:, kept]
        y = self._sensor_root @ draw[:m]
        if fault != Fault():
            y[self._sensor] += fault.offset + fault.slope * age + fault.std * draw[m + n]
        state["y"] = _rows_of(y)
        for step, names in zip(self._steps, self._names, strict=True):
            step(**{name: self._fixed[name] if name in self._fixed else state[name] for name in names})
        q = self._process_root @ draw[m : m + n]
        for i in range(n):
            state["mean"][i] = state["mean"][i] - q[i]


def without_map(precision: GammaPrecision) -> GammaPrecision:
    """Return the learner without its map to a probability, which is not needed here."""
    return replace(precision, calibration=None)


def _root(covariance: Floats) -> Floats:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _rows(array: Floats, runs: int) -> Any:
    result = np.empty(array.shape, dtype=object)
    for index in np.ndindex(array.shape):
        result[index] = np.full(runs, array[index])
    return result


def _rows_of(values: Floats) -> Any:
    result = np.empty(len(values), dtype=object)
    for i, row in enumerate(values):
        result[i] = row
    return result


def _select_runs(state: dict[str, Any], quiet: Any) -> dict[str, Any]:
    """Return some of the runs; values that are one number for all runs remain so."""
    selection = {}
    for name, array in state.items():
        result = np.empty(array.shape, dtype=object)
        for index in np.ndindex(array.shape):
            value = array[index]
            result[index] = value[quiet] if np.ndim(value) else value
        selection[name] = result
    return selection
