"""Ways in which a model may be wrong, each a change of an observer: its input, its matrices, or additional pushes.

Many explanations run at once over the same recording with the same observers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class Recording:
    """The part of a run of T samples in a diagnosis.

    Attributes
    ----------
    y : ndarray, T x m
        Samples; NaN is a missing one.
    u : ndarray, T x p
        Controls from each sample to the next.
    mean : ndarray, shape (n,)
        Belief before the first sample.
    begins : tuple of int
        Samples before which the state is unknown: the first one, and those after a stretch that is left out.
    """

    y: Floats
    u: Floats
    mean: Floats
    begins: tuple[int, ...] = (0,)

    def until(self, end: int) -> Recording:
        """Return the first `end` samples."""
        return replace(self, y=self.y[:end], u=self.u[:end])


def innovations(
    models: Sequence[LinearModel], banks: Sequence[Observers], recording: Recording, moved: Floats
) -> tuple[list[Floats], Floats]:
    """Return the whitened innovations of the observers of several models, and the states predicted by the first model.

    Parameters
    ----------
    models : sequence of LinearModel
        The models of the observers.
    banks : sequence of Observers
        The observers of each model, with the same sets.
    recording : Recording
        The run.
    moved : ndarray, models x H x T x n
        Inputs of the state from each sample to the next, for each of H explanations: ``B u`` and pushes.

    Returns
    -------
    list of ndarray
        For each model the innovations, sets x (H + errors) x T x m. The last ones are the changes of the first explanation's
        innovations by an error of each state (except the constant) before each of the samples ``recording.begins``.
    ndarray, T x n
        Predictions of the state by the first model under the first explanation, on average over its sets.
    """
    each, n, samples, given = len(banks[0]), moved.shape[3], len(recording.y), moved.shape[1]
    gains = np.concatenate([s.gain for s in banks]).transpose(0, 2, 1)
    whiten = np.concatenate([s.whiten for s in banks]).transpose(0, 2, 1)
    At, Ct = (np.repeat([model.matrix(name).T for model in models], each, axis=0) for name in "AC")
    unknown = n - models[0].constant
    columns = given + unknown * len(recording.begins)
    y, present = np.where(np.isfinite(recording.y), recording.y, 0.0), np.isfinite(recording.y).astype(float)
    z = np.empty((len(At), 0, n))
    white, predicted = np.zeros((samples, len(At), columns, y.shape[1])), np.empty((samples, each, n))
    with np.errstate(all="ignore"):  # a wrong explanation may diverge; it then explains nothing
        for k in range(samples):
            if k in recording.begins:
                errors = np.repeat(np.eye(unknown, n)[None], len(At), axis=0)
                kept = max(z.shape[1], given)
                z = np.concatenate([np.zeros((len(At), kept, n)), errors], axis=1) + recording.mean
            e = (y[k] - z @ Ct) * present[k]
            predicted[k] = z[:each, 0]
            np.matmul(e, whiten, out=white[k, :, : z.shape[1]])
            pushes = np.repeat(moved[:, :, k], each, axis=0)
            z = z @ At + e @ gains
            z[:, :given] += pushes
            z[:, given:] += pushes[:, :1]  # an error of the state, under the first explanation
            white[k, :, given : z.shape[1]] -= white[k, :, :1]
    white = white.transpose(1, 2, 0, 3)
    return [white[first : first + each] for first in range(0, len(white), each)], predicted.mean(axis=1)


def delayed(u: Floats, steps: int) -> Floats:
    """Return the controls `steps` samples late, with zeros before."""
    late = np.zeros_like(u)
    late[steps:] = u[: len(u) - steps]
    return late


def earlier(u: Floats, steps: Sequence[int]) -> Floats:
    """Return each control some samples early, with its last value at the end."""
    early = np.repeat(u[-1:], len(u), axis=0)
    for j, k in enumerate(steps):
        early[: len(u) - k, j] = u[k:, j]
    return early


def lagged(u: Floats, steps: float) -> Floats:
    """Return the controls through a first-order lag with a time constant of `steps` samples."""
    share = 1.0 - float(np.exp(-1.0 / steps))
    late, last = np.empty_like(u), np.zeros(u.shape[1])
    for k in range(len(u)):  # scipy.signal takes a second to import, pandas a third of one
        last = late[k] = (1.0 - share) * last + share * u[k]
    return late


def faster(model: LinearModel, factor: float) -> LinearModel | None:
    """Return the model of a plant that is `factor` times as fast; None if A has no real logarithm, as with delays."""
    from scipy.linalg import expm

    if (rate := _rate(model)) is None:
        return None
    step = expm(factor * rate)
    if not np.isfinite(step).all():
        return None
    n, plant, p = model.states, model.states - model.disturbances, model.controls
    changed, driven = model.matrix("A").copy(), model.matrix("B").copy()
    changed[:plant, :plant] = step[:plant, :plant]
    changed[:plant, plant:] = step[:plant, plant:n]
    driven[:plant] = step[:plant, n : n + p]
    return replace(model, A=changed, B=driven)


@lru_cache(maxsize=16)  # a search asks for dozens of factors
def _rate(model: LinearModel) -> Floats | None:
    """Return the logarithm of the plant's step, with all that is held during it; None if there is no real one."""
    from scipy.linalg import expm, logm

    if model.delays is not None:
        return None
    n, plant = model.states, model.states - model.disturbances
    A, B = model.matrix("A"), model.matrix("B")
    # Inputs of the plant (controls, estimated disturbances, the constant) are held during a step.
    outside = np.hstack([A[:plant, plant:n], B[:plant]])
    whole = np.block([[A[:plant, :plant], outside], [np.zeros((outside.shape[1], plant)), np.eye(outside.shape[1])]])
    try:
        rate = logm(whole)
    except (ValueError, np.linalg.LinAlgError):
        return None
    if not np.isfinite(rate).all() or np.abs(np.imag(rate)).max() > 1e-9:
        return None
    real: Floats = np.real(rate)
    return real if np.abs(expm(real) - whole).max() <= 1e-6 * np.abs(whole).max() else None


def holding(model: LinearModel, x: Floats) -> Floats:
    """Return the control that holds the plant in a state as nearly as possible."""
    A, B = model.matrix("A"), model.matrix("B")
    return np.asarray(np.linalg.lstsq(B, x - A @ x, rcond=None)[0])
