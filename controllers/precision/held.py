"""Precisions that are held where a learner has brought them: what stands for the learner in a linearization."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.precision.base import FixedPrecision, Learner, PrecisionLearner
from bayesftc.cosim.ops import select
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

REPORTED = ("precision", "beta", "fault_probability")
"""The outputs of a controller that a learner writes besides ``R`` and its own."""


def keep_held(sample, trust, memory, settings, work):
    """Trust every sensor as it is trusted where the learner is held; a sensor with an infinite variance is left out."""
    m = sample.y.shape[0]
    for i in range(m):
        for j in range(m):
            trust.R[i, j] = settings[m * i + j]
        finite = settings[m * i + i] - settings[m * i + i] == 0.0
        trust.used[i] = select(finite, sample.present[i], 0.0)
        trust.precision[i] = settings[m * m + i]
        trust.beta[i] = settings[m * (m + 1) + i]
        trust.fault_probability[i] = settings[m * (m + 2) + i]


def report_held(memory, settings, nominal, first, outputs):
    """Write the learner's own outputs as they are where it is held."""
    begin = nominal.shape[0] * (nominal.shape[0] + 3)
    for i in range(begin, settings.shape[0]):
        outputs[first + i - begin] = settings[i]


@dataclass(frozen=True)
class HeldPrecision(PrecisionLearner):
    """The trust in each sensor that a learner has at one instant, at all times.

    Parameters
    ----------
    settings : tuple of float
        The sensor covariance row by row, the outputs in `REPORTED`, and the learner's own.
    ports : tuple of Port
        The learner's own outputs.
    actuator_modes : tuple
        The ways in which actuators fail that the learner tells.
    """

    settings: tuple[float, ...]
    ports: tuple[Port, ...]
    actuator_modes: tuple[Any, ...] = ()

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        return Learner(keep_held, np.zeros(1), np.array(self.settings), ports=self.ports, report=report_held)


def hold_precision(block: Any, ports: tuple[Port, ...], outputs: Mapping[str, Floats]) -> Any:
    """Return a controller or an estimator in which the precision learner is held; itself if it learns nothing.

    Parameters
    ----------
    block : controller or estimator
        With the setting ``precision``.
    ports : tuple of Port
        Its learner's own outputs.
    outputs : mapping of str to ndarray
        What its outputs are at that instant.
    """
    if isinstance(block.precision, FixedPrecision):
        return block
    names = ("R", *REPORTED, *(port.name for port in ports))
    settings = np.concatenate([np.ravel(outputs[name]) for name in names])
    held = HeldPrecision(tuple(settings.tolist()), ports, tuple(block.precision.actuator_modes))
    return replace(block, precision=held)
