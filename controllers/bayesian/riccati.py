"""The linear quadratic regulator behind a goal on outputs: cost-to-go, feedback gain, steady states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesftc.controllers.bayesian.stabilisability import refuse_unseen_by_goal
from bayesftc.controllers.linalg.lyapunov import stationary_covariance
from bayesftc.controllers.linalg.riccati import is_covariance
from bayesftc.controllers.models.disturbances import unmoved
from bayesftc.controllers.models.integrators import Quotient, without_integrators
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats


@dataclass(frozen=True, eq=False)
class Regulator:
    """The infinite-horizon regulator of a model and a stage cost.

    Let x be the plant's states, z the model's other states (disturbances, the constant) and r the goal. The steady state is
    ``x_ss = x_of_goal r + x_of_others z``, ``u_ss = u_of_goal r + u_of_others z``, and the law ``u = u_ss - gain (x - x_ss)``.
    A load that lasts, a state that nothing moves and that decays more slowly than the closed loop, belongs to the steady state as
    well: its counteraction, ``u_of_loads (x - x_ss)``, has no cost. In the one-step posterior it is added to the mean of the
    control, and ``x_of_loads (x - x_ss)`` to that of the next state. ``gain`` contains both.
    Integrators that the goals do not see (the position behind a speed) never settle. ``regulated`` is the plant's state space
    without them. All else is computed in it, and neither cost nor law depends on them.
    """

    cost_to_go: Floats
    gain: Floats
    x_of_goal: Floats
    x_of_others: Floats
    u_of_goal: Floats
    u_of_others: Floats
    x_of_loads: Floats
    u_of_loads: Floats
    regulated: Quotient | None = None

    @property
    def drifting(self) -> int:
        """Number of integrators that the goals do not see."""
        return 0 if self.regulated is None else self.regulated.dropped.shape[1]

    @property
    def root(self) -> Floats:
        """Return G with ``G' G = cost_to_go``, a row for each direction with a cost."""
        cost = self.cost_to_go
        if self.regulated is not None:
            cost = self.regulated.back.T @ cost @ self.regulated.back
        units = _units(cost)
        values, vectors = np.linalg.eigh(cost * np.outer(units, units))
        costly = values > 1e-14 * values[-1]
        root = np.asarray(np.sqrt(values[costly])[:, None] * vectors[:, costly].T / units)
        return root if self.regulated is None else root @ self.regulated.rows

    def poles(self, A: Floats, B: Floats) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
        """Return the closed loop's poles without the filter's, and without integrators that the goals do not see."""
        whole = A - B @ self.gain
        return np.linalg.eigvals(whole if self.regulated is None else self.regulated.of(whole)).astype(np.complex128)


def regulate(model: LinearModel, outputs: Floats, output_cost: Floats, input_cost: Floats) -> Regulator:
    """Return the regulator of ``sum (y - r)' output_cost (y - r) + (u - u_ss)' input_cost (u - u_ss)`` with ``y = outputs x``.

    Raises
    ------
    ModelError
        If the goals cannot be held in steady state, or no stabilising law exists.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    plant = model.states - model.disturbances
    A, B, H = model.matrix("A")[:plant, :plant], model.matrix("B")[:plant], outputs[:, :plant]
    others = np.vstack([model.matrix("A")[:plant, plant:], -outputs[:, plant:]])
    if len(H) > B.shape[1]:
        raise ModelError(
            f"There are {len(H)} goals but only {counted(B.shape[1], 'control')}. Each goal needs a control of its own; set "
            "goals for fewer outputs, or actuate further inputs."
        )
    reduced = without_integrators(A, H)
    if reduced is not None:
        A, B, H, others = (
            reduced.of(A),
            reduced.rows @ B,
            H @ reduced.back,
            np.vstack([reduced.rows @ others[:plant], others[plant:]]),
        )
    if not len(A):
        raise ModelError("The goals see no state of the plant, so no control moves them. Set goals for other outputs.")
    refuse_unseen_by_goal(A, H)
    try:
        solution = solve_discrete_are(A, B, H.T @ output_cost @ H, input_cost)
        to_goal, to_others = _steady(A, B, H, input_cost, others, _units(solution))
        n, loads = len(A), _loads(A, B, np.linalg.solve(input_cost + B.T @ solution @ B, B.T @ solution @ A))
        X, u_of_loads = _of_loads(A, B, H, input_cost, loads, _units(solution))
        x_of_loads = X * np.diag(A)  # after a sample, in which the loads have decayed
        if loads.any():
            # In deviations from the steady state of the present loads, only their change moves the plant, and nothing is seen.
            A, H = np.where(np.outer(~loads, loads), X - x_of_loads, A), np.where(loads, 0.0, H)
            solution = solve_discrete_are(A, B, H.T @ output_cost @ H, input_cost)
        cost, solution = H.T @ output_cost @ H, np.asarray((solution + solution.T) / 2, dtype=np.float64)
        gain = np.linalg.solve(input_cost + B.T @ solution @ B, B.T @ solution @ A)
        P = np.asarray(_of_law(A, B, gain, cost, input_cost, solution), dtype=np.float64)
        gain = np.asarray(np.linalg.solve(input_cost + B.T @ P @ B, B.T @ P @ A), dtype=np.float64)
    except ModelError:
        raise
    except (LinAlgError, ValueError) as error:
        raise ModelError(
            f"No feedback law could be computed for these weights ({str(error).rstrip('.')}). Bring the sizes of the states and "
            "of the weights of goals and controls nearer to each other."
        ) from None
    gain = gain - u_of_loads - gain @ X
    if reduced is None:
        return Regulator(P, gain, to_goal[:n], to_others[:n], to_goal[n:], to_others[n:], x_of_loads, u_of_loads)
    return Regulator(
        reduced.rows.T @ P @ reduced.rows,
        gain @ reduced.rows,
        reduced.back @ to_goal[:n],
        reduced.back @ to_others[:n],
        to_goal[n:],
        to_others[n:],
        reduced.back @ x_of_loads @ reduced.rows,
        u_of_loads @ reduced.rows,
        reduced,
    )


def _loads(A: Floats, B: Floats, gain: Floats) -> NDArray[np.bool_]:
    """Return whether each state is a load that lasts: nothing moves it, and it decays more slowly than the closed loop.

    The loop has then settled at the steady state of the load before the load has changed. Of a load that changes faster, that
    state is out of reach, and the regulator decides how much to counteract.
    """
    alone = unmoved(A, B)
    moved = ~alone
    slowest = np.abs(np.linalg.eigvals((A - B @ gain)[np.ix_(moved, moved)])).max(initial=0.0)
    return np.asarray(alone & (np.diag(A) < 1.0) & (np.diag(A) > slowest))


def _of_loads(
    A: Floats, B: Floats, H: Floats, input_cost: Floats, loads: NDArray[np.bool_], units: Floats
) -> tuple[Floats, Floats]:
    """Return the maps from the plant's state to the steady x and u that its loads cause; all else in them is zero."""
    X, U, moved = np.zeros_like(A), np.zeros((B.shape[1], len(A))), ~loads
    if loads.any():
        held = np.vstack([A[np.ix_(moved, loads)], -H[:, loads]])
        of_moved = A[np.ix_(moved, moved)], B[moved], H[:, moved]
        steady = _steady(*of_moved, input_cost, held, units[moved])[1]
        X[np.ix_(moved, loads)], U[:, loads] = steady[: moved.sum()], steady[moved.sum() :]
    return X, U


