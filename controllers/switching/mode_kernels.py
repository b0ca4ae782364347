"""Step functions of fault modes: how probable a sample is if its sensor has failed in one way, and what is learned from it then.

Each has the arguments of `drops` below: one sample of one sensor, and where the mode's numbers stand. It returns the logarithm of
the sample's density, which counts only if there is a sample; what it writes as the `FACTOR` is still to be multiplied with that.
"""

from bayesftc.controllers.linalg.special import LOG_2_PI, squared_gamma_half_step
from bayesftc.controllers.switching.course import COURSE, follow, misfit
from bayesftc.cosim.ops import absolute, log, maximum, minimum, select, sqrt

WEIGHT, ENTERED, FACTOR, AGE, TRUST, SIZE, OWN = range(7)
"""Places in the block of a mode: two for the switching; a factor of the density, 1 unless it is written, for a root is cheaper
than its logarithm; the age; the precision that a sample deserves (nominal: 1); the size; own."""

FURTHEST = 1e12
"""Largest squared innovation, in units of its variance, that a density is computed of: it is held there."""


def log_density(squared, variance):
    """Return the logarithm of a normal density where the error has this square."""
    return -0.5 * (squared / variance + log(variance) + LOG_2_PI)


def wider(squared, variance, noise, doubt):
    """Return the logarithm of Student's t density over the normal one of the same scale: that of a healthy sensor's error.

    Its noise has been learned only up to a ``doubt``, the inverse of the degrees of freedom (0: none), and is a part of the
    error's variance. The logarithm of 1 + x is that by Pade's approximation, which is cheaper and right within 3 % up to x = 5:
    with five degrees of freedom up to five standard deviations. Beyond, the tails are lighter. The constant of the density is
    its series' first term.
    """
    one = 1.0 / variance
    part, each = noise * one, squared * one
    doubt = doubt * part * part
    x = each * doubt
    log1p_over_x = (30.0 + x * (21.0 + x)) / (30.0 + x * (36.0 + 9.0 * x))
    return 0.5 * (each - (each + x) * log1p_over_x - 0.5 * doubt)


def drops(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Send nothing; a sample that comes all the same is a healthy one.

    Parameters
    ----------
    e : float
        Innovation, held within a million of its standard deviations; 0 for a missing sample.
    present : float
        1 if there is a sample, else 0.
    variance, nominal : float
        Variance of a healthy sensor's innovation, and the part of its noise in it.
    change : float
        The sample minus the last one that there was; NaN if there is none.
    healthy : float
        Logarithm of the sample's density if the sensor is healthy and its noise is as believed.
    memory : array
        What is kept; the mode's block begins at the place ``at``. ``memory[at + ENTERED]`` is the probability that the mode
        begins with this sample, if it is the sensor's mode at all: only to be read. It may write the precision in nominal ones
        that the sample deserves (``memory[at + TRUST]``), the fault's size (``SIZE``), a factor of the density beside the
        logarithm that it returns (``FACTOR``), and its own numbers from ``memory[at + OWN]`` on.
    settings : array
        The mode's settings stand from the place ``first`` on.
    """
    return healthy


def freezes(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Repeat the last sample, exactly or with a dither far below the noise.

    ``settings``: half the resolution in the sensor's unit; the logarithms of the density of an exact repetition, and of that of
    another sample with no dither at all; the dither's variance. A repetition has a probability, to which a density over the
    resolution corresponds: so equal samples tell nothing beyond what a coarse resolution explains. That healthy samples repeat
    themselves more often than this resolution says is seen to where modes are weighed (``sensor_kernels.py``).
    """
    near = settings[first + 2] - 0.5 * (change * change / settings[first + 3])
    told = select(absolute(change) <= settings[first], settings[first + 1], near)
    return select(change == change, told, healthy)


def expected_jump(e, jump, reach, nominal):
    """Return the variance of an offset at its onset, in the sensor's unit squared: at least as large as the first innovation.

    So an offset far beyond what was expected is not taken for noise, as if any larger scale were as likely as ``jump`` itself.
    One that grows from zero has none: its ``reach`` is 0, that of others 1.
    """
    return maximum(jump * nominal, reach * (e * e))


def shifts(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Add an offset c that moves by b a sample: each starts at zero, uncertain, and is then filtered.

    ``settings``, in units of the noise's variance: how uncertain c is at the start; likewise b; how far c walks in a sample; the
    reach of `expected_jump`. Own numbers: b; the covariance of c and b. Onsets and offsets that have been there are merged into
    one Gaussian distribution, as interacting multiple models do.
    """
    jump, slope = expected_jump(e, settings[first], settings[first + 3], nominal), settings[first + 1] * nominal
    walk = settings[first + 2] * nominal
    c, b = memory[at + SIZE] + memory[at + OWN], memory[at + OWN]
    cc = memory[at + OWN + 1] + 2.0 * memory[at + OWN + 2] + memory[at + OWN + 3] + walk
    cb = memory[at + OWN + 2] + memory[at + OWN + 3]
    bb = memory[at + OWN + 3]
    begins = memory[at + ENTERED]
    lasts = 1.0 - begins
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
    """Have noise of another precision, which is gamma distributed and learned from the innovations (paper, section 3.2).

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
    told = healthy + 0.5 * each - (a + 0.5) * log(1.0 + 0.5 * squared)
    b = b + 0.5 * present * squared * b
    a = a + 0.5 * present
    part = 1.0 / (a * b)
    memory[at + OWN] = a
    memory[at + OWN + 1] = b
    memory[at + TRUST] = minimum(a * a * part, 1.0)
    memory[at + SIZE] = sqrt(b * b * part)
    return told


def goes_its_way(e, present, variance, nominal, change, healthy, memory, at, settings, first):
    """Go a course of its own, which is learned (``course.py``). Own numbers: what is kept of the course, and scratch space."""
    deviation, own = sqrt(nominal), at + OWN
    told = follow(
        e / deviation, change / deviation, present, memory[at + ENTERED], memory, own, own + COURSE, settings, first
    )  # fmt: skip
    memory[at + SIZE] = misfit(memory, own)
    return select(change == change, told - log(deviation), healthy)
