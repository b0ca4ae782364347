"""The particle filter of the bound, compiled: hypotheses branch, are weighted by the samples, and are resampled.

A hypothesis is a history of the modes of all sensors. Given one, the plant's state is normally distributed: a Kalman filter
keeps its mean and variance. For the future of a sensor only a code matters: `HEALTHY`, `FROZEN`, `INJECTED`, or `DRIFTING` plus
the age of the drift in steps. Hypotheses are in one of two buffers ``floats`` (3 x capacity: logarithm of the weight, mean,
variance) and ``codes`` (sensors x capacity), and branch into the other.
"""

import numpy as np

from bayesftc.cosim.ops import exp, log
from bayesftc.cosim.stepping.numba_called import callee

HEALTHY, FROZEN, INJECTED, DRIFTING = range(4)
LOG_WEIGHT, MEAN, VARIANCE = range(3)
STAYS, BEGINS, ENDS, LASTS, SENSOR_VARIANCE, INJECTION, SLOPE, KEPT, CONTROL, PROCESS_VARIANCE = range(10)
"""Indices in the model: the logarithms of the probabilities that a healthy sensor stays healthy or fails in a certain way, and
that a faulty one recovers or not; variance of a sample; injection; drift per step; the plant, x' = KEPT x + CONTROL u + noise."""

MOST_ROWS, MOST_COLUMNS, MOST_CODES = 100, 500_000, 1_024
"""Limits of the grid on which hypotheses are merged, and number of its codes; beyond a limit the last cell is used."""

SIGNATURE = (
    "void(float64[:, ::1], float64[::1], float64[::1], float64[::1], int64, float64, float64[:, :, ::1], int64[:, :, ::1], "
    "float64[::1], int64[::1], int64[::1], float64[:, ::1])"
)


@callee
def branch(i, y, repeats, first, model, floats, codes, now, count):
    """Branch for all modes of sensor `i`, weight the hypotheses by its sample, and return their number.

    A sample that `repeats` the one before proves that the sensor is frozen, because noise never repeats. In the `first` step a
    frozen sensor has a sample of its own.
    """
    then, made = 1 - now, 0
    for p in range(count):
        weight, mean, variance = floats[now, LOG_WEIGHT, p], floats[now, MEAN, p], floats[now, VARIANCE, p]
        code = codes[now, i, p]
        was = min(code, DRIFTING)
        total = variance + model[SENSOR_VARIANCE]
        gain = variance / total
        scale = -0.5 * log(total)
        for mode in range(4):
            if repeats != (mode == FROZEN) and not (first and mode == FROZEN):
                continue
            if was == HEALTHY:
                chance = model[STAYS] if mode == HEALTHY else model[BEGINS]
            elif mode == HEALTHY:
                chance = model[ENDS]
            elif mode == was:
                chance = model[LASTS]
            else:
                continue
            offset, becomes = 0.0, mode
            if mode == INJECTED:
                offset = model[INJECTION]
            elif mode == DRIFTING:
                becomes = code + 1 if was == DRIFTING else DRIFTING
                offset = model[SLOPE] * (becomes - DRIFTING)
            floats[then, LOG_WEIGHT, made] = weight + chance
            floats[then, MEAN, made] = mean
            floats[then, VARIANCE, made] = variance
            if not repeats:
                error = y - offset - mean
                floats[then, LOG_WEIGHT, made] = weight + chance + scale - 0.5 * error * error / total
                floats[then, MEAN, made] = mean + gain * error
                floats[then, VARIANCE, made] = variance - gain * variance
            for j in range(codes.shape[1]):
                codes[then, j, made] = codes[now, j, p]
            codes[then, i, made] = becomes
            made += 1
    return made


@callee
def copy(floats, codes, now, p, made, weight):
    """Copy hypothesis `p` to the place `made` of the other buffer, with a weight."""
    floats[1 - now, LOG_WEIGHT, made] = weight
    floats[1 - now, MEAN, made] = floats[now, MEAN, p]
    floats[1 - now, VARIANCE, made] = floats[now, VARIANCE, p]
    for j in range(codes.shape[1]):
        codes[1 - now, j, made] = codes[now, j, p]


@callee
def merge(weights, tolerance, floats, codes, table, keys, now, count):
    """Merge hypotheses with the same predictions, drop those without weight, and return the number of the others.

    They have the same codes, and means and standard deviations in the same cell of a grid whose width is `tolerance` standard
    deviations. The merged hypothesis has the mean and variance of their mixture.
    """
    made = 0
    for i in range(table.shape[0]):
        table[i] = -1
    for p in range(count):
        if not weights[p] > 0.0:
            continue
        mean, variance = floats[now, MEAN, p], floats[now, VARIANCE, p]
        row = np.floor(0.5 * log(variance) / tolerance)
        column = np.floor(mean / (tolerance * exp(tolerance * row)))
        key = np.int64(min(max(row, -MOST_ROWS), MOST_ROWS) + MOST_ROWS)
        key = key * (2 * MOST_COLUMNS + 1) + np.int64(min(max(column, -MOST_COLUMNS), MOST_COLUMNS) + MOST_COLUMNS)
        for j in range(codes.shape[1]):
            key = key * MOST_CODES + min(codes[now, j, p], MOST_CODES - 1)
        place = key % table.shape[0]
        while table[place] >= 0 and keys[table[place]] != key:
            place = (place + 1) % table.shape[0]
        other = table[place]
        if other < 0:
            table[place], keys[made] = made, key
            weights[made] = weights[p]
            floats[now, MEAN, made], floats[now, VARIANCE, made] = mean, variance
            for j in range(codes.shape[1]):
                codes[now, j, made] = codes[now, j, p]
            made += 1
        else:
            share = weights[p] / (weights[other] + weights[p])
            apart = mean - floats[now, MEAN, other]
            spread = variance - floats[now, VARIANCE, other] + (1.0 - share) * apart * apart
            floats[now, MEAN, other] += share * apart
            floats[now, VARIANCE, other] += share * spread
            weights[other] += weights[p]
    return made


