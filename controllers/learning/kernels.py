"""The backward pass through a recording: each sensor's modes given all samples, and the faults' sizes at their onsets.

The backward pass corrects the filtered probabilities of a sensor's mode by those one sample later (Kim, J. Econometrics 60,
1994). It is exact if a sample depends on its own mode only. With merged moments, such as those of offsets, it is approximate.
"""

from bayesftc.cosim.ops import square

_TABLE, _TABLES = "float64[:, ::1]", "float64[:, :, ::1]"
SMOOTH = f"void({_TABLES}, {_TABLE}, {_TABLES}, {_TABLES}, {_TABLE})"
OFFSETS = (
    f"void({_TABLES}, {_TABLES}, {_TABLE}, {_TABLE}, float64[::1], int64, float64, float64, float64, float64[::1])"
)
SCATTER = f"void({_TABLES}, {_TABLES}, {_TABLE}, {_TABLE}, int64, float64, float64, float64, float64[::1])"
"""Types for which the passes are compiled."""

ONSETS, RECOVERIES, HEALTHY, FAULTY = range(4)
"""Counts of each mode: onsets, recoveries, and samples before which the sensor was healthy or in the mode."""


def smooth(filtered, chances, begun, lasts, counts):
    """Count how often each mode begins and ends, and how long it lasts.

    Parameters
    ----------
    filtered : array, steps x sensors x (1 + modes)
        Probability of each mode given the samples so far, healthy first.
    chances : array, 3 x modes
        Probabilities per sample that each mode begins, lasts and ends.
    begun, lasts : array, steps x sensors x modes
        Written: the probability given all samples that a mode begins with this sample; and that a present mode lasts to the next
        sample.
    counts : array, 4 x modes
        Increased by the expected counts.
    """
    steps, sensors, modes = filtered.shape[0], filtered.shape[1], chances.shape[1]
    begins, stay, ends = chances[0], chances[1], chances[2]
    stays = 1.0
    for k in range(modes):
        stays -= begins[k]
    for i in range(sensors):
        for k in range(modes):
            begun[0, i, k] = filtered[
                steps - 1, i, 1 + k
            ]  # work space for the mode's probability, at first after the last sample
            lasts[steps - 1, i, k] = 0.0
        sound = filtered[steps - 1, i, 0]
        for back in range(steps - 1):
            t = steps - 1 - back
            was = filtered[t - 1, i, 0]
            expected = was * stays
            for k in range(modes):
                expected += filtered[t - 1, i, 1 + k] * ends[k]
            healed = sound / expected
            sound = was * stays * healed
            for k in range(modes):
                p = filtered[t - 1, i, 1 + k]
                factor = begun[0, i, k] / (was * begins[k] + p * stay[k])
                new, old, over = was * begins[k] * factor, p * stay[k] * factor, p * ends[k] * healed
                begun[t, i, k] = new
                lasts[t - 1, i, k] = old / (old + over) if old + over > 0.0 else 0.0
                begun[0, i, k] = old + over
                sound += new
                counts[ONSETS, k] += new
                counts[RECOVERIES, k] += over
                counts[FAULTY, k] += old + over
            for k in range(modes):
                counts[HEALTHY, k] += sound
        for k in range(modes):  # before the first sample every sensor was healthy
            counts[ONSETS, k] += begun[0, i, k]
            counts[HEALTHY, k] += 1.0


def measure_offsets(begun, lasts, e, variance, units, k, jump, slope, walk, totals):
    """Add up the expected squares of the offsets and their slopes at the onsets of a mode.

    The information of the samples from an onset on comes from an information filter that runs backward. It forgets samples beyond
    the mode's end.

    Parameters
    ----------
    begun, lasts : array, steps x sensors x modes
        From `smooth`.
    e, variance : array, steps x sensors
        Innovations, NaN where there is no sample, and their variances with healthy sensors.
    units : array
        Unit of the squares for each sensor, see `SwitchingPrecision.offset_units`.
    k : int
        The mode.
    jump, slope, walk : float
        Variances of the mode's offset at its onset, of its slope, and of its walk, in these units.
    totals : array
        Increased by the number of onsets, and by the squares of offsets and of slopes in these units.
    """
    for i in range(e.shape[1]):
        cc, cb, bb, c, b = 0.0, 0.0, 0.0, 0.0, 0.0  # information: matrix and vector
        J, B, q = jump * units[i], slope * units[i], walk * units[i]
        for back in range(e.shape[0]):
            t = e.shape[0] - 1 - back
            keep = lasts[t, i, k]
            part = q / (1.0 + q * cc)
            c, b = c - cc * part * c, b - cb * part * c
            cc, cb, bb = cc - cc * part * cc, cb - cc * part * cb, bb - cb * part * cb
            cc, cb, bb = keep * cc, keep * (cc + cb), keep * (cc + 2.0 * cb + bb)
            c, b = keep * c, keep * (c + b)
            if e[t, i] == e[t, i]:
                cc += 1.0 / variance[t, i]
                c += e[t, i] / variance[t, i]
            weight = begun[t, i, k]
            if weight > 0.0:
                # The offset at the onset is c = j + b: jump and slope are independent before the samples.
                jb, ss, s = cc + cb, cc + 2.0 * cb + bb, c + b
                over = 1.0 / ((1.0 + J * cc) * (1.0 + B * ss) - J * B * square(jb))
                Vj, Vb, Vjb = J * (1.0 + B * ss) * over, B * (1.0 + J * cc) * over, -J * B * jb * over
                totals[0] += weight
                totals[1] += weight * (Vj + square(Vj * c + Vjb * s)) / units[i]
                totals[2] += weight * (Vb + square(Vjb * c + Vb * s)) / units[i]


def measure_scatter(begun, lasts, e, variance, k, shape, rate, forgetting, totals):
    """Add up the expected precisions, in nominal ones, at the onsets of a mode with gamma distributed precision.

    Parameters
    ----------
    begun, lasts, e, variance, k
        See `measure_offsets`.
    shape, rate : float
        The gamma distribution at the onset.
    forgetting : float
        Forgetting factor per sample.
    totals : array
        Increased by the number of onsets and by the precisions.
    """
    for i in range(e.shape[1]):
        a, b = 0.0, 0.0
        for back in range(e.shape[0]):
            t = e.shape[0] - 1 - back
            keep = lasts[t, i, k] * forgetting
            a, b = keep * a, keep * b
            if e[t, i] == e[t, i]:
                a += 0.5
                b += 0.5 * square(e[t, i]) / variance[t, i]
            totals[0] += begun[t, i, k]
            totals[1] += begun[t, i, k] * (shape + a) / (rate + b)
