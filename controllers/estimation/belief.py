"""How a linear controller comes from the samples to its belief: precision learned and then used, or both inferred together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayesftc.controllers.estimation.absurd import Reading, Screen, blame, screening
from bayesftc.controllers.estimation.consistency import SEERS, Seers, check_consistency, consistency, follow
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
    """The control that is ``applied``, and what of it arrives.

    Of each of the p controls ``works`` arrives, and ``load`` is there without it: their first row is what is expected, their
    second one what the control counts on. ``effective`` is what arrives of the control that is applied.
    """

    applied: Floats
    works: Floats
    load: Floats
    effective: Floats


class Learning(NamedTuple):
    """A precision learner's memory, settings and scratch space."""

    memory: Floats
    settings: Floats
    work: Floats


class Estimation(NamedTuple):
    """All that an estimator for a linear model works with.

    ``largest`` is the largest variance that a belief may have, ``reach`` that of a hypothesis: negative where none goes on as it
    was. ``CP`` is scratch space.
    """

    reading: Reading
    sample: Sample
    trust: Trust
    belief: Belief
    model: ModelMatrices
    actuators: Actuators
    learning: Learning
    screen: Screen
    seers: Seers
    space: UpdateSpace
    largest: Floats
    reach: Floats
    CP: Floats


SAMPLE = named_alike(Sample, y="heard")
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
    seers=SEERS,
    space=named_alike(UpdateSpace, L="chol"),
)
"""What all these arrays are called among the ports, state, parameters and scratch space of a block."""


def learn_later(sample, trust, memory, settings, work):
    """Leave it to the update: there precision and state are inferred together."""


@cache
def make_estimate(
    learn: Callable[..., None],
    infer: Callable[..., None] | None,
    report: Callable[..., None],
    alarm: Callable[..., None],
    first: int,
) -> Callable[..., None]:
    """Return the step function from the samples to the belief, for a learner's functions (see `Learner`).

    Where it infers state and faults together, that takes the place of learning and of Kalman's update. The learner's own outputs
    begin at the place `first` among all outputs.
    """
    if infer is None:

        def update(est):
            measure(est.sample.e, est.trust.used, est.trust.R, est.model.C, est.belief, est.space)

    else:
        learn = learn_later

        def update(est):
            infer(est.sample, est.trust, est.belief, est.model, est.actuators, est.learning, est.reach)

    def estimate(outputs, est):
        apply(est.model.C, est.belief.mean, est.reading.expected)
        innovate(est.reading, est.sample, est.belief, est.screen, est.model.C, est.CP, est.largest, est.reach)
        learn(est.sample, est.trust, est.learning.memory, est.learning.settings, est.learning.work)
        restore(est.reading, est.sample)
        update(est)
        blame(est.screen, est.trust.fault_probability)
        report(est.learning.memory, est.learning.settings, est.sample.nominal, first, outputs)
        alarm(est.screen.doubts, outputs)
        check_consistency(est.sample.y, est.belief.x_hat, est.model.C, est.seers)

    return estimate


def look_ahead(u, est):
    """Take the belief to the next step with the input, or with the last one where it is not finite."""
    for i in range(u.shape[0]):
        est.actuators.applied[i] = select(u[i] - u[i] == 0.0, u[i], est.actuators.applied[i])
    go_on(est)


def go_on(est):
    """Take the belief to the next step, with the control that is applied."""
    arrive(est.actuators)
    follow(est.actuators.effective, est.model.A, est.model.B, est.space.J[0], est.seers)
    predict(est.belief, est.actuators.effective, est.model, est.largest, est.space.J)


def estimation(
    block: Any, model: LinearModel, learner: Learner, largest: float
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return state, parameters and scratch space of an estimator, but for its ports.

    Parameters
    ----------
    block : controller or estimator
        With the settings ``initial_mean``, ``initial_covariance``, ``precision`` and ``invalid``.
    model : LinearModel
        What is believed about plant and sensors.
    learner : Learner
        Of its precisions.
    largest : float
        The largest variance that a belief may have.
    """
    n, p, m = model.states, model.controls, model.sensors
    doubts, told = screening(block, model)
    watching, constants = consistency(model, block.initial_mean)
    scratch = {
        "expected": (m,), "heard": (m,), "e": (m,), "present": (m,), "used": (m,), "spread": (m, m), "CP": (m, n),
        "reach": (1,), "chol": (m, m), "D": (m, n), "whitened": (m,), "v": (n,), "gain": (n,), "J": (n, n), "JP": (n, n),
        "effective": (p,), "seer_error": (m,), "work": (learner.work, m, m),
    }  # fmt: skip
    state = {
        "mean": block.initial_mean,
        "covariance": block.initial_covariance,
        "applied": np.zeros(p),
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
        state | doubts | watching,
        parameters | told | constants,
        {name: np.zeros(shape) for name, shape in scratch.items()},
    )


def plan(actuators, GB, decision):
    """Leave to the control what is left to do, by what of it arrives and what is there without it."""
    for i in range(decision.sought.shape[0]):
        for j in range(actuators.works.shape[1]):
            decision.sought[i] = decision.sought[i] - GB[i, j] * actuators.load[1, j]
            decision.GB[i, j] = GB[i, j] * actuators.works[1, j]


def arrive(actuators):
    """Compute what of the control arrives at the plant."""
    for j in range(actuators.applied.shape[0]):
        actuators.effective[j] = actuators.works[0, j] * actuators.applied[j] + actuators.load[0, j]
