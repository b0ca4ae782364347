"""Step functions of switching between fault modes: time passing, probabilities, and what they say of a sensor.

What is kept of a sensor stands in ``memory`` from ``at`` on:

- `LAST`: its last sample.
- `HEALTHY`: the probability that it is healthy.
- `TRUSTED`: the precision that it deserves, in that of its noise while healthy.
- `DENSITY`: a factor of its last sample's density, beside the logarithm that was returned.
- `NOISE`, `NOISE_SHAPE`, `NOISE_RATE`: the variance of its noise while healthy, in nominal ones, and the gamma distribution of
  the precision by which it is learned.
- `REPEATS`, `SAMPLES`: how many of how many samples were repetitions while it was healthy.
- From `FIRST` on a block for each mode: its probability (`WEIGHT`), the share of it that has just begun (`ENTERED`), its mean
  `AGE` in samples, and what the mode itself keeps (``mode_kernels.py``).

After all sensors follow the number of samples and the logarithm of the last ones' density. A bank's hypotheses keep a sensor in
the same form; noise and repetitions belong to the sensor, not to a hypothesis.

The settings of a sensor stand from ``row`` on:

- `ARRIVES`, `MISSING`: the probabilities that a healthy sensor's sample arrives and is missing.
- `KEEPS`, `SHAPE0`, `LEAST_NOISE`, `MOST_NOISE`: of its noise the forgetting factor, the prior's shape, and the bounds.
- `WIDTH`, `REPEATS0`, `SAMPLES0`, `MOST_REPEATS`: the resolution, how many repetitions of how many samples are expected, and the
  largest share of them that is learned.
- From `FIRST_SETTINGS` on a block for each mode: the probabilities that it `BEGINS`, `LASTS`, `ENDS`, that a sample arrives and
  is missing, and the mode's own settings.

Probabilities are combined with densities as logarithms, the largest density taken out, so none is lost however improbable a
sample is: a probability is at least `LEAST`, and what a density loses by its exponential is far less than that.
"""

from bayesftc.controllers.precision.base import NAN
from bayesftc.controllers.switching.mode_kernels import AGE, ENTERED, FURTHEST, SIZE, WEIGHT
from bayesftc.cosim.ops import absolute, exp, maximum, minimum, select, sqrt

LAST, HEALTHY, TRUSTED, DENSITY, NOISE, NOISE_SHAPE, NOISE_RATE, REPEATS, SAMPLES, FIRST = range(10)
ARRIVES, MISSING, KEEPS, SHAPE0, LEAST_NOISE, MOST_NOISE, WIDTH, REPEATS0, SAMPLES0, MOST_REPEATS, FIRST_SETTINGS = (
    range(11)
)
BEGINS, LASTS, ENDS, MODE_ARRIVES, MODE_MISSING, OWN_SETTINGS = 0, 1, 2, 3, 4, 5

TYPICAL = 17.079468445347132
"""The square of the width over which a probability has the density that is typical of a normal variable: 2 pi e variances."""

LEAST = 5e-131
"""Least probability of a mode, exp(-300), so that every mode can come back."""

LEAST_LOG = -380.0
"""Least logarithm of a density over the largest: far below `LEAST`, and their product is a normal number, or it would be slow."""

LEAST_TRUST = 1e-12
"""Least precision of a sensor in nominal ones, so that its covariance stays a number."""


def held(e, variance):
    """Return an innovation, held within what a density is computed of."""
    most = sqrt(FURTHEST * variance)
    return maximum(minimum(e, most), -most)


def pass_mode(memory, block, healthy, settings, row):
    """Let the time of one sample pass for a mode: it begins and ends. Return by how much that makes the sensor healthier."""
    ended = memory[block + WEIGHT] * settings[row + ENDS]
    begun = healthy * settings[row + BEGINS]
    weight = memory[block + WEIGHT] * settings[row + LASTS] + begun
    entered = begun / weight
    memory[block + WEIGHT] = weight
    memory[block + ENTERED] = entered
    memory[block + AGE] = (1.0 - entered) * (memory[block + AGE] + 1.0)
    return ended - begun