@callee
def resample(weights, uniform, limit, floats, codes, now, count):
    """Reduce the hypotheses to `limit` as in Fearnhead and Clifford (2003), and return their number.

    Hypotheses with a weight above some c keep it. The others are drawn with probability weight / c, by stratified sampling, and
    get the weight c. No other unbiased method changes the weights less. Hypotheses with weight zero are always dropped.
    """
    total, positive = 0.0, 0
    for p in range(count):
        total += weights[p]
        positive += weights[p] > 0.0
    cut, large, small = 0.0, -1, total
    if positive > limit:
        more = 0
        while more != large:  # increase the number of kept hypotheses until c is consistent with it
            large = more
            cut = small / (limit - large)
            more, small = 0, 0.0
            for p in range(count):
                if weights[p] > cut:
                    more += 1
                else:
                    small += weights[p]
    made, left, lowered = 0, uniform * cut, log(cut)
    for p in range(count):
        if weights[p] > cut:
            copy(floats, codes, now, p, made, log(weights[p]))
            made += 1
        elif weights[p] > 0.0:
            left -= weights[p]
            if left < 0.0 and made < limit:
                left += cut
                copy(floats, codes, now, p, made, lowered)
                made += 1
    return made


@callee
def step(y, k, uniform, model, limit, tolerance, space, log_odds, now, count):
    """Process the samples of step `k`, write the log odds of each sensor's fault, and return the number of hypotheses."""
    floats, codes, weights, table, keys = space
    sensors, first = y.shape[1], k == 0
    for i in range(sensors):
        repeats = not first and y[k, i] == y[k - 1, i]
        count = branch(i, y[k, i], repeats, first, model, floats, codes, now, count)
        now = 1 - now
    most = -np.inf
    for p in range(count):
        most = max(most, floats[now, LOG_WEIGHT, p])
    for p in range(count):
        weights[p] = exp(floats[now, LOG_WEIGHT, p] - most)
    for i in range(sensors):
        healthy, faulty = 0.0, 0.0
        for p in range(count):
            if codes[now, i, p] == HEALTHY:
                healthy += weights[p]
            else:
                faulty += weights[p]
        log_odds[k, i] = log(faulty) - log(healthy)
    # A sensor that repeats a sample in the next step is healthy or frozen in this one. Other hypotheses will have no weight: they
    # count for this step's odds and are then dropped.
    if k + 1 < y.shape[0]:
        for i in range(sensors):
            if y[k + 1, i] == y[k, i]:
                for p in range(count):
                    if codes[now, i, p] > FROZEN:
                        floats[now, LOG_WEIGHT, p] = -np.inf
    most = -np.inf
    for p in range(count):
        most = max(most, floats[now, LOG_WEIGHT, p])
    for p in range(count):
        weights[p] = exp(floats[now, LOG_WEIGHT, p] - most)
    if tolerance > 0.0:
        count = merge(weights, tolerance, floats, codes, table, keys, now, count)
    return resample(weights, uniform[k], limit, floats, codes, now, count)


def track(y, u, uniform, model, limit, tolerance, floats, codes, weights, table, keys, log_odds):
    """Run the filter over a stream and write the log odds of a fault of each sensor at each step.

    Parameters
    ----------
    y : array, steps x sensors
        Samples as they reach the controller.
    u, uniform : array, steps
        Control from each step on, and a number between 0 and 1 for each resampling.
    model : array
        Parameters; their indices are `STAYS` to `PROCESS_VARIANCE`.
    limit : int
        Number of hypotheses that are kept.
    floats, codes : array, 2 x 3 x capacity and 2 x sensors x capacity
        The capacity is at least ``limit`` times 3 to the power of the number of sensors. The first hypothesis is at index 0.
    tolerance : float
        Distance within which hypotheses are merged, in standard deviations; 0 to merge none.
    weights, table, keys : array
        Work arrays: of the capacity, larger than the capacity, of the capacity.
    log_odds : array, steps x sensors
        Output; infinite if a fault is certain.
    """
    now, count, space = 0, 1, (floats, codes, weights, table, keys)
    for k in range(y.shape[0]):
        if k > 0:
            for p in range(count):
                floats[now, MEAN, p] = model[KEPT] * floats[now, MEAN, p] + model[CONTROL] * u[k - 1]
                floats[now, VARIANCE, p] = (
                    model[KEPT] * model[KEPT] * floats[now, VARIANCE, p] + model[PROCESS_VARIANCE]
                )
        count = step(y, k, uniform, model, limit, tolerance, space, log_odds, now, count)
        now = (now + y.shape[1] + 1) % 2  # each sensor and the resampling have written into the other buffer
