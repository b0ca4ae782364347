"""Observers of sets of sensors, disjoint where possible: an error of all is the model's, an error of one is its sensor's.

Each observer is the steady Kalman filter of one set (a dedicated observer; Clark, IEEE Trans. AES 14, 1978). It uses the applied
control and the model's sensor covariance. If the model is right and its sensors are healthy, its innovations are therefore white
and of known covariance, whatever a precision learner infers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.controllers.estimation.innovation import steady_prediction
from bayesftc.controllers.models.disturbances import error_variances
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats

MOST_SETS = 3
"""Largest number of sets: two separate one faulty sensor from a wrong model, three separate two that all sets see."""

LONGEST_REST = 300
"""Samples within which an observer must forget its initial state; a slower one gets a fading memory."""

SLOWEST_ERROR = 1.0 - 1e-5
"""Decay per sample of a sensor's error in the filters; a slower one counts as this.

A bias that hardly ever changes is seen by no steady filter of a sensor alone. All sensors would then be compared at once, and a
fault of one would speak against the model."""

FORGOTTEN = 0.02
"""Share of the initial error that may remain when an observer's innovations begin to count."""


UNSEEN = 1e-13
"""Smallest singular value in Hautus' test of a mode that sensors do not see."""

ROUNDED = 1e-6
"""Largest rounding of what the belief adds to an innovation's variance, relative to the sensor's noise."""


@dataclass(frozen=True, eq=False)
class Observers:
    """The observers of K sets of sensors, of a model with n states and m sensors.

    Attributes
    ----------
    model : LinearModel
        The model.
    sensors : tuple of tuple of int
        The sensors of each set.
    gain : ndarray, shape (K, n, m)
        Steady gain of the next prediction on each innovation; zero for sensors of other sets.
    whiten : ndarray, shape (K, m, m)
        Matrix that whitens an observer's innovations to variance 1; zero rows and columns for sensors of other sets.
    noise, covariance : ndarray, shape (K, n, n)
        Process covariance of each filter, and its steady covariance before the samples.
    transition : ndarray, shape (n, n)
        The filters' A: the model's, with errors of sensors no slower than `SLOWEST_ERROR`.
    settling : int
        Samples in which the slowest observer forgets its initial state.
    """

    model: LinearModel
    sensors: tuple[tuple[int, ...], ...]
    gain: Floats
    whiten: Floats
    noise: Floats
    covariance: Floats
    transition: Floats
    settling: int

    def __len__(self) -> int:
        return len(self.sensors)


def observers(
    model: LinearModel,
    sets: tuple[tuple[int, ...], ...] | None = None,
    groups: tuple[tuple[int, ...], ...] | None = None,
) -> Observers | None:
    """Return observers of as many sets as can each see all undamped modes; None if all sensors together cannot.

    Sensors of the same quantity (`LinearModel.proportional`) go to different sets, so that each set sees as much of the plant as
    possible. Where a quantity has too few for a second set, as one encoder beside three gyros, sets share them. A fault of a
    gyro then spoils one set.

    Parameters
    ----------
    model : LinearModel
        The model.
    sets : tuple of tuple of int, optional
        The sets; by default chosen here.
    groups : tuple of tuple of int, optional
        The sensors of each quantity; by default those that read a multiple of the same.
    """
    if sets is not None:
        return _of_sets(model, sets)
    groups = model.proportional if groups is None else groups
    most = min(MOST_SETS, max(map(len, groups)))
    for shared, counts in ((False, range(most, 1, -1)), (True, range(most, 0, -1))):
        for count in counts:
            chosen = tuple(tuple(sorted(i for g in groups for i in _part(g, k, count, shared))) for k in range(count))
            if (bank := _of_sets(model, chosen)) is not None:
                return bank
    return None


def _part(group: tuple[int, ...], k: int, count: int, shared: bool) -> tuple[int, ...]:
    """Return the sensors of one quantity in the k-th of some sets; where they are too few, they may be in several."""
    return group[k % len(group) : k % len(group) + 1] if shared and len(group) < count else group[k::count]


