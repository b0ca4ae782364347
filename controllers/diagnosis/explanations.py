"""Ways in which a model may be wrong, each a change of an observer: its input, its matrices, or additional pushes.

Many explanations run at once over the same recording with the same observers.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.diagnosis.slow_sensors import SampleFilter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.controllers.diagnosis.slow_sensors import Presence
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
    presence : Presence or None
        Which samples are there if some sensors are slow; at least as long as the recording.
    late : tuple of int
        Samples by which each control acted after it was sent, to which delays of all sensors add; empty without a delay.
    offsets : tuple of int
        Sensors with an unknown constant offset.
    linear : bool
        Whether the plant is known to be linear.
    beyond : ndarray, any number x p, optional
        Controls after the last sample, as the model's delays let them act.
    """

    y: Floats
    u: Floats
    mean: Floats
    begins: tuple[int, ...] = (0,)
    presence: Presence | None = None
    late: tuple[int, ...] = ()
    offsets: tuple[int, ...] = ()
    linear: bool = False
    beyond: Floats | None = None

    def until(self, end: int) -> Recording:
        """Return the first `end` samples."""
        return replace(self, y=self.y[:end], u=self.u[:end], beyond=self.known[end:])

    @property
    def known(self) -> Floats:
        """The controls, also those after the last sample."""
        return self.u if self.beyond is None else np.concatenate([self.u, self.beyond])


