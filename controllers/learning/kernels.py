"""Backward through a recording: what each sensor's mode was, given all samples, and how large its faults were at their onsets.

Going back, what a filter says of a sensor's mode at a sample is corrected by what is known of the mode one sample later (Kim,
J. Econometrics 60, 1994). That is exact if a sample depends on its own mode only; with moments that are merged, as those of
offsets are, it is an approximation.
"""

from bayesftc.cosim.ops import square

_TABLE, _TABLES = "float64[:, ::1]", "float64[:, :, ::1]"
SMOOTH = f"void({_TABLES}, float64[::1], float64[::1], {_TABLES}, {_TABLES}, {_TABLE})"
OFFSETS = (
    f"void({_TABLES}, {_TABLES}, {_TABLE}, {_TABLE}, float64[::1], int64, float64, float64, float64, float64[::1])"
)
SCATTER = f"void({_TABLES}, {_TABLES}, {_TABLE}, {_TABLE}, int64, float64, float64, float64, float64[::1])"
"""What the passes are compiled for."""

ONSETS, RECOVERIES, HEALTHY, FAULTY = range(4)
"""What is counted for each mode: onsets, recoveries, and samples before which the sensor was healthy or in the mode."""


def smooth(filtered, begins, ends, begun, lasts, counts):
    """Count how often each mode begins and ends, and for how long it lasts.

    Parameters
    ----------
    filtered : array, steps x sensors x (1 + modes)
        Probability of each mode given the samples so far, of being healthy first.
    begins, ends : array
        Of each mode, the probabilities per sample.
    begun, lasts : array, steps x sensors x modes
        Written: the probability given all samples that a mode begins with this one; and that it lasts to the next one, if it is
        there.
    counts : array, 4 x modes
        Added to: expected numbers of them.
    """
    steps, sensors, modes = filtered.shape[0], filtered.shape[1], begins.shape[0]
    stays = 1.0
    for k in range(modes):
        stays -= begins[k]
    for i in range(sensors):
        for k in range(modes):
            begun[0, i, k] = filtered[steps - 1, i, 1 + k]  # until it is known better: the mode after the last sample
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
                known = begun[0, i, k] / (was * begins[k] + p * (1.0 - ends[k]))
                new, old, over = was * begins[k] * known, p * (1.0 - ends[k]) * known, p * ends[k] * healed
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


def measure_offsets(begun, lasts, e, variance, nominal, k, jump, slope, walk, totals):
    """Add up the expected squares of the offsets and their slopes at the onsets of a mode.

    What the samples from an onset on say of offset and slope comes from an information filter that runs backward; it forgets
    what lies beyond the mode's end.

    Parameters
    ----------
    begun, lasts : array, steps x sensors x modes
        From `smooth`.
    e, variance : array, steps x sensors
        Innovations, NaN where there is no sample, and their variances with healthy sensors.
    nominal : array
        Of each sensor, the variance of its noise.
    k : int
        The mode.
    jump, slope, walk : float
        Variances of the mode's offset at its onset, of its slope, and of its walk, in those of the noise.
    totals : array
        Added to: the number of onsets, the squares of the offsets, those of the slopes, in variances of the noise.
    """
    for i in range(e.shape[1]):
        cc, cb, bb, c, b = 0.0, 0.0, 0.0, 0.0, 0.0  # information: matrix and vector
        J, B, q = jump * nominal[i], slope * nominal[i], walk * nominal[i]
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
                totals[1] += weight * (Vj + square(Vj * c + Vjb * s)) / nominal[i]
                totals[2] += weight * (Vb + square(Vjb * c + Vb * s)) / nominal[i]


def measure_scatter(begun, lasts, e, variance, k, shape, rate, forgetting, totals):
    """Add up the expected precisions, in nominal ones, at the onsets of a mode whose noise is gamma distributed.

    Parameters
    ----------
    begun, lasts, e, variance, k
        As of `measure_offsets`.
    shape, rate : float
        Of the gamma distribution at the onset.
    forgetting : float
        Factor per sample.
    totals : array
        Added to: the number of onsets, the precisions.
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