def learn_noise(squared, sound, memory, at, settings, row):
    """Learn the variance of a sensor's noise while it is healthy, from its expected square in nominal variances.

    The precision is gamma distributed; a sample counts as far as the sensor is ``sound``: present, and healthy by this sample.
    """
    lost = sound * (1.0 - settings[row + KEEPS])
    shape = memory[at + NOISE_SHAPE] + lost * (settings[row + SHAPE0] - memory[at + NOISE_SHAPE]) + 0.5 * sound
    rate = memory[at + NOISE_RATE] + lost * (settings[row + SHAPE0] - memory[at + NOISE_RATE]) + 0.5 * sound * squared
    memory[at + NOISE_SHAPE], memory[at + NOISE_RATE] = shape, rate
    memory[at + NOISE] = maximum(minimum(rate / shape, settings[row + MOST_NOISE]), settings[row + LEAST_NOISE])


def repetition(change, nominal, memory, at, settings, row):
    """Return by how much a repeated sample is less surprising than the sensor's resolution alone says; 1 of any other sample.

    It has the share of repetitions while the sensor was healthy. Over what width that share would have the density that is
    typical of the noise, a repetition tells as little as over that resolution.
    """
    share = (memory[at + REPEATS] + settings[row + REPEATS0]) / (memory[at + SAMPLES] + settings[row + SAMPLES0])
    share = minimum(share, settings[row + MOST_REPEATS])
    width = maximum(share * sqrt(TYPICAL * nominal * memory[at + NOISE]), settings[row + WIDTH])
    return select(absolute(change) <= 0.5 * settings[row + WIDTH], settings[row + WIDTH] / width, 1.0)


def learn_repeats(change, sound, memory, at, settings, row):
    """Count the repetitions of a sensor as far as it is ``sound``: present, and healthy by this sample."""
    equal = absolute(change) <= 0.5 * settings[row + WIDTH]
    memory[at + REPEATS] = memory[at + REPEATS] + select(equal, sound, 0.0)
    memory[at + SAMPLES] = memory[at + SAMPLES] + sound


def share_of(told, most):
    """Return the density of a sample over the largest one, from their logarithms."""
    return exp(maximum(told - most, LEAST_LOG))


def failed(memory, at, width, faults):
    """Return the probability of a fault, given for each mode whether it is one (1 or 0): small ones are not 1 minus another."""
    total = 0.0 * memory[at + HEALTHY]
    for k in range(len(faults)):
        if faults[k] > 0:
            total = total + memory[at + FIRST + k * width + WEIGHT]
    return minimum(total, 1.0)


def use_trust(memory, length, i, sample, trust):
    """Write a sensor's part of the sensors' covariance: the nominal one by its noise, over what each sensor deserves."""
    weight = memory[i * length + TRUSTED] / memory[i * length + NOISE]
    for j in range(i):
        trust.R[i, j] = sample.nominal[i, j] / sqrt(
            weight * (memory[j * length + TRUSTED] / memory[j * length + NOISE])
        )
        trust.R[j, i] = trust.R[i, j]
    trust.R[i, i] = sample.nominal[i, i] / weight
    trust.used[i] = sample.present[i]
    trust.precision[i] = weight / sample.nominal[i, i]
    trust.beta[i] = NAN


def report_modes(memory, length, width, modes, sensors, step, first, outputs):
    """Write each sensor's mode probabilities; then for all sensors the most probable mode, its size, its onset; and the density.

    They stand in ``outputs`` from ``first`` on. Size and onset (seconds, by the sample time ``step``) are NaN of a healthy
    sensor.
    """
    kinds = first + sensors * (modes + 1)
    for i in range(sensors):
        at = i * length
        best = memory[at + HEALTHY]
        outputs[first + i * (modes + 1)] = best
        kind, size = 0.0 * best, NAN + 0.0 * best
        total, age = 0.0 * best, 0.0 * best
        for k in range(modes):
            block = at + FIRST + k * width
            p = memory[block + WEIGHT]
            outputs[first + i * (modes + 1) + 1 + k] = p
            total = total + p
            age = age + p * memory[block + AGE]
            likelier = p > best
            kind = select(likelier, k + 1.0, kind)
            size = select(likelier, memory[block + SIZE], size)
            best = maximum(best, p)
        count = memory[sensors * length]
        outputs[kinds + i] = kind
        outputs[kinds + sensors + i] = size
        outputs[kinds + 2 * sensors + i] = select(kind > 0.5, step * (count - 1.0 - age / total), NAN)
    outputs[kinds + 3 * sensors] = memory[sensors * length + 1]
