"""A trained classifier as a block: from a controller's residuals to each sensor's fault probability."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from bayesftc.controllers.detection.residuals import INNOVATION, feature_names
from bayesftc.controllers.models.checks import check_number
from bayesftc.controllers.signals import port
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.ops import absolute, exp, isnan, log, select
from bayesftc.cosim.ports import Port

NAN = float("nan")


@dataclass(frozen=True)
class LogisticMap:
    """``p = 1 / (1 + exp(-(sum weight * ((x - shift) / scale) + intercept)))`` of each feature x, or of its logarithm.

    Parameters
    ----------
    weights, shift, scale : tuple of float
        One number for each feature.
    intercept : float
        The log-odds with all features at their shift.
    logarithm : bool
        Whether to use the logarithms of the features.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> beta_to_probability = controllers.LogisticMap((2.0,), (0.0,), (1.0,), intercept=-3.0, logarithm=True)
    >>> step = controllers.FaultMonitor(2, ("beta",), 0.5, beta_to_probability).online(dt=0.1, compiled=False)
    >>> step(beta=[1.0, 20.0]).fault_probability.round(3).tolist()
    [0.047, 0.952]
    """

    weights: tuple[float, ...]
    shift: tuple[float, ...]
    scale: tuple[float, ...]
    intercept: float
    logarithm: bool = False


def monitor_logistic(
    inputs, fault_probability, fault, magnitude, logarithm, shift, scale, weights, intercept, threshold
):
    """Write each sensor's probability and decision; NaN where an input is not finite."""
    m = fault_probability.shape[0]
    for i in range(m):
        total = intercept[0]
        for f in range(weights.shape[0]):
            x = inputs[f * m + i]
            x = select(magnitude[f] > 0.5, absolute(x), x)
            x = select(logarithm[f] > 0.5, log(x), x)
            total = total + weights[f] * ((x - shift[f]) / scale[f])
        for f in range(inputs.shape[0] // m):
            total = total + 0.0 * inputs[f * m + i]
        unknown = isnan(total)
        p = 1.0 / (1.0 + exp(-total))
        fault_probability[i] = select(unknown, NAN, p)
        fault[i] = select(unknown, NAN, select(p > threshold[0], 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class FaultMonitor(Block):
    """A trained classifier as a block; made by `FaultClassifier.block`.

    There is an input for each feature (m values, with the name of the controller's output). If ``innovation`` is not a feature,
    it is a further input that marks missing samples; unconnected, no sample is missing. Outputs are ``fault_probability`` (m) and
    ``fault`` (m; 1 where the probability is above the decision threshold), both NaN where a sample is missing. With a logistic
    map the block runs compiled; with any other classifier its diagram runs interpreted.

    Parameters
    ----------
    sensors : int
        Number m of sensors.
    features : tuple of str
        Names of the controller's outputs; ``innovation`` means its magnitude.
    threshold : float
        Decision threshold on the probability.
    classifier : LogisticMap or classifier
        The map, or a classifier with ``predict_proba`` for rows of features.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> rng = np.random.default_rng(0)
    >>> beta = np.concatenate([rng.gamma(2.0, 1.0, 500), rng.gamma(2.0, 10.0, 500)])[:, None]
    >>> classifier = controllers.FaultClassifier().fit(beta, np.arange(1000) >= 500)
    >>> step = classifier.block(sensors=2).online(dt=0.1, compiled=False)
    >>> step(beta=[2.0, 40.0]).fault.tolist()
    [0.0, 1.0]
    """

    sensors: int
    features: tuple[str, ...]
    threshold: float
    classifier: Any = field(repr=False)

    def __post_init__(self) -> None:
        check_number(self, "sensors", least=1, whole=True)
        check_number(self, "threshold", above=0, below=1)
        object.__setattr__(self, "sensors", int(self.sensors))
        object.__setattr__(self, "features", feature_names(self.features))
        if len(set(self.features)) < len(self.features):
            raise ModelError(f"FaultMonitor has features={self.features!r}; name each once.")

    @property
    def default_name(self) -> str:
        """See `Block.default_name`."""
        return "monitor"

    @property
    def inputs(self) -> tuple[Port, ...]:
        """The features, and ``innovation``."""
        ports = tuple(port(name, (self.sensors,)) for name in self.features)
        return ports if INNOVATION in self.features else (*ports, port(INNOVATION, (self.sensors,), default=0.0))

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs ``fault_probability`` and ``fault``."""
        return port("fault_probability", (self.sensors,)), port("fault", (self.sensors,))

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        magnitude = np.array([name == INNOVATION for name in self.features], dtype=np.float64)
        if not isinstance(self.classifier, LogisticMap):
            return Definition(_callback(self.classifier, magnitude, self.threshold), compiled=False)
        chosen = self.classifier
        parameters: dict[str, Any] = {
            "magnitude": magnitude,
            "logarithm": np.full(len(magnitude), float(chosen.logarithm)),
            "shift": chosen.shift,
            "scale": chosen.scale,
            "weights": chosen.weights,
            "intercept": chosen.intercept,
            "threshold": self.threshold,
        }
        return Definition(monitor_logistic, parameters=parameters)


def _callback(classifier: Any, magnitude: np.ndarray[Any, np.dtype[np.float64]], threshold: float) -> Any:
    count = len(magnitude)

    def monitor(inputs, fault_probability, fault):
        rows = inputs.reshape(-1, len(fault_probability)).T
        complete = np.isfinite(rows).all(axis=1)
        fault_probability[:] = fault[:] = NAN
        if complete.any():
            features = np.where(magnitude > 0.5, np.abs(rows[complete, :count]), rows[complete, :count])
            fault_probability[complete] = classifier.predict_proba(features)[:, 1]
            fault[complete] = fault_probability[complete] > threshold

    return monitor