def _of_law(A: Floats, B: Floats, gain: Floats, state_cost: Floats, input_cost: Floats, P: Floats) -> Floats:
    """Return the cost-to-go of a law by Lyapunov's equation; the given one if the law has none.

    The costs of a state that no control moves, such as a gust, hardly count in the Riccati equation, and may be wrong in its
    solution, even negative.
    """
    with np.errstate(all="ignore"):  # of a law that is not stable
        cost = stationary_covariance((A - B @ gain).T, state_cost + gain.T @ input_cost @ gain)
    cost = (cost + cost.T) / 2
    return cost if np.isfinite(cost).all() and is_covariance(cost) else P


def _units(P: Floats) -> Floats:
    """Return the deviation of each state that costs 1; in these units rounding does not depend on the user's units."""
    costs = np.diag(P)
    return np.asarray(1.0 / np.sqrt(np.where(costs > 0, costs, 1.0)))


def _steady(
    A: Floats, B: Floats, H: Floats, input_cost: Floats, others: Floats, units: Floats
) -> tuple[Floats, Floats]:
    """Return the maps from the goal and from the other states to the cheapest (x_ss, u_ss), one below the other.

    ``x = A x + B u + ...`` and ``H x + ... = r`` leave as many directions free as there are more controls than goals. Of all
    solutions the one with the smallest ``u' input_cost u`` is taken, and among these the one with the smallest x, in units in
    which each state has effects of size 1.
    """
    n = len(A)
    root = np.linalg.cholesky(input_cost)
    change = (np.eye(n) - A) * np.outer(1 / units, units)
    effect = np.linalg.solve(root, B.T).T / units[:, None]  # of controls whose cost is the sum of their squares
    M = np.block([[change, -effect], [H * units, np.zeros((len(H), B.shape[1]))]])
    scale = np.linalg.norm(M, axis=1)
    M = M / np.where(scale > 0, scale, 1.0)[:, None]
    lengths = np.linalg.norm(M[:, :n], axis=0)  # a state that the goals do not need costs nothing, and has no unit yet
    columns = np.concatenate([1.0 / np.where(lengths > 0, lengths, 1.0), np.ones(B.shape[1])])
    left, sizes, right = np.linalg.svd(M * columns)
    if sizes[-1] <= 1e-8 * sizes[0]:  # models by pulse responses are accurate to about 1e-9
        raise ModelError(
            "The goals cannot each be held at a value of its own in steady state. Either a constant control does not move an "
            "output (the plant has a zero at 1), or the goals depend on each other, or the acceptable error is so large that the "
            "goals have no effect. Set goals for other outputs, or a smaller acceptable_error (goal_covariance)."
        )
    rhs = np.block([[np.zeros((n, len(H))), others[:n] / units[:, None]], [np.eye(len(H)), others[n:]]])
    whole = right[: len(sizes)].T @ ((left.T @ (rhs / scale[:, None])) / sizes[:, None])
    free = right[len(sizes) :].T
    if free.shape[1]:
        whole = whole - free @ np.linalg.pinv(free[n:]) @ whole[n:]
    whole = columns[:, None] * whole
    whole = np.vstack([units[:, None] * whole[:n], np.linalg.solve(root.T, whole[n:])])
    return whole[:, : len(H)], whole[:, len(H) :]
