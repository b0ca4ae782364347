"""Step functions of fault modes: the density of a sample if its sensor has failed in one way, and learning from it.

Each has the arguments of `drops` below: one sample of one sensor, and the place of the mode's numbers. It returns the sample's
log density, which counts only if there is a sample. The `FACTOR` that it writes is a further factor of the density.
"""

from bayesftc.controllers.linalg.special import LOG_2_PI, squared_gamma_half_step
from bayesftc.controllers.switching.calm import credited, followed
from bayesftc.controllers.switching.course import COURSE, COURSE_SCRATCH, follow, misfit
from bayesftc.cosim.ops import absolute, log, maximum, minimum, select, sqrt

WEIGHT, ENTERED, FACTOR, AGE, TRUST, SIZE, OWN = range(7)
"""Places in the block of a mode: two for the switching; a factor of the density, 1 unless it is written, because a root is faster
than its logarithm; the age; the precision of the sample (nominal: 1); the size; further numbers of the mode."""

LAST_ERRORS = OWN + COURSE + COURSE_SCRATCH
SURPRISE = LAST_ERRORS + 1
"""Places in the block of `regresses`: the mean of the sensor's last squared errors, and of all sensors' squared innovations."""

FURTHEST = 1e12
"""Largest squared innovation for a density, in units of its variance; larger ones are limited to it."""


def log_density(squared, variance):
    """Return the log of a normal density at an error with this square."""
    return -0.5 * (squared / variance + log(variance) + LOG_2_PI)


def wider(squared, variance, noise, doubt):
    """Return the log ratio of Student's t density to the normal one of the same scale, for a healthy sensor's error.

    The sensor's noise, a part of the error's variance, is learned only up to a ``doubt``, the inverse of the degrees of freedom
    (0: certain). The logarithm of 1 + x is Pade's approximation, which is faster, with an error below 3 % up to x = 5: with five
    degrees of freedom up to five standard deviations. Beyond, the tails are lighter. The density's constant is the first term of
    its series.
    """
    one = 1.0 / variance
    part, each = noise * one, squared * one
    doubt = doubt * part * part
    x = each * doubt
    log1p_over_x = (30.0 + x * (21.0 + x)) / (30.0 + x * (36.0 + 9.0 * x))
    return 0.5 * (each - (each + x) * log1p_over_x - 0.5 * doubt)


