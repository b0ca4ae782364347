"""Precision learners: the estimation of the sensors' noise from sample to sample.

To write a precision learner you must:

1. make it a frozen dataclass of plain settings, a subclass of `PrecisionLearner`;
2. return from ``learner(model)`` a `Learner`: the learning step function, its memory before the first sample and its settings.
   These are flat arrays for a learner that `ExplicitDetection` may wrap; the learner of `ExplicitDetection` has tables;
3. write the learning step function with exactly the arguments of `keep_nominal` below. It reads a `Sample`, updates ``memory``
   and writes a `Trust`. ``work`` is scratch space: ``work[0]``, ``work[1]``, ... are the m x m matrices that the `Learner` asks
   for;
4. if it has further results (moments of the precision), name them as ``ports`` of the `Learner` and write them in a ``report``
   function with the arguments of `report_nothing` below. They become outputs of the controller;
5. if its ``fault_probability`` is NaN, give the reason in ``why_no_probability``; ``bayesftc run`` prints that sentence;
6. if it has a rate for each sensor that `calibrate` should map to a probability, make it a `RateLearner`;
7. if it detects faults, name one of its ports ``detected``, with a number for each sensor (1: detected). ``bayesftc run`` uses it
   as the alarm if there is no probability;
8. if it judges missing samples, return from ``for_rates(every, before)`` the learner that expects those between the samples of
   a slow sensor. If it infers something together with the state (``infer`` of the `Learner`), return from
   ``apart(who, instead)`` the learner without that, for controllers that learn apart from the state. If it learns the noise of
   healthy sensors, return from ``without_covariance()`` the learner that does not. A learner that wraps another passes all
   three on. If it infers actuator faults, list them in the field or property ``actuator_modes``; they become signals and a
   table of a run;
9. if it calls Python code that cannot be compiled, set ``compiled=False``; its controller then runs interpreted;
10. add it to `LEARNERS` and to ``controllers/__init__.pyi``; to the table of ``docs/explanation/precision.md`` and to
    ``docs/gallery_examples/4_learners/plot_every_learner.py``. Tests take it with its default settings; further ones belong to
    `EXAMPLES` of ``tests/controllers/precision/test_precision.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from bayesftc.cosim.base.arguments import NamedArguments
from bayesftc.cosim.base.html import settings
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel

NAN = float("nan")

_Block = TypeVar("_Block")

ERROR_CAP = 1e12
"""Largest squared error for learning, in units of the sensor's nominal variance."""

RATE_FLOOR = 1e-12
"""Least rate, in units of its prior, so that sensors that always agree exactly do not become infinitely precise."""

TOGETHER = "use a BayesianController with belief='filtered' or a StateEstimator"
"""Advice: the blocks that learn precisions together with the state."""


class Sample(NamedTuple):
    """Samples of all m sensors at one time and their predictions; a learner reads it.

    Attributes
    ----------
    y : ndarray of m
        The samples; NaN where there is none.
    e : ndarray of m
        The innovations, samples minus predictions; 0 where there is no sample.
    present : ndarray of m
        Whether there is a sample (1 or 0).
    spread : ndarray, m x m
        The belief's uncertainty in the sensors' units: C P C'.
    nominal : ndarray, m x m
        The sensor covariance of the model.
    """

    y: Floats
    e: Floats
    present: Floats
    spread: Floats
    nominal: Floats