def innovations(
    models: Sequence[LinearModel], banks: Sequence[Observers], recording: Recording, moved: Floats, first: int = 0
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
    first : int
        The sample from which on anything is not zero: before, nothing is computed.

    Returns
    -------
    list of ndarray
        For each model the innovations, sets x (H + errors) x T x m. The last ones are the changes of the first explanation's
        innovations by an error of each state (except the constant) before each of the samples ``recording.begins``, and by an
        offset of each of the sensors ``recording.offsets``.
    ndarray, T x n
        Predictions of the state by the first model under the first explanation, on average over its sets.
    """
    each, n, given, presence = len(banks[0]), moved.shape[3], moved.shape[1], recording.presence
    filters: Sequence[Observers | SampleFilter] = banks if presence is None else presence.filters(banks)
    gains, whiten = (np.concatenate([getattr(s, name) for s in filters]) for name in ("gain", "whiten"))
    A, C = (np.repeat([model.matrix(name) for model in models], each, axis=0) for name in "AC")
    unknown, offsets = n - models[0].constant, np.eye(recording.y.shape[1])[list(recording.offsets)].T
    inputs = given + offsets.shape[1]
    start = np.zeros((n, inputs + unknown))
    start[:, :given], start[:unknown, inputs:] = recording.mean[:, np.newaxis], np.eye(unknown)
    samples, sensors = recording.y.shape
    white = np.zeros((len(A), inputs + unknown * len(recording.begins), samples, sensors))
    predicted = np.zeros((each, samples, n))
    for i, (begin, end) in enumerate(zip(recording.begins, (*recording.begins[1:], samples), strict=True)):
        if (begin := max(begin, first)) >= end:
            continue
        pushes = np.zeros((end - begin, len(models), n, inputs))
        pushes[..., :given] = moved[:, :, begin:end].transpose(2, 0, 3, 1)
        y = recording.y[begin:end, :, np.newaxis]
        if inputs > given:
            y = np.concatenate([np.repeat(y, given, axis=2), np.where(np.isfinite(y), offsets, np.nan)], axis=2)
        index = filters[0].index[begin:end] if isinstance(filters[0], SampleFilter) else None
        e, z = _steps((A, C, gains), index, y, np.repeat(pushes, each, axis=1), start)
        for of, its in zip(whiten, e, strict=True):
            np.matmul(of if index is None else of[index], its, out=its)
        whitened = e.transpose(0, 3, 1, 2)
        errors = given + unknown * i
        white[:, :given, begin:end] = whitened[:, :given]
        white[:, errors : errors + unknown, begin:end] = whitened[:, inputs:]
        white[:, len(white[0]) - inputs + given :, begin:end] = whitened[:, given:inputs]
        predicted[:, begin:end] = z[:each]
    return [white[i : i + each] for i in range(0, len(white), each)], predicted.mean(axis=0)


def _steps(
    observers: tuple[Floats, Floats, Floats],
    index: NDArray[np.intp] | None,
    y: Floats,
    pushes: Floats,
    start: Floats,
) -> tuple[Floats, Floats]:
    """Return the innovations of N observers (N x T x m x columns), and the states that they predict in the first column.

    A, C and gain of the observers are given, or several gains, of which `index` has the number at each sample. Their states
    begin in the columns of `start`. The first ones have the samples (T x m x 1, or x H) and `pushes` (T x N x n x H) as inputs,
    the others none.

    A loop over all samples would take most of the time of a diagnosis. The samples are therefore cut into blocks, about as many
    as each has samples. All blocks run at once, from a guess (which keeps the rounding small) and from each unit vector. Their
    real starts follow, block by block.
    """
    A, C = (matrix[:, np.newaxis] for matrix in observers[:2])
    gain = observers[2] if index is not None else observers[2][:, np.newaxis]
    N, n, m, given, samples = len(A), A.shape[-1], C.shape[-2], pushes.shape[-1], len(y)
    size = int(np.ceil(np.sqrt(samples)))
    blocks = -(-samples // size)
    padding = ((0, size * blocks - samples),)
    if index is not None:
        index = np.pad(index, padding).reshape(blocks, size)
    y = np.pad(y, (*padding, (0, 0), (0, 0)), constant_values=np.nan).reshape(blocks, size, m, -1)
    present = np.isfinite(y[..., :1])
    y = np.where(present, y, 0.0)
    pushes = np.pad(pushes, padding + ((0, 0),) * 3).reshape(blocks, size, N, n, given)
    guess = np.linalg.pinv(C) @ y[:, 0]
    guess[:, 0] = 0.0
    z = np.concatenate(
        [np.broadcast_to(guess, (N, blocks, n, given)), np.broadcast_to(np.eye(n), (N, blocks, n, n))], axis=3
    )
    e = np.empty((size, N, blocks, m, given + n))
    first = np.empty((size, N, blocks, n, 1 + n))
    with np.errstate(all="ignore"):  # a wrong explanation may diverge; it then explains nothing
        for i in range(size):
            first[i, ..., :1], first[i, ..., 1:] = z[..., :1], z[..., given:]
            np.matmul(-C, z, out=e[i])
            e[i, ..., :given] += y[:, i]
            e[i] *= present[:, i]
            z = A @ z + (gain if index is None else gain[:, index[:, i]]) @ e[i]
            z[..., :given] += pushes[:, i].swapaxes(0, 1)
        starts = np.empty((N, blocks, *start.shape))  # relative to the guess
        starts[:, 0] = start
        for j in range(1, blocks):
            starts[:, j] = z[:, j - 1, :, given:] @ starts[:, j - 1]
            starts[:, j, :, :given] += z[:, j - 1, :, :given] - guess[:, j]
        whole = e[..., given:] @ starts
        whole[..., :given] += e[..., :given]
        states = first[..., 0] + (first[..., 1:] @ starts[..., :1])[..., 0]
    whole, states = (each.swapaxes(0, 1).swapaxes(1, 2) for each in (whole, states))
    return whole.reshape(N, -1, m, whole.shape[-1])[:, :samples], states.reshape(N, -1, n)[:, :samples]


def delayed(u: Floats, steps: int, before: Floats) -> Floats:
    """Return the controls `steps` samples late, after the control that acted `before` the recording."""
    return np.concatenate([np.tile(before, (min(steps, len(u)), 1)), u[: max(len(u) - steps, 0)]])


def earlier(recording: Recording, steps: Sequence[int]) -> Floats:
    """Return each control some samples early, with its last known value at the end."""
    known, rows = recording.known, np.arange(len(recording.u))[:, None] + np.array(steps)
    return np.asarray(known[np.minimum(rows, len(known) - 1), np.arange(known.shape[1])])


def lagged(u: Floats, steps: float, before: Floats) -> Floats:
    """Return the controls through a first-order lag with a time constant of `steps` samples, after the control `before`."""
    share = 1.0 - float(np.exp(-1.0 / steps))
    late, last = np.empty_like(u), np.array(before, dtype=np.float64)
    for k in range(len(u)):  # scipy.signal takes a second to import, pandas a third of one
        last = late[k] = (1.0 - share) * last + share * u[k]
    return late


def dead_zone(u: Floats, width: float) -> Floats:
    """Return a control behind a dead zone of this width about zero."""
    return u - np.clip(u, -width / 2.0, width / 2.0)


def played(u: Floats, widths: Floats, before: float) -> Floats:
    """Return a control behind plays of some widths (widths x T), each of which begins at the control `before`.

    What is behind a play moves only when the control reaches an end of it: an actuator with a dead band about where it stands.
    """
    moved, last = np.empty((len(widths), len(u))), np.full(len(widths), before)
    for k, (low, high) in enumerate(zip(u[:, np.newaxis] - widths / 2.0, u[:, np.newaxis] + widths / 2.0, strict=True)):
        last = moved[:, k] = np.minimum(np.maximum(last, low), high)
    return moved


def slowed(u: Floats, steps: Floats, before: float) -> Floats:
    """Return a control that changes by no more than each of some steps in a sample (steps x T), after the control `before`."""
    moved, last = np.empty((len(steps), len(u))), np.full(len(steps), before)
    for k, value in enumerate(u):
        last = moved[:, k] = last + np.clip(value - last, -steps, steps)
    return np.ascontiguousarray(moved)


def faster(model: LinearModel, factor: float) -> LinearModel | None:
    """Return the model of a plant that is `factor` times as fast; None if A has no real logarithm."""
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

    n, plant = model.states, model.states - model.disturbances
    A, B = model.matrix("A"), model.matrix("B")
    # Inputs of the plant (controls, estimated disturbances, the constant) are held during a step.
    outside = np.hstack([A[:plant, plant:n], B[:plant]])
    whole = np.block([[A[:plant, :plant], outside], [np.zeros((outside.shape[1], plant)), np.eye(outside.shape[1])]])
    try:
        # A dead time in A has no logarithm, of which scipy warns. The exponential is compared below.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
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
