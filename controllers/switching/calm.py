"""A process that is quieter than the model says, and what an unmodelled course is then credited with.

Process noise is often stated too large, to be on the safe side. The belief then follows the noise of the sensors, and beside one
sensor another one that does not follow that noise seems frozen or filtered; a single sensor seems too quiet. An unmodelled course
would explain either. While the innovations are smaller than expected, a course is therefore credited with the density of no fault
at most, unless the last errors of its sensor were large.
"""

from bayesftc.cosim.ops import both, maximum, minimum, select

CALM = 0.85
"""Mean squared innovation, in its expected variances, below which the process is quieter than the model says."""

LEARNED = 0.01
"""Weight of a sample in that mean."""

START = 200.0
"""Number of samples from the first one on in which small errors of a sensor that seems faulty count."""

LARGE = 9.0
"""Largest squared error, in its expected variances, that counts in a mean."""

FOLLOWED, WRONG = 0.2, 4.0
"""Weight of a sample in the mean of a sensor's last squared errors, and the mean from which on these are large."""


def surprised(surprise, square, total, spread, nominal, present, healthy, count):
    """Return the mean squared innovation after a sample, from the mean before it (``surprise``).

    The sample counts by the share of its variance (``total``) that the state has (``spread``), and that of a faulty sensor not at
    all: a filtered one has small errors as well. At the start such errors count, because a sensor may only seem faulty then, as
    the process is quiet.
    """
    ratio = minimum(square / maximum(total, spread + nominal), LARGE)
    seems = both(count < START, square < total)
    sound = present * select(seems, 1.0, minimum(healthy, 1.0))
    return surprise + LEARNED * sound * (spread / total) * (ratio - surprise)


def followed(last, square, total, present):
    """Return the mean of a sensor's last squared errors after a sample."""
    return last + present * FOLLOWED * (minimum(square / total, LARGE) - last)


def credited(density, healthy, surprise, last):
    """Return the log density with which a course is credited, from its own and that of no fault."""
    return minimum(density, select(both(surprise < CALM, last < WRONG), healthy, density))
