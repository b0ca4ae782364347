"""What is wrong with a model, from a recorded run: explanations compared by how well each predicts what all sensors read.

Observers of disjoint sets of sensors predict the samples under each explanation: the control arrives with another sign or
size, late, through a lag or within a limit; time passes faster or slower than the model's; a constant load acts; the plant has
other dynamics, or some that bend. Each is judged by its likelihood, with the scale of the innovations left free (so that wrong
noise decides nothing), less what its parameters cost (BIC). An explanation counts only if the sensors of *every* set say so: what
one set says alone is a fault of its sensors. Stretches in which sensors of one quantity disagree are left out. So the fault
probabilities of the precision learner, which a wrong model spoils, are not needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.diagnosis.candidates import explanations
from bayesftc.controllers.diagnosis.explanations import Recording, innovations
from bayesftc.controllers.diagnosis.judge import EVIDENCE, Explanation, Judge
from bayesftc.controllers.diagnosis.words import sentence
from bayesftc.controllers.estimation.observers import observers
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.nonlinear import NonlinearModel
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.judging.signals import ALARM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MOST_SAMPLES = 5_000
"""Samples of a run that are looked at, from its start."""

CUTS = (1e6, 300.0, 100.0, 30.0, 10.0, 6.0)
"""Standard deviations by which every observer may miss before the rest of a run is left out, from the longest to the shortest.

