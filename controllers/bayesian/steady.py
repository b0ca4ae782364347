"""The gains of filter and control in steady state, from which stability is judged, and how near a loop is to instability.

Gains take steps of the covariances, most of the time of making a controller. They depend on the model and the priors only, and
are cached: a campaign over plants or over settings of the precision learner computes them once.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayesftc.controllers.bayesian.block import VARIANCE_CAP
from bayesftc.controllers.linalg.riccati import doubled, is_covariance
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.bayesian.linear import BayesianController

Packed = tuple[tuple[int, ...], bytes]
"""A matrix as a cache key: its shape and its elements."""


_NAMES = (
    "A",
    "B",
    "C",
    "the goal's matrix",
    "the process covariance",
    "the sensors' covariance",
    "the goal's covariance",
    "the control prior's precision",
    "the initial covariance",
)

FREQUENCIES = 500
"""Number of frequencies at which the distance of a loop from instability is computed, besides those of its poles; then of finer
ones about the least distance."""


STEPS = 2000
"""Largest number of single steps of the covariances."""
LEAP_AFTER = 64
"""Number of single steps before many steps are taken at once."""
DOUBLINGS = 20
"""Number of doublings of the steps taken at once: a million steps. A slower filter has no steady state in practice, as that of
a constant without process noise, whose gain falls as the inverse of the number of samples."""
SETTLED = 1e-10
"""Largest change of a covariance by which it counts as steady, in units in which its variances are 1."""
NOTHING = 1e-20
"""Variance, relative to that at the start, of a state that is known exactly: without noise it falls for ever."""


class Gains(NamedTuple):
    """Gains of ``x_hat = mean + K (y - C mean)``, ``u = M goal - L x_hat``, ``mean' = A (T x_hat + F goal) + B u``.

    Attributes
    ----------
    K : ndarray, n x m
        Of the filter.
    L : ndarray, p x n
        Of the control, on the belief.
    M : ndarray, p x g
        Of the control, on the goal.
    T, F : ndarray, n x n and n x g
        Effect of belief and goal on the mean that is carried with ``belief="joint"``; else T is the identity and F is 0.
    """

    K: Floats
    L: Floats
    M: Floats
    T: Floats
    F: Floats


def steady_gains(
    A: Floats,
    B: Floats,
    C: Floats,
    G: Floats,
    Q: Floats,
    R: Floats,
    goal_covariance: Floats,
    prior: Floats,
    start: Floats,
    *,
    joint: bool,
) -> Gains:
    """Return the gains of filter and control in steady state.

    Parameters
    ----------
    A, B, C, Q, R : ndarray
        The model: x' = A x + B u + noise of covariance Q, y = C x + noise of covariance R.
    G, goal_covariance : ndarray
        Matrix G of the goal prior on G x, and its covariance.
    prior : ndarray
        The control prior's precision.
    start : ndarray
        Covariance of the initial belief.
    joint : bool
        Whether the belief is conditioned on the goal as well.

    Raises
    ------
    ModelError
        If the matrices differ so much in size that rounding makes one of them vanish.
    """
    matrices = (A, B, C, G, Q, R, goal_covariance, prior, start)
    try:
        gains = _gains(joint, *((np.shape(M), np.asarray(M, float).tobytes()) for M in matrices))
    except np.linalg.LinAlgError:
        sizes = {name: f"{np.abs(M).max(initial=0.0):.3g}" for name, M in zip(_NAMES, matrices, strict=True)}
        raise ModelError(
            "The model's numbers differ too much in size to compute filter and control in double precision. The largest are "
            f"{', '.join(f'{size} in {name}' for name, size in sizes.items())}. Choose units in which they are closer, and "
            "variances that are not negligible beside others (for two equal sensors at least 1e-12 of the state's variance)."
        ) from None
    return Gains(*(gain.copy() for gain in gains))


@lru_cache(maxsize=512)
def _gains(joint: bool, *packed: Packed) -> Gains:
    A, B, C, G, Q, R, goal_covariance, prior, start = (np.frombuffer(items).reshape(shape) for shape, items in packed)
    GA, GB, one = G @ A, G @ B, np.eye(len(A))
    N = G @ Q @ G.T + goal_covariance
    weight = np.linalg.solve(N, GB)
    V = np.linalg.inv(N) - weight @ np.linalg.solve(prior + GB.T @ weight, weight.T)
    # The steady state does not depend on the start, but a very uncertain start would lose R to rounding.
    start = start * min(1.0, 1e6 / max(1.0, float((np.diag(C @ start @ C.T) / np.diag(R)).max())))
    predicted = start + Q + 1e-9 * np.trace(R) * one
    largest, least = VARIANCE_CAP * np.trace(predicted), NOTHING * np.diag(predicted)
    goals = GA.T @ V @ GA if joint else np.zeros_like(A)
    for taken in range(STEPS):  # the covariances' recursion, which diverges for an undetectable model
        innovation = C @ predicted @ C.T + R
        K = np.linalg.solve(innovation, C @ predicted).T
        P = (one - K @ C) @ predicted @ (one - K @ C).T + K @ R @ K.T
        T = np.linalg.inv(one + P @ goals) if joint else one
        following = A @ (T @ P) @ A.T + Q
        before, predicted = predicted, (following + following.T) / 2
        units = np.sqrt(np.maximum(np.diag(before), least))
        if (np.abs(predicted - before) <= SETTLED * np.outer(units, units)).all() or np.trace(predicted) > largest:
            break
        if taken == LEAP_AFTER:
            update = one - K @ C
            information = C.T @ np.linalg.solve(innovation, C) + update.T @ goals @ T @ update
            # The change D of a covariance obeys D' = F D (I + S D)^-1 F' + change, where F is the transition of the prediction's
            # error, and S the information of a sample. Pivots should not depend on the units of the states.
            scale, F = np.outer(units, units), A @ T @ update
            with suppress(np.linalg.LinAlgError):  # an undetectable model takes single steps until it has diverged
                step = (predicted - before) / scale
                leapt = before + scale * doubled(F * units / units[:, None], information * scale, step, DOUBLINGS)
                if np.isfinite(leapt).all() and np.trace(leapt) <= largest and is_covariance(leapt):
                    predicted = leapt
    weight = np.linalg.solve(GA @ P @ GA.T + N, GB)
    information = prior + GB.T @ weight
    L, M = np.linalg.solve(information, weight.T @ GA), np.linalg.solve(information, weight.T)
    by_goal = T @ P @ GA.T @ V if joint else np.zeros((len(A), len(G)))
    return Gains(*(np.asarray(gain, float) for gain in (K, L, M, T, by_goal)))


def moduli(controller: BayesianController) -> Floats:
    """Return the smallest distance of each loop from instability over all frequencies, in steady state and without limits.

    It is the distance of the loop transfer function from -1 where one control enters the plant, with the other loops closed, as
    in `cosim.control.margins`: the inverse of that control's diagonal element in the inverse of the return difference.
    """
    model = controller.model.moving
    n, m = model.states - model.disturbances, model.sensors
    A, B, C = model.matrix("A")[:n, :n], model.matrix("B")[:n], model.matrix("C")[:, :n]
    move, given, out, direct = controller.feedback()
    resonances = np.abs(np.angle(np.linalg.eigvals(controller.closed_loop_matrix())))
    angles = np.sort(np.concatenate([np.geomspace(1e-5, np.pi, FREQUENCIES), resonances[resonances > 1e-5]]))

    def distances(angles: Floats) -> Floats:
        z = np.exp(1j * angles)[:, None, None]
        of_plant = C @ np.linalg.solve(z * np.eye(n) - A, B[None] + 0j)
        of_law = out @ np.linalg.solve(z * np.eye(len(move)) - move, given[None, :, :m] + 0j) + direct[:, :m]
        inverse = np.linalg.inv(np.eye(len(out)) - of_law @ of_plant)
        return np.asarray(1.0 / np.abs(np.diagonal(inverse, axis1=1, axis2=2)))

    found = []
    for j, k in enumerate(distances(angles).argmin(axis=0)):
        around = angles[max(k - 1, 0)], angles[min(k + 1, len(angles) - 1)]
        found.append(distances(np.linspace(*around, FREQUENCIES))[:, j].min())
    return np.array(found)


__all__ = ["Gains", "moduli", "steady_gains"]