def drops(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Send nothing; a sample that arrives anyway counts as a healthy one.

    Parameters
    ----------
    e : float
        Innovation, limited to a million standard deviations; 0 for a missing sample.
    present : float
        1 if there is a sample, else 0.
    variance, nominal : float
        Variance of a healthy sensor's innovation, and the part of it due to the sensor's noise.
    change : float
        The sample minus the last present one; NaN if there is none.
    healthy : float
        Log density of the sample if the sensor is healthy with the learned noise.
    memory : array
        The mode's block begins at the place ``at``. ``memory[at + ENTERED]`` is the probability that the mode begins with this
        sample, given that it is the sensor's mode; do not write it. The function may write the precision of the sample relative
        to the nominal one (``memory[at + TRUST]``), the fault's size (``SIZE``), a smaller mean age (``AGE``), a factor of the
        density besides the returned logarithm (``FACTOR``), and its own numbers from ``memory[at + OWN]`` on.
    settings : array
        The mode's settings are from the place ``first`` on.
    """
    return healthy


def freezes(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Repeat the last sample, exactly or with a dither far below the noise.

    ``settings``: half the resolution in the sensor's unit; the log densities of an exact repetition and of another sample without
    dither; the dither's variance. A repetition has a probability, which becomes a density over the resolution. Equal samples
    therefore give no evidence beyond what a coarse resolution explains. Repetitions of healthy sensors beyond their resolution
    are handled where modes are weighted (``sensor_kernels.py``).
    """
    near = settings[first + 2] - 0.5 * (change * change / settings[first + 3])
    logp = select(absolute(change) <= settings[first], settings[first + 1], near)
    return select(change == change, logp, healthy)


def expected_jump(e, jump, reach, nominal):
    """Return the variance of an offset at its onset, in squared units of the sensor: at least the squared first innovation.

    An offset far beyond the expected size is therefore not attributed to noise, as if any larger scale were as likely as
    ``jump``. An offset that grows from zero has the ``reach`` 0, others 1.
    """
    return maximum(jump * nominal, reach * (e * e))


def shifts(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Add an offset c that changes by b a sample: both begin uncertain, with mean zero, and are then filtered.

    ``settings``, in units of the noise's variance: variances of c and b at the onset; variance of c's walk per sample; the reach
    of `expected_jump`. Own numbers: b; the covariance of c and b. New and existing offsets are merged into one Gaussian
    distribution, as in interacting multiple models.
    """
    jump, slope = expected_jump(e, settings[first], settings[first + 3], nominal), settings[first + 1] * nominal
    walk = settings[first + 2] * nominal
    c, b = memory[at + SIZE] + memory[at + OWN], memory[at + OWN]
    cc = memory[at + OWN + 1] + 2.0 * memory[at + OWN + 2] + memory[at + OWN + 3] + walk
    cb = memory[at + OWN + 2] + memory[at + OWN + 3]
    bb = memory[at + OWN + 3]
    begins = memory[at + ENTERED]
    lasts = 1.0 - begins
    # If an offset that begins with this sample explains it better than the existing one, the mean age decreases. (1 + x / 8)^8
    # replaces e^x, which takes longer: it is accurate for small x, and an onset less probable than 1e-5 is noticed less.
    old, new = variance + cc, variance + jump + slope
    worse = 1.0 + maximum(0.0625 * ((e - c) * (e - c) / old - e * e / new), 0.0)
    worse = worse * worse
    worse = worse * worse
    lasted = sqrt(new / old)
    younger = minimum(lasted / (begins * (worse * worse) + lasts * lasted), 1.0)
    memory[at + AGE] = memory[at + AGE] * select(present > 0.5, younger, 1.0)
    apart = begins * lasts
    cc = lasts * cc + begins * (jump + slope) + apart * c * c
    cb = lasts * cb + begins * slope + apart * c * b
    bb = lasts * bb + begins * slope + apart * b * b
    c, b = lasts * c, lasts * b
    error = e - c
    total = variance + cc
    inverse = 1.0 / total
    part = present * inverse
    gain_c, gain_b = cc * part, cb * part
    memory[at + SIZE] = c + gain_c * error
    memory[at + OWN] = b + gain_b * error
    memory[at + OWN + 1] = cc - gain_c * cc
    memory[at + OWN + 2] = cb - gain_c * cb
    memory[at + OWN + 3] = maximum(bb - gain_b * cb, 0.0)
    memory[at + FACTOR] = sqrt(variance * inverse)
    return healthy + 0.5 * (e * e / variance - error * error * inverse)


def scatters(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Have noise of another precision, gamma distributed and learned from the innovations (paper, section 3.2).

    ``settings``: shape and rate of the prior, the forgetting factor. Own numbers: shape, rate. The size is the standard deviation
    in nominal ones.
    """
    a0, b0, rho = settings[first], settings[first + 1], settings[first + 2]
    kept = (1.0 - memory[at + ENTERED]) * rho
    a = kept * memory[at + OWN] + (1.0 - kept) * a0
    b = kept * memory[at + OWN + 1] + (1.0 - kept) * b0
    each, part = e * e / variance, 1.0 / b
    squared = each * part
    memory[at + FACTOR] = sqrt(squared_gamma_half_step(a) * part)
    logp = healthy + 0.5 * each - (a + 0.5) * log(1.0 + 0.5 * squared)
    b = b + 0.5 * present * squared * b
    a = a + 0.5 * present
    part = 1.0 / (a * b)
    memory[at + OWN] = a
    memory[at + OWN + 1] = b
    memory[at + TRUST] = minimum(a * a * part, 1.0)
    memory[at + SIZE] = sqrt(b * b * part)
    return logp


def regresses(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Follow an unmodelled course, which is learned (``course.py``), with the rule for a quiet process (``calm.py``).

    Own numbers: the course's, scratch space, `LAST_ERRORS`; the learner writes `SURPRISE`.
    """
    deviation, start = sqrt(nominal), at + OWN
    logp = follow(
        e / deviation,
        change / deviation,
        present,
        memory[at + ENTERED],
        memory,
        start,
        start + COURSE,
        settings,
        first,
        0.0,
    )
    memory[at + SIZE] = misfit(memory, start)
    last = followed(memory[at + LAST_ERRORS], e * e, variance, present)
    memory[at + LAST_ERRORS] = last
    logp = credited(logp - log(deviation), healthy, memory[at + SURPRISE], last)
    return select(change == change, logp, healthy)