A plant that is lost, as a pendulum that has fallen, ends where no linear model holds; what has begun it shows before."""

SIMPLE = frozenset({"sign", "gain", "dt", "late", "limit"})
"""Kinds of few parameters: one of them that explains a shorter run wholly counts more than what fits a longer one somehow."""

SIMPLEST = 4
"""Rank of an explanation of one parameter: where it explains a part of a run wholly, no shorter one is asked."""

EXPLAINED = 2.0
"""Mean squared innovation up to which a run is explained."""

NEARLY = 5.0
"""Log-likelihood ratio within which a flexible explanation counts as nearly as good; for simple ones it is `EVIDENCE`."""

LEAST_SAMPLES = 8
"""Samples without which nothing is said."""


@dataclass(frozen=True)
class ModelFinding:
    """How a model is wrong.

    Attributes
    ----------
    kind : str
        ``"sign"`` or ``"gain"`` of a column of B, ``"dt"`` (the plant is faster or slower), ``"late"`` (a delay or a lag of the
        control), ``"limit"`` (of the control), ``"nonlinear"`` (far from where it was linearised), ``"dynamics"`` (another A),
        ``"load"`` (a constant one), ``"unknown"``.
    sentence : str
        What is wrong, and what to do.
    values : tuple of float
        ``sign`` and ``gain``: what the control's effect is in the model's, and its number; ``dt``: how many times as fast the
        plant is; ``late``: seconds, and 1 for a lag; ``limit``: low, high, and the control's number; ``load``: one for each
        control, in its unit; else empty.
    evidence : float
        Log-likelihood ratio over the model as it is, from the sensors of the set that says least.
    others : tuple of str
        Kinds that explain the run nearly as well; the sentence says them, too.
    """

    kind: str
    sentence: str
    values: tuple[float, ...] = ()
    evidence: float = float("nan")
    others: tuple[str, ...] = ()


def diagnose(
    signals: Mapping[str, Any], controller: Any, *, y: str | None = None, name: str = "controller"
) -> ModelFinding | None:
    """Return how the model of a controller or estimator is wrong, by a recorded run of it; None if nothing speaks against it.

    Parameters
    ----------
    signals : Result
        Must hold the samples and the controls at every step (decimation 1).
    controller : controller or StateEstimator
        The block that ran, for its model and its initial belief. Of a nonlinear model only `model_suspect` is looked at.
    y : str, optional
        Name of the signal that was connected to its ``y``; by default its recorded input.
    name : str
        The block's name in the diagram.

    Returns
    -------
    ModelFinding or None
        What explains the run best. Where nothing does, but `model_suspect` was recorded and has been above one half, its kind
        is ``"unknown"``.

    Raises
    ------
    ModelError
        If the block has no model, or not every step was recorded.
    UnknownNameError
        If a signal was not recorded.
    """
    model = checked_model(controller)
    if model is None:
        raise ModelError(f"A diagnosis needs a model, which this {type(controller).__name__} does not have.")
    source, suspect = f"{name}.y" if y is None else y, f"{name}.model_suspect"
    for needed in (suspect,) if isinstance(model, NonlinearModel) else (source, f"{name}.u"):
        if needed not in signals:
            raise UnknownNameError(
                f"The diagnosis needs the signal {needed!r}, which was not recorded; add it to record=[...]."
            )
    if getattr(signals, "decimation", 1) != 1:
        raise ModelError("The diagnosis needs every step; run with decimation=1.")
    raised = suspect in signals and np.nanmax(np.append(signals[suspect], 0.0)) >= ALARM
    if isinstance(model, NonlinearModel):
        words = sentence("suspect", (), model.linearised(controller.initial_mean, controller.control_mean))
        return ModelFinding("unknown", words) if raised else None
    found = diagnose_recording(model, signals[source], signals[f"{name}.u"], controller.initial_mean)
    if found is None and raised:
        return ModelFinding("unknown", sentence("unknown", (), model))
    return found


def checked_model(controller: Any) -> LinearModel | NonlinearModel | None:
    """Return the model by which the samples of a controller or estimator are checked; None if there is none."""
    model = getattr(controller, "watched_model", getattr(controller, "model", None))
    return model if isinstance(model, LinearModel | NonlinearModel) else None


def diagnose_recording(
    model: LinearModel, y: ArrayLike, u: ArrayLike, initial_mean: ArrayLike = 0.0
) -> ModelFinding | None:
    """Return how a model is wrong, by recorded samples and controls; None if nothing speaks against it.

    Parameters
    ----------
    model : LinearModel
        The model.
    y : array, steps x m
        Samples; one that is not finite is missing.
    u : array, steps x p
        What acts from each sample to the next.
    initial_mean : number or vector
        About where the state is at the first sample; nonlinear explanations count from there.

    Raises
    ------
    ModelError
        If there are not as many sensors or controls as in the model.
    """
    for what, given, columns in (("sensors", y, model.sensors), ("controls", u, model.controls)):
        if (recorded := 1 if np.ndim(given) == 1 else np.shape(given)[-1]) != columns:
            raise ModelError(
                f"The recording to diagnose has {recorded} {what}, the model {columns}; give the samples and controls of the "
                "sensors and actuators in the model."
            )
    found = best_explanations(model, y, u, initial_mean)
    if not found:
        return None
    best = found[0]
    text = sentence(best.kind, best.values, model, [(x.kind, x.values) for x in found[1:]])
    values = () if best.kind in ("dynamics", "nonlinear") else best.values
    return ModelFinding(best.kind, text, values, min(best.support), tuple(x.kind for x in found[1:]))


def best_explanations(
    model: LinearModel, y: ArrayLike, u: ArrayLike, initial_mean: ArrayLike = 0.0
) -> list[Explanation]:
    """Return what explains a recording best, then what does so nearly as well; arguments as of `diagnose_recording`."""
    seers = observers(model)
    if seers is None:
        return []
    seen = Recording(
        np.asarray(y, float).reshape(-1, model.sensors)[:MOST_SAMPLES],
        np.nan_to_num(np.asarray(u, float).reshape(-1, model.controls)[:MOST_SAMPLES]),
        np.array(np.broadcast_to(np.asarray(initial_mean, float), model.states)),
    )
    moved = seen.u @ model.matrix("B").T
    base = innovations([model], [seers], seen, moved[None, None])[0][0][:, 0]
    missed = np.nan_to_num(np.abs(base), nan=np.inf).max(axis=2).min(axis=0)
    fallback: list[Explanation] = []
    best = -1
    tried: set[int] = set()
    for cut in CUTS:
        end = int(np.argmax(missed > cut)) if (missed > cut).any() else len(seen.y)
        if end in tried or end < LEAST_SAMPLES:
            continue
        tried.add(end)
        judge = Judge(model, seers, seen.until(end))
        if min(mask.sum() for mask in judge.masks) < LEAST_SAMPLES:
            continue
        known = [x for x in explanations(judge) if x.counts]
        near = [x for x in known if x.total > known[0].total - (EVIDENCE if x.kind in SIMPLE else NEARLY)]
        if near and near[0].kind == "dynamics":  # of which the simple ones are special cases
            near.sort(key=lambda x: x.kind not in SIMPLE)
        rank = max(map(_rank, near), default=-1)
        if rank == SIMPLEST:
            return near
        if rank > best:
            fallback, best = near, rank
    return fallback


def _rank(x: Explanation) -> int:
    """Return how much an explanation of a part of a run counts, 0 being that of one which leaves something unexplained.

    Before a plant is lost its model is still linear, so a linear explanation of a shorter run counts more than one that bends.
    """
    if max(x.square) >= EXPLAINED:
        return 0
    if x.kind in SIMPLE:
        return SIMPLEST if x.parameters == 1 else SIMPLEST - 1
    return 1 if x.kind == "nonlinear" else 2
