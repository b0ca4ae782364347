"""The step from samples to belief for linear models: precision and state one after the other, or inferred together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.estimation.absurd import Reading, Screen, mark_absurd, screening
from bayesftc.controllers.estimation.consistency import (
    MOTION,
    OBSERVER_BANK,
    Motion,
    ObserverBank,
    check_consistency,
    consistency,
    follow,
)
from bayesftc.controllers.estimation.filter import (
    Belief,
    ModelMatrices,
    UpdateSpace,
    innovate,
    measure,
    predict,
    restore,
)
from bayesftc.controllers.linalg.dense import apply
from bayesftc.controllers.precision.base import Sample, Trust
from bayesftc.cosim.ops import select
from bayesftc.cosim.stepping.records import named_alike

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.controllers.precision.base import Learner
    from bayesftc.cosim.types import Floats


class Actuators(NamedTuple):
    """The control that is ``applied``, and its effect on the plant.

    Each of the p controls acts with the effectiveness ``works`` and the offset ``load``. Their first rows are the expected
    values, their second rows those that the control law uses. ``effective`` is the effect of the applied control.
    """

    applied: Floats
    works: Floats
    load: Floats
    effective: Floats


class Learning(NamedTuple):
    """A precision learner's state, settings and scratch space."""

    memory: Floats
    settings: Floats
    work: Floats


class Estimation(NamedTuple):
    """All arrays of an estimator for a linear model.

    ``largest`` is the largest variance of a belief, ``reach`` that of a hypothesis, or negative if all hypotheses restart.
    ``CP`` is scratch space.
    """

    reading: Reading
    sample: Sample
    trust: Trust
    belief: Belief
    model: ModelMatrices
    actuators: Actuators
    learning: Learning
    screen: Screen
    bank: ObserverBank
    motion: Motion
    space: UpdateSpace
    largest: Floats
    reach: Floats
    CP: Floats


SAMPLE = named_alike(Sample, y="samples")
ESTIMATION = named_alike(
    Estimation,
    reading=named_alike(Reading),
    sample=SAMPLE,
    trust=named_alike(Trust),
    belief=named_alike(Belief),
    model=named_alike(ModelMatrices),
    actuators=named_alike(Actuators),
    learning=named_alike(Learning),
    screen=named_alike(Screen),
    bank=OBSERVER_BANK,
    motion=MOTION,
    space=named_alike(UpdateSpace, L="chol"),
)
"""Names of these arrays among the ports, state, parameters and scratch space of a block."""


def skip_learning(sample, trust, memory, settings, work):
    """Do nothing: the update infers precision and state together."""


@cache
def make_estimate(
    learn: Callable[..., None],
    infer: Callable[..., None] | None,
    report: Callable[..., None],
    alarm: Callable[..., None],
    first: int,
) -> Callable[..., None]:
    """Return the step function from samples to belief, for a learner's functions (see `Learner`).

    A learner's `infer` infers state and faults together, in place of learning and Kalman's update. The learner's outputs begin
    at the index `first` among all outputs.
    """
    if infer is None:

        def update(est):
            measure(est.sample.e, est.trust.used, est.trust.R, est.model.C, est.belief, est.space)

    else:
        learn = skip_learning

        def update(est):
            infer(est.sample, est.trust, est.belief, est.model, est.actuators, est.learning, est.reach)

    def estimate(outputs, est):
        apply(est.model.C, est.belief.mean, est.reading.expected)
        innovate(est.reading, est.sample, est.belief, est.screen, est.model.C, est.CP, est.largest, est.reach)
        learn(est.sample, est.trust, est.learning.memory, est.learning.settings, est.learning.work)
        restore(est.reading, est.sample)
        update(est)
        mark_absurd(est.screen, est.trust.fault_probability)
        report(est.learning.memory, est.learning.settings, est.sample.nominal, first, outputs)
        alarm(est.screen.doubts, outputs)
        check_consistency(est.sample.y, est.belief.x_hat, est.model.C, est.sample.nominal, est.bank)

    return estimate


def look_ahead(u, est):
    """Predict the belief at the next step with the input, or with the last one where the input is not finite."""
    for i in range(u.shape[0]):
        est.actuators.applied[i] = select(u[i] - u[i] == 0.0, u[i], est.actuators.applied[i])
    advance(est)


def advance(est):
    """Predict the belief at the next step, with the control that is applied."""
    actuate(est.actuators)
    follow(est.actuators.effective, est.model.B, est.bank, est.motion)
    predict(est.belief, est.actuators.effective, est.model, est.largest, est.space.J)


def estimation(
    block: Any, model: LinearModel, learner: Learner, largest: float, applied: Floats
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return state, parameters and scratch space of an estimator, without its ports.

    Parameters
    ----------
    block : controller or estimator
        It has the settings ``initial_mean``, ``initial_covariance``, ``precision`` and ``invalid``.
    model : LinearModel
        Model of plant and sensors.
    learner : Learner
        Learner of the precisions.
    largest : float
        The largest variance of a belief.
    applied : ndarray
        The control before the first step.
    """
    n, p, m = model.states, model.controls, model.sensors
    doubts, screen_parameters = screening(block, model)
    check = consistency(model, block.initial_mean)
    scratch = {
        "expected": (m,),
        "samples": (m,),
        "e": (m,),
        "present": (m,),
        "used": (m,),
        "spread": (m, m),
        "CP": (m, n),
        "reach": (1,),
        "chol": (m, m),
        "D": (m, n),
        "whitened": (m,),
        "v": (n,),
        "gain": (n,),
        "J": (n, n),
        "JP": (n, n),
        "effective": (p,),
        "work": (learner.work, m, m),
        **check.scratch,
    }
    state = {
        "mean": block.initial_mean,
        "covariance": block.initial_covariance,
        "applied": applied,
        "memory": learner.memory,
        "works": np.ones((2, p)),
        "load": np.zeros((2, p)),
    }
    parameters = {name: model.matrix(name) for name in "ABC"} | {
        "Q": model.matrix("process_covariance"),
        "nominal": model.matrix("sensor_covariance"),
        "settings": learner.settings,
        "largest": largest,
    }
    return (
        state | doubts | check.state,
        parameters | screen_parameters | check.parameters,
        {name: np.zeros(shape) for name, shape in scratch.items()},
    )


def plan(actuators, GB, decision):
    """Correct target and G B for the effectiveness and the offset of the actuators."""
    for i in range(decision.target.shape[0]):
        for j in range(actuators.works.shape[1]):
            decision.target[i] = decision.target[i] - GB[i, j] * actuators.load[1, j]
            decision.GB[i, j] = GB[i, j] * actuators.works[1, j]


def actuate(actuators):
    """Compute the effect of the applied control at the plant."""
    for j in range(actuators.applied.shape[0]):
        actuators.effective[j] = actuators.works[0, j] * actuators.applied[j] + actuators.load[0, j]
