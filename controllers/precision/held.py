"""Precisions held at the values of a learner at one instant, in place of the learner in a linearization."""

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
"""The controller's common outputs that a learner writes, besides ``R``."""


def keep_held(sample, trust, memory, settings, work):
    """Use the held precisions; leave out a sensor with an infinite variance."""
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
    """Write the held values of the learner's further outputs."""
    begin = nominal.shape[0] * (nominal.shape[0] + 3)
    for i in range(begin, settings.shape[0]):
        outputs[first + i - begin] = settings[i]


@dataclass(frozen=True)
class HeldPrecision(PrecisionLearner):
    """Constant precisions, those of a learner at one instant.

    Parameters
    ----------
    settings : tuple of float
        The sensor covariance row by row, the outputs in `REPORTED`, and the learner's further outputs.
    ports : tuple of Port
        The learner's further outputs.
    actuator_modes : tuple
        The kinds of actuator faults that the learner distinguishes.
    """

    settings: tuple[float, ...]
    ports: tuple[Port, ...]
    actuator_modes: tuple[Any, ...] = ()

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        return Learner(keep_held, np.zeros(1), np.array(self.settings), ports=self.ports, report=report_held)


def hold_precision(block: Any, ports: tuple[Port, ...], outputs: Mapping[str, Floats]) -> Any:
    """Return a controller or an estimator with held precisions; the block itself if it learns nothing.

    Parameters
    ----------
    block : controller or estimator
        It has the setting ``precision``.
    ports : tuple of Port
        Its learner's further outputs.
    outputs : mapping of str to ndarray
        Its outputs at that instant.
    """
    if isinstance(block.precision, FixedPrecision):
        return block
    names = ("R", *REPORTED, *(port.name for port in ports))
    settings = np.concatenate([np.ravel(outputs[name]) for name in names])
    held = HeldPrecision(tuple(settings.tolist()), ports, tuple(block.precision.actuator_modes))
    return replace(block, precision=held)