class Trust(NamedTuple):
    """Precisions of the sensors at one time; a learner writes it.

    Attributes
    ----------
    R : ndarray, m x m
        The sensor covariance for this sample.
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
    """A precision learner for one model: its step functions, memory and settings.

    Attributes
    ----------
    step : function
        The learning step function.
    memory, settings : ndarray
        Its initial memory and its settings, as flat arrays; those of `ExplicitDetection` are tables.
    work : int
        Number of m x m matrices of scratch space.
    ports : tuple of Port
        Further outputs of the controller.
    report : function
        Step function that writes the further outputs one after the other, into ``outputs[first]``, ``outputs[first + 1]``, ...
    infer : function or None
        If it infers the state together with the faults: the step function (``make_infer`` in ``infer.py``) that controllers with
        a linear model call in place of ``step`` and Kalman's update. Other controllers call ``step``.
    compiled : bool
        False if it calls Python code that cannot be compiled: its controller then runs interpreted, and cannot be exported.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> learner = controllers.GammaPrecision().learner(model)
    >>> [port.name for port in learner.ports], learner.compiled
    (['precision_shape', 'precision_rate', 'precision_mean', 'precision_mode', 'precision_variance'], True)
    """

    step: Callable[..., None]
    memory: Floats
    settings: Floats
    work: int = 1
    ports: tuple[Port, ...] = ()
    report: Callable[..., None] = report_nothing
    infer: Callable[..., None] | None = None
    compiled: bool = True


def made_once(learner_of: Callable[[_Block], Learner]) -> Callable[[_Block], Learner]:
    """Let a method of a block make the learner at the first call and keep it: each look at the block's ports asks for it.

    A copy of the block, also in another process, makes its own: not every step function can be pickled.
    """
    learners: WeakKeyDictionary[_Block, Learner] = WeakKeyDictionary()

    @wraps(learner_of)
    def kept(block: _Block) -> Learner:
        if block not in learners:
            learners[block] = learner_of(block)
        return learners[block]

    return kept


@dataclass(frozen=True)
class PrecisionLearner(NamedArguments):
    """Base of all precision learners and baselines: the part of a controller that sets the weight of each sensor.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> def clip(sample, trust, memory, settings, work):
    ...     for i in range(sample.y.shape[0]):
    ...         trust.R[i, i] = sample.nominal[i, i] + sample.e[i] * sample.e[i]
    ...         trust.used[i] = sample.present[i]
    ...         trust.precision[i] = 1.0 / trust.R[i, i]
    ...         trust.beta[i] = trust.fault_probability[i] = settings[0]
    >>> @dataclass(frozen=True)
    ... class Doubtful(controllers.PrecisionLearner):  # adds the squared innovation to the variance
    ...     def learner(self, model):
    ...         return controllers.Learner(clip, np.zeros(1), np.array([np.nan]))
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, Doubtful()).online(compiled=False)
    >>> step(y=[0.0, 3.0], u=0.0).precision.round(2).tolist()
    [25.0, 0.11]
    """

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
        raise TypeError(f"{type(self).__name__} has no method learner(model); give it one.")

    def apart(self, who: str, instead: str = TOGETHER) -> PrecisionLearner:
        """Return the learner without results that need joint inference with the state, which ``who`` does not do.

        Parameters
        ----------
        who : str
            The block that learns apart from the state, as the beginning of a sentence.
        instead : str
            The remedy, as the end of a sentence.

        Raises
        ------
        ModelError
            If the settings require joint inference.
        """
        return self

    def without_covariance(self) -> PrecisionLearner:
        """Return the learner without results that need a belief with a covariance, for a controller whose belief has none.

        There ``spread`` is zero, so that learned noise of a healthy sensor would include the belief's error.
        """
        return self

    def for_rates(self, every: Sequence[int], before: Sequence[int]) -> PrecisionLearner:
        """Return the learner for slow sensors; most learners need no change, because a missing sample is no evidence for them.

        Parameters
        ----------
        every : sequence of int
            For each sensor the number of samples of the controller from one sample of the sensor to the next.
        before : sequence of int
            The numbers that this learner is for.
        """
        return self

    @property
    def fault_kinds(self) -> tuple[str, ...]:
        """Names of the kinds of sensor faults that it distinguishes, which ``fault_kind`` numbers from 1; none by default."""
        return ()

    @property
    def fault_sizes(self) -> tuple[str, ...]:
        """In what the size of each of `fault_kinds` is given; empty without kinds.

        The ``"unit"`` of the sensor, multiples of its ``"noise"``, or the ``"distance"`` from the belief in such multiples.
        """
        return ()

    @property
    def offset_kinds(self) -> tuple[str, ...]:
        """Names of those of `fault_kinds` that are an offset, constant or growing; none by default."""
        return ()

    @property
    def actuator_modes(self) -> Sequence[Any]:
        """The kinds of actuator faults that it distinguishes; none by default."""
        return ()

    @property
    def why_no_probability(self) -> str | None:
        """The reason why ``fault_probability`` is NaN, as a sentence; None if it is not."""
        return None


def keep_nominal(sample, trust, memory, settings, work):
    """Use the model's sensor covariance."""
    for i in range(sample.y.shape[0]):
        for j in range(sample.y.shape[0]):
            trust.R[i, j] = sample.nominal[i, j]
        trust.used[i] = sample.present[i]
        trust.precision[i] = 1.0 / sample.nominal[i, i]
        trust.beta[i] = settings[0]
        trust.fault_probability[i] = settings[0]


@dataclass(frozen=True)
class FixedPrecision(PrecisionLearner):
    """The nominal sensor covariance at all times: a Kalman filter without fault tolerance. ``beta`` and probability are NaN.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 0.001, 0.04, dt=0.1)
    >>> step = controllers.StateEstimator(model, controllers.FixedPrecision()).online(compiled=False)
    >>> out = step(y=[1.0, 5.0], u=0.0)  # a wrong sensor has its full weight
    >>> out.precision.tolist(), out.x_hat.round(2).tolist()
    ([25.0, 25.0], [2.94])
    """

    def learner(self, model: LinearModel) -> Learner:
        """See `PrecisionLearner.learner`."""
        return Learner(keep_nominal, np.zeros(1), np.array([np.nan]))

    @property
    def why_no_probability(self) -> str | None:
        """See `PrecisionLearner.why_no_probability`."""
        return "FixedPrecision does not infer faults."
