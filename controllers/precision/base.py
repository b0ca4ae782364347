"""Precision learners: what a controller believes about its sensors' noise, from sample to sample.

To write a precision learner you must:

1. make it a frozen dataclass of plain settings, a subclass of `PrecisionLearner`;
2. return from ``learner(model)`` a `Learner`: the learning step function, its memory before the first sample and its settings
   (flat arrays, for a learner that `ExplicitDetection` may wrap; its own are tables);
3. write the learning step function with exactly the arguments of `keep_nominal` below. It sees a `Sample`, updates ``memory``
   and writes a `Trust`. ``work`` is scratch space: as many m x m matrices as the `Learner` asks for, ``work[0]``, ``work[1]``,
   ...;
4. if it believes more than these outputs say (moments of the precision), name them as ``ports`` of the `Learner` and write
   them in a ``report`` function with the arguments of `report_nothing` below: they become outputs of the controller;
5. if its ``fault_probability`` is NaN, say why in ``why_no_probability``: ``bayesftc run`` prints that sentence;
6. if it has a rate for each sensor that `calibrate` is to make a probability of, make it a `RateLearner`, which says what that
   takes;
7. if it detects faults itself, name one of its ports ``detected``, of one number for each sensor (1: detected): ``bayesftc
   run`` takes it for the alarm where there is no probability;
8. if it infers something together with the state (``infer`` of the `Learner`), return from ``apart(who, instead)`` the learner
   without that, for controllers that learn apart from the state; if it learns the noise of healthy sensors, return from
   ``without_covariance()`` the learner that does not; one that wraps another learner passes both on; and if it tells faults of
   actuators, say by the field or property ``actuator_modes`` which, for they become signals and a table of a run;
9. if it calls back into Python, say ``compiled=False``: its controller then runs interpreted;
10. add it to `LEARNERS`, over which the tests run, to ``__init__.pyi``, and to the table of ``docs/precision.md``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.cosim.base.html import settings
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

NAN = float("nan")

ERROR_CAP = 1e12
"""Largest squared error, in units of the sensor's nominal variance, that is learned from."""

RATE_FLOOR = 1e-12
"""Least rate, in units of its prior: sensors that agree exactly for ever must not become infinitely precise."""

TOGETHER = "take a BayesianController with belief='filtered' or a StateEstimator"
"""What learns precisions together with the state."""


class Sample(NamedTuple):
    """What all m sensors say at one time, and what was expected of them; a learner reads it.

    Attributes
    ----------
    y : ndarray of m
        The samples; NaN where there is none.
    e : ndarray of m
        The innovations: samples minus what the belief expects; 0 where there is no sample.
    present : ndarray of m
        Whether there is a sample (1 or 0).
    spread : ndarray, m x m
        The belief's own uncertainty, as the sensors see it: C P C'.
    nominal : ndarray, m x m
        The sensor covariance of the model.
    """

    y: Floats
    e: Floats
    present: Floats
    spread: Floats
    nominal: Floats


class Trust(NamedTuple):
    """How far the sensors are trusted at one time; a learner writes it.

    Attributes
    ----------
    R : ndarray, m x m
        The sensor covariance for this very sample.
    used : ndarray of m
        Whether the update uses the sensor (1 or 0).
    precision, beta, fault_probability : ndarray of m
        The controller's outputs of these names.
    """

    R: Floats
    used: Floats
    precision: Floats
    beta: Floats
    fault_probability: Floats


def report_nothing(memory, settings, nominal, first, outputs):
    """Write no further outputs."""


@dataclass(frozen=True)
class Learner:
    """What a precision learner does for one model.

    Attributes
    ----------
    step : function
        The learning step function.
    memory, settings : ndarray
        Its initial memory and its settings: flat, for a learner that `ExplicitDetection` may wrap; its own are tables.
    work : int
        How many m x m matrices of scratch space it needs.
    ports : tuple of Port
        Further outputs that the controller gets from it.
    report : function
        Step function that writes these, one after the other, into ``outputs[first]``, ``outputs[first + 1]``, ...
    infer : function or None
        If it infers the state together with the faults: the step function (``make_infer`` in ``infer.py``) that controllers with
        a linear model then call instead of ``step`` and of Kalman's update. Others go on with ``step``.
    compiled : bool
        False for one that calls back into Python: its controller then runs interpreted, and cannot be exported.
    """

    step: Callable[..., None]
    memory: Floats
    settings: Floats
    work: int = 1
    ports: tuple[Port, ...] = ()
    report: Callable[..., None] = report_nothing
    infer: Callable[..., None] | None = None
    compiled: bool = True


@dataclass(frozen=True)
class PrecisionLearner:
    """Base of all precision learners and baselines: the part of a controller that decides how far each sensor is trusted."""

    def _repr_html_(self) -> str:
        """Return the settings as a table, for notebooks."""
        return settings(self)

    def learner(self, model: LinearModel) -> Learner:
        """Return the learner for a model.

        Raises
        ------
        ModelError
            If the settings do not fit the model.
        """
        raise TypeError(f"{type(self).__name__} does not say how it learns: give it a method learner(model).")

    def apart(self, who: str, instead: str = TOGETHER) -> PrecisionLearner:
        """Return it without what can only be inferred together with the state, for ``who`` learns precisions apart from it.

        Parameters
        ----------
        who : str
            What learns apart, as a sentence begins.
        instead : str
            What to do instead.

        Raises
        ------
        ModelError
            If just that was asked for.
        """
        return self

    def without_covariance(self) -> PrecisionLearner:
        """Return it without what it may learn only from a belief that has a covariance, for one that has none.

        There ``spread`` is zero, and what would be learned as noise of a healthy sensor is the belief's own error.
        """
        return self

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """Names of the kinds of sensor faults that it tells, as ``fault_kind`` numbers them from 1 on; none by default."""
        return ()

    @property
    def actuator_modes(self) -> Sequence[Any]:
        """The ways in which actuators can fail that it tells; none, unless a learner says so."""
        return ()

    @property
    def why_no_probability(self) -> str | None:
        """Why ``fault_probability`` is NaN, as a sentence, or None if it is not."""
        return None


def keep_nominal(sample, trust, memory, settings, work):
    """Trust every sensor as the model says."""
    for i in range(sample.y.shape[0]):
        for j in range(sample.y.shape[0]):
            trust.R[i, j] = sample.nominal[i, j]
        trust.used[i] = sample.present[i]
        trust.precision[i] = 1.0 / sample.nominal[i, i]
        trust.beta[i] = settings[0]
        trust.fault_probability[i] = settings[0]


@dataclass(frozen=True)
class FixedPrecision(PrecisionLearner):
    """The nominal sensor covariance at all times: a Kalman filter, no fault tolerance. ``beta`` and probability are NaN."""

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        return Learner(keep_nominal, np.zeros(1), np.array([np.nan]))

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return "FixedPrecision does not look for faults."
