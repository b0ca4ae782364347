"""Ways in which a model may be wrong, each a change of what an observer predicts: its input, its matrices, or pushes besides.

All are run over the same recording by the same observers, many at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers._observers import Observers, observers

if TYPE_CHECKING:
    from bayesftc.controllers.model import LinearModel
    from bayesftc.cosim.block import Floats


@dataclass(frozen=True, eq=False)
class Recording:
    """What a diagnosis sees of a run of T samples.

    Attributes
    ----------
    y : ndarray, T x m
        Samples; NaN is a missing one.
    u : ndarray, T x p
        What was applied from each sample to the next.
    mean : ndarray, shape (n,)
        Belief before the first sample.
    """

    y: Floats
    u: Floats
    mean: Floats


def innovations(
    model: LinearModel, seers: Observers, seen: Recording, inputs: Floats, pushes: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Return the whitened innovations of each set's observer under each input (sets x inputs x T x m), and what each predicted.

    The predictions are of the state, T x n, under the first input, on average over the sets.

    Parameters
    ----------
    model : LinearModel
        What the observers predict by.
    seers : Observers
        The observers.
    seen : Recording
        The run.
    inputs : ndarray, H x T x p
        The controls as they are taken to have arrived, one course for each of H explanations.
    pushes : ndarray, H x T x n, or 0
        What moves the state besides.
    """
    moved = inputs @ model.matrix("B").T + pushes
    courses = np.broadcast_to(moved, (len(seers), *moved.shape))
    return _run([model] * len(seers), seers.gain, seers.whiten, seen, courses)


def of_models(models: list[LinearModel], seers: list[Observers], seen: Recording) -> list[Floats]:
    """Return the whitened innovations of observers by several models (for each: sets x 1 x T x m)."""
    each = len(seers[0])
    gain, whiten = (np.concatenate([getattr(s, name) for s in seers]) for name in ("gain", "whiten"))
    courses = np.repeat([(seen.u @ model.matrix("B").T)[None] for model in models], each, axis=0)
    white, _ = _run([model for model in models for _ in range(each)], gain, whiten, seen, courses)
    return [white[first : first + each] for first in range(0, len(white), each)]


def _run(
    models: list[LinearModel], gain: Floats, whiten: Floats, seen: Recording, courses: Floats
) -> tuple[Floats, Floats]:
    """Return the whitened innovations of observers (observers x H x T x m), and what they predict on average (T x n)."""
    At, Ct = (np.array([model.matrix(name).T for model in models]) for name in "AC")
    y = np.where(np.isfinite(seen.y), seen.y, 0.0)
    there = np.isfinite(seen.y).astype(float)
    count, samples = courses.shape[1:3]
    z = np.broadcast_to(seen.mean, (len(models), count, At.shape[1])).copy()
    errors, predicted = np.empty((samples, len(models), count, y.shape[1])), np.empty((samples, At.shape[1]))
    gains = gain.transpose(0, 2, 1)
    with np.errstate(all="ignore"):  # an explanation that is far off may diverge; it then explains nothing
        for k in range(samples):
            e = errors[k]
            predicted[k] = z[:, 0].mean(axis=0)
            np.subtract(y[k], z @ Ct, out=e)
            e *= there[k]
            z = z @ At + e @ gains + courses[:, :, k]
        white = np.einsum("kij,tkhj->khti", whiten, errors)
    return np.asarray(white), predicted


def forgetting(model: LinearModel, seers: Observers, seen: Recording) -> Floats:
    """Return how an error of the belief before the first sample shows in the innovations (sets x n x T x m)."""
    silent = replace(seen, y=np.where(np.isfinite(seen.y), 0.0, np.nan), mean=np.zeros_like(seen.mean))
    n = model.states
    started = replace(silent, mean=np.eye(n))
    return innovations(model, seers, started, np.zeros((n, *seen.u.shape)))[0]


def delayed(u: Floats, steps: int) -> Floats:
    """Return the controls `steps` samples late; before the first one arrives there is none."""
    late = np.zeros_like(u)
    late[steps:] = u[: len(u) - steps]
    return late


def lagged(u: Floats, steps: float) -> Floats:
    """Return the controls through a first-order lag with a time constant of `steps` samples."""
    from scipy.signal import lfilter

    share = 1.0 - float(np.exp(-1.0 / steps))
    return np.asarray(lfilter([share], [1.0, share - 1.0], u, axis=0))


def faster(model: LinearModel, factor: float) -> LinearModel | None:
    """Return the model of a plant in which `factor` times as much time passes in a step; None if A has no real logarithm."""
    from scipy.linalg import expm, logm

    n, plant, p = model.states, model.states - model.disturbances, model.controls
    A, B = model.matrix("A"), model.matrix("B")
    # What acts on the plant from outside (controls, estimated disturbances, the constant) is held during a step.
    outside = np.hstack([A[:plant, plant:], B[:plant]])
    whole = np.block([[A[:plant, :plant], outside], [np.zeros((outside.shape[1], plant)), np.eye(outside.shape[1])]])
    try:
        rate = logm(whole)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(rate).all() or np.abs(np.imag(rate)).max() > 1e-9:
        return None
    step = expm(factor * np.real(rate))
    if not np.isfinite(step).all() or np.abs(expm(np.real(rate)) - whole).max() > 1e-6 * np.abs(whole).max():
        return None
    changed, driven = A.copy(), B.copy()
    changed[:plant, :plant] = step[:plant, :plant]
    changed[:plant, plant:] = step[:plant, plant:n]
    driven[:plant] = step[:plant, n : n + p]
    return replace(model, A=changed, B=driven)


def seers_of(model: LinearModel | None, seers: Observers) -> Observers | None:
    """Return observers of the same sets for another model; None if it has none."""
    return None if model is None else observers(model, seers.sensors)
