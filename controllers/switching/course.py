"""The unmodelled course of a failed sensor: its innovations as a linear regression that is learned online.

The innovation r, in the sensor's nominal standard deviations, is explained by three regressors:

1. one: an offset;
2. the last innovation: a wandering offset;
3. the prediction without its slow part: a sensor of another gain, or one that is frozen, filtered or late and follows too little.

Coefficients and noise have a normal-gamma distribution. Its natural parameters decay towards those of the prior (stabilised
exponential forgetting; Kulhavy and Zarrop 1993). The noise may therefore be of any scale: a sensor that is too quiet is as
suspicious as a noisy one, unless the process is quiet (``calm.py``). A sample's density is Student's t (Bishop 2006,
exercise 3.13).
"""

from bayesftc.controllers.linalg.special import LOG_2_PI, squared_gamma_half_step
from bayesftc.cosim.ops import both, log, maximum, select, sqrt

ORDER = 3
"""Number of regressors."""

WEIGHTS, PULLS, SHAPE, RATE, LAST_ERROR, LEVEL, EQUALS, COUNTED, COURSE = 0, 9, 12, 13, 14, 15, 16, 17, 18
"""Places in the memory: the coefficients' precision (lower triangle of a table), its product with their mean, shape and rate of
the noise's precision (the rate is that for coefficients of zero), the last innovation, the prediction without its slow part, the
numbers of repetitions and of samples. COURSE is the length."""

ROOT, REGRESSORS, SOLVED, REACHED, COURSE_SCRATCH = 0, 9, 12, 15, 18
"""Places in the scratch space: the Cholesky factor of the precision, the regressors, the solutions for both; and its length."""

FORGETTING, FADING, SHAPE0, RATE0, MEANS, WEIGHTS0, EQUALS0, COUNTED0 = 0, 1, 2, 3, 4, 7, 10, 11
"""Places in the settings: the forgetting factor of the regression and of the level, the prior's shape and rate, the coefficients'
means and precisions, the expected numbers of repetitions and of samples."""

LASTS = 20.0
"""Number of repetitions in succession from which on a course is a freeze."""

LEAST_RATE = 1e-6
"""Least rate of the noise's precision, so that samples that repeat exactly do not make it infinitely precise."""


def follow(r, change, present, entered, memory, at, scratch, settings, first, least):
    """Return the log density of an innovation on an unmodelled course, and learn from it.

    Parameters
    ----------
    r, change : float
        The innovation, and the sample's difference from the last one, in nominal standard deviations.
    present : float
        1 if there is a sample; else 0, and nothing is learned.
    entered : float
        Probability that this course begins with this sample.
    memory : array
        The regression's numbers are from the place ``at`` on, scratch space from ``scratch`` on.
    settings : array
        The settings are from the place ``first`` on.
    least : float
        Least variance of the density.
    """
    kept = (1.0 - entered) * settings[first + FORGETTING]
    fresh = 1.0 - kept
    step = select(change == change, change - r + memory[at + LAST_ERROR], 0.0)
    level = settings[first + FADING] * memory[at + LEVEL] + step
    phi, root, solved, reached = scratch + REGRESSORS, scratch + ROOT, scratch + SOLVED, scratch + REACHED
    memory[phi] = 1.0 + 0.0 * r
    memory[phi + 1] = memory[at + LAST_ERROR]
    memory[phi + 2] = level
    shape = kept * memory[at + SHAPE] + fresh * settings[first + SHAPE0]
    rate = kept * memory[at + RATE] + fresh * settings[first + RATE0]
    explained, mean, spread = 0.0 * r, 0.0 * r, 1.0 + 0.0 * r
    for i in range(ORDER):
        row, weight = at + WEIGHTS + ORDER * i, settings[first + WEIGHTS0 + i]
        for j in range(i + 1):
            memory[row + j] = kept * memory[row + j]
        memory[row + i] = memory[row + i] + fresh * weight
        memory[at + PULLS + i] = kept * memory[at + PULLS + i] + fresh * weight * settings[first + MEANS + i]
        x, z = memory[at + PULLS + i], memory[phi + i]
        for j in range(i):
            total = memory[row + j]
            for k in range(j):
                total = total - memory[root + ORDER * i + k] * memory[root + ORDER * j + k]
            total = total * memory[root + ORDER * j + j]  # the diagonal has the inverse of the pivot
            memory[root + ORDER * i + j] = total
            x = x - total * memory[solved + j]
            z = z - total * memory[reached + j]
        pivot = memory[row + i]
        for k in range(i):
            pivot = pivot - memory[root + ORDER * i + k] * memory[root + ORDER * i + k]
        inverse = 1.0 / sqrt(maximum(pivot, 1e-12 * weight))
        memory[root + ORDER * i + i] = inverse
        x, z = x * inverse, z * inverse
        memory[solved + i] = x
        memory[reached + i] = z
        explained, mean, spread = explained + x * x, mean + x * z, spread + z * z
    scale = maximum(maximum(rate - 0.5 * explained, LEAST_RATE) * spread, shape * least)
    error = r - mean
    density = 0.5 * log(squared_gamma_half_step(shape) / scale) - (shape + 0.5) * log(
        1.0 + 0.5 * (error * error / scale)
    )
    for i in range(ORDER):
        for j in range(i + 1):
            here = at + WEIGHTS + ORDER * i + j
            memory[here] = memory[here] + present * memory[phi + i] * memory[phi + j]
        memory[at + PULLS + i] = memory[at + PULLS + i] + present * memory[phi + i] * r
    memory[at + SHAPE] = shape + 0.5 * present
    memory[at + RATE] = rate + 0.5 * present * r * r
    memory[at + LAST_ERROR] = select(present > 0.5, r, memory[at + LAST_ERROR])
    memory[at + LEVEL] = select(present > 0.5, level, memory[at + LEVEL])
    return density - 0.5 * LOG_2_PI


def repeats_share(equal, present, entered, memory, at, settings, first):
    """Return the share of samples that repeat exactly on this course, and count this sample (``equal``: 1 or 0).

    A sensor that sticks now and then, for example by clipping, therefore remains on one course. The share is beta distributed,
    and forgotten like the regression.
    """
    kept = (1.0 - entered) * settings[first + FORGETTING]
    fresh = 1.0 - kept
    equals = kept * memory[at + EQUALS] + fresh * settings[first + EQUALS0]
    counted = kept * memory[at + COUNTED] + fresh * settings[first + COUNTED0]
    memory[at + EQUALS] = equals + present * equal
    memory[at + COUNTED] = counted + present
    return equals / counted


def stuck(memory, at, settings, first):
    """Return 1 if the course is a freeze, because its last samples repeat (`LASTS` or more); else 0.

    Where a sensor is coarse the hypothesis of a freeze may come too late: healthy ones repeat samples, too.
    """
    others = memory[at + COUNTED] - memory[at + EQUALS]
    expected = settings[first + COUNTED0] - settings[first + EQUALS0]
    return select(both(memory[at + COUNTED] >= LASTS, others - expected <= 0.5), 1.0, 0.0)


def misfit(memory, at):
    """Return the root mean square of the innovations, in nominal standard deviations."""
    return sqrt(memory[at + RATE] / memory[at + SHAPE])
