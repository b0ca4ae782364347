"""The sensors' errors after the update, for learners that iterate between belief and sensor covariance within one sample.

A learner sees the prediction only through the sensors: the innovations e and their spread C P C'. That suffices. With
``C P C' = F F'`` the predicted samples are F z with z standard normal. Kalman's update of z by the samples is the update of the
belief as far as the sensors see it.
"""

from bayesftc.controllers.estimation.filter import Belief, UpdateSpace, measure
from bayesftc.controllers.linalg.dense import cholesky_semidefinite, congruence
from bayesftc.controllers.precision.base import ERROR_CAP
from bayesftc.cosim.ops import maximum, minimum, sqrt

WORK = 14
"""Number of m x m matrices that `errors_after` needs; its result is in the first one."""

MOST_ITERATIONS = 20
"""Largest number of iterations a sample; a step function is compiled for each number."""


def prepare(e, spread, nominal, work):
    """Prepare a sample's innovations and their spread. Innovations are limited to 1e12 standard deviations."""
    for i in range(e.shape[0]):
        largest = ERROR_CAP * sqrt(nominal[i, i])
        work[2][0, i] = maximum(minimum(e[i], largest), -largest)
    cholesky_semidefinite(spread, work[1])


def errors_after(present, R, work):
    """Update the belief with the sensor covariance `R`, and write ``E[(y - C x)(y - C x)']`` under it into ``work[0]``.

    It is r r' + C P C' with the residual r = y - C x_hat. Call `prepare` first, once a sample. Rows and columns of missing
    sensors have no meaning.
    """
    m = R.shape[0]
    F, identity, zero, P = work[1], work[3], work[4], work[5]
    z, r = work[6], work[7]
    for i in range(m):
        zero[0, i] = 0.0
        for j in range(m):
            identity[i, j] = 1.0 if i == j else 0.0
    space = UpdateSpace(work[8], work[9], work[10][0], work[11][0], r[0], work[12], work[13])
    measure(work[2][0], present, R, F, Belief(zero[0], identity, z[0], P), space)
    congruence(F, P, work[12], work[0])
    for i in range(m):
        r[0, i] = work[2][0, i]
        for k in range(m):
            r[0, i] = r[0, i] - F[i, k] * z[0, k]
    for i in range(m):
        for j in range(m):
            work[0][i, j] = work[0][i, j] + r[0, i] * r[0, j]
