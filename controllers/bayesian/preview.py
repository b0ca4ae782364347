"""The goals of the regulator, also those known ahead: the gains on them, and the step function that keeps them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.ops import maximum, select
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.bayesian.riccati import Regulator

MOST = 9_999
"""Largest number of samples by which a goal may lie ahead."""


def goal_effects(
    regulator: Regulator, A: Floats, B: Floats, H: Floats, output_cost: Floats, input_cost: Floats, preview: int
) -> Floats:
    """Return the effects of the goals between the present and the last known one on the optimal control.

    The goals r_0 .. r_n are known and r_n holds from then on. With d_j = r_j - r_n, K the gain and U = ``u_of_goal``, the
    optimum of ``sum (H x - r)' Q (H x - r) + (u - u_ss)' R (u - u_ss)``, in which u_ss is that of each time's goal, is

        u = u_ss(r_n) - K (x - x_ss(r_n)) + (R + B' P B)^-1 (R U d_0 + sum_j B' E_j d_j),

    with ``E_j = (A - B K)'^(j-1) (H' Q - K' R U)`` for j = 1 .. n - 1.

    Parameters
    ----------
    regulator : Regulator
        The solution for a goal that stays.
    A, B, H : ndarray
        The plant's states without disturbances, and what has a goal of them.
    output_cost, input_cost : ndarray
        Q and R.
    preview : int
        The number n.

    Returns
    -------
    ndarray, n x p x r
        ``B' E_j`` for j = 1 .. n; the last one is zero.
    """
    closed = (A - B @ regulator.gain).T
    effect = H.T @ output_cost - regulator.gain.T @ input_cost @ regulator.u_of_goal
    effects = np.zeros((preview, B.shape[1], len(H)))
    for j in range(preview - 1):
        effects[j] = B.T @ effect
        effect = closed @ effect
    return effects


def target_steady_state(goal, x_hat, actuators, control):
    """Keep the new goal, and make the present and the later goals the target and the control prior.

    The goal prior's mean is the steady state of the last known goal, and the control prior's mean the control of the present
    goal's. The goals in between enter the information about the control. Without a preview all of them are the new one. A goal
    that is not finite keeps the last one. The first goal also counts for the times before it. Each control acts with the
    effectiveness ``works`` and the offset ``load``. The effect of a control has a cost, not the control: a weaker actuator then
    gets as much more as it lost, and the loop stays as it was designed.
    """
    x_target, u_target, feedforward, held, u_prior, control_cost = control.steady
    _, GB, _, prior_precision, prior_pull, goal_shift = control.aim
    works, load, target = actuators.works, actuators.load, control.decision.target
    r, n, p, last = goal.shape[0], x_hat.shape[0], u_prior.shape[0], held.shape[0] - 1
    for i in range(r):
        new = select(goal[i] - goal[i] == 0.0, goal[i], held[last, i])
        unset = held[0, i] - held[0, i]  # NaN before the first sample
        for j in range(last):
            held[j, i] = select(unset == 0.0, held[j + 1, i], new)
        held[last, i] = new
    for j in range(p):
        total = u_target[j, 0] * held[0, 0]
        for i in range(1, r):
            total = total + u_target[j, i] * held[0, i]
        for i in range(n):
            total = total + u_target[j, r + i] * x_hat[i]
        # A lost effect is compensated by at most five times the control.
        u_prior[j] = (total - load[1, j]) / maximum(works[1, j], 0.2)
    for j in range(p):
        for i in range(p):
            prior_precision[j, i] = control_cost[j, i] * maximum(works[1, j], 0.2) * maximum(works[1, i], 0.2)
        total = prior_precision[j, 0] * u_prior[0]
        for i in range(1, p):
            total = total + prior_precision[j, i] * u_prior[i]
        between = 0.0 * total
        for k in range(1, last):
            for i in range(r):
                between = between + feedforward[j, (k - 1) * r + i] * (held[k, i] - held[last, i])
        prior_pull[j] = total + works[1, j] * between
    for s in range(target.shape[0]):
        total = x_target[s, 0] * held[last, 0]
        for i in range(1, r):
            total = total + x_target[s, i] * held[last, i]
        for i in range(n):
            total = total + x_target[s, r + i] * x_hat[i]
        target[s] = total
        goal_shift[s] = GB[s, 0] * u_prior[0]
        for j in range(1, p):
            goal_shift[s] = goal_shift[s] + GB[s, j] * u_prior[j]


__all__ = ["MOST", "goal_effects", "target_steady_state"]