def _of_sets(model: LinearModel, sets: tuple[tuple[int, ...], ...]) -> Observers | None:
    moving = model.moving
    n, m = moving.states, moving.sensors
    correction, whiten = np.zeros((len(sets), model.states, m)), np.zeros((len(sets), m, m))
    noise, covariance = np.zeros((2, len(sets), model.states, model.states))
    A, Q = _with_faster_errors(model)
    settling = 1
    for k, chosen in enumerate(map(list, sets)):
        C, R = moving.matrix("C")[chosen], moving.matrix("sensor_covariance")[np.ix_(chosen, chosen)]
        filtered = _filter(A, C, Q, R)
        if filtered is None:
            return None
        correction[k, :n, chosen], root = filtered[0].T, filtered[1]
        noise[k, :n, :n], covariance[k, :n, :n], samples = filtered[2:]
        whiten[k][np.ix_(chosen, chosen)] = np.linalg.inv(root)
        settling = max(settling, samples)
    transition = model.matrix("A").copy()
    transition[:n, :n] = A
    return Observers(model, sets, model.matrix("A") @ correction, whiten, noise, covariance, transition, settling)


def _with_faster_errors(model: LinearModel) -> tuple[Floats, Floats]:
    """Return A and the process covariance with errors of sensors no slower than `SLOWEST_ERROR`, of the same variance."""
    moving = model.moving
    A, Q = moving.matrix("A").copy(), moving.matrix("process_covariance").copy()
    variances = error_variances(model)
    for i in np.flatnonzero((variances > 0.0) & (np.diag(A) > SLOWEST_ERROR)):
        A[i, i], Q[i, i] = SLOWEST_ERROR, variances[i] * (1.0 - SLOWEST_ERROR**2)
    return A, Q


def _filter(A: Floats, C: Floats, Q: Floats, R: Floats) -> tuple[Floats, Floats, Floats, Floats, int] | None:
    """Return the gain K, the innovations' root, the process covariance, the filter's own, and the samples to forget the start.

    None if no filter has a steady state. A mode that neither decays nor has noise (a position that only drifts) would be
    remembered for ever. The filter then has a fading memory, no shorter than needed: what it knows counts a little less with each
    sample, whatever the units of the states (Anderson and Moore, Optimal Filtering, 1979, section 6.2). It does not help against
    a slow mode that the sensors do not see, but would hide errors of the others.
    """
    best: tuple[Floats, Floats, Floats, Floats, int] | None = None
    hopeless = _remembers(A, C)
    for rests in (np.inf, 1.5, 1.0):  # poles of modes that hardly decay are twice as far from 1 as this memory's
        slowest = FORGOTTEN ** (1.0 / (rests * LONGEST_REST))  # no pole of the filter is slower
        faded = A / slowest
        try:
            P = steady_prediction(faded, C, Q, R)
            S = C @ P @ C.T + R
            root, gain = np.linalg.cholesky(S), np.linalg.solve(S, C @ P).T
        except (ModelError, np.linalg.LinAlgError):  # the second where P is so large that R is lost in the rounding
            continue
        added = np.diag(np.abs(C) @ np.abs(P) @ np.abs(C).T)
        if best is not None and (np.finfo(np.float64).eps * added > ROUNDED * np.diag(R)).any():
            break  # the memory has forgotten a mode that the sensors hardly see
        after = faded @ (P - gain @ C @ P) @ faded.T
        noise = Q + (1.0 - slowest**2) * (after + after.T) / 2.0  # an ordinary filter with this noise has the same gain
        pole = float(np.abs(np.linalg.eigvals(A - A @ gain @ C)).max())
        settling = int(np.ceil(np.log(FORGOTTEN) / np.log(pole))) if pole > 0.0 else 1
        best = np.asarray(gain), np.asarray(root), noise, P, max(settling, 1)
        if hopeless or settling <= LONGEST_REST:
            break
    return best


def _remembers(A: Floats, C: Floats) -> bool:
    """Return whether no gain forgets the start soon: a mode that these sensors do not see decays slowly (Hautus' test)."""
    seen = C / max(float(np.abs(C).max()), 1e-300)
    modes = np.linalg.eigvals(A)
    slow = modes[np.abs(modes) > FORGOTTEN ** (1.0 / LONGEST_REST) + 1e-9]
    return any(
        np.linalg.svd(np.vstack([A - mode * np.eye(len(A)), seen]), compute_uv=False)[-1] < UNSEEN for mode in slow
    )
