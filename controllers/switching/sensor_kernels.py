"""Step functions of switching between fault modes: transitions, probabilities, and the resulting outputs of a sensor.

The state of a sensor is in ``memory`` from ``at`` on:

- `LAST`: its last sample.
- `HEALTHY`: the probability that it is healthy.
- `TRUSTED`: its inferred precision, relative to that of its noise while healthy.
- `DENSITY`: a factor of its last sample's density, besides the returned logarithm.
- `NOISE`, `NOISE_SHAPE`, `NOISE_RATE`: the variance of its noise while healthy, in nominal ones, and the gamma distribution of
  its precision.
- `REPEATS`, `SAMPLES`: numbers of repetitions and of samples while it was healthy.
- `STEP`, `KNOWN`: the step of which its last changes from sample to sample are multiples, 0 before the first one; and how many
  of these there were in succession, up to `ON_GRID`. At the beginning it counts from `UNKNOWN` to 0, and is then `ON_GRID`.
- From `FIRST` on a block for each mode: its probability (`WEIGHT`), the share of it that has just begun (`ENTERED`), its mean
  `AGE` in samples, and the mode's own numbers (``mode_kernels.py``).

After all sensors follow the number of samples, the log density of the last ones and, in the per-sensor form, the mean squared
innovation of each sensor (``calm.py``). A bank's hypotheses keep a sensor in the same
form; noise and repetitions belong to the sensor, not to a hypothesis.

The settings of a sensor are from ``row`` on:

- `ARRIVES`, `MISSING`: the probabilities that a healthy sensor's sample arrives and is missing.
- `KEEPS`, `SHAPE0`, `LEAST_NOISE`, `MOST_NOISE`: forgetting factor, prior shape, and bounds of its noise.
- `WIDTH`, `REPEATS0`, `SAMPLES0`, `MOST_REPEATS`: the resolution, the expected numbers of repetitions and of samples, and the
  largest share of repetitions that is learned.
- `FINDS`: whether the sensor may be coarser than its resolution (1 or 0).
- From `FIRST_SETTINGS` on a block for each mode: the probabilities that it `BEGINS`, `LASTS`, `ENDS`, that a sample arrives and
  is missing, and the mode's own settings. If it neither lasts nor ends, a second fault begins (`FaultMode.alone`).

Probabilities are combined with log densities relative to the largest density, so that no mode is lost, however improbable a
sample is: a probability is at least `LEAST`, and the relative density has a far smaller lower limit.
"""

from bayesftc.controllers.precision.base import NAN
from bayesftc.controllers.switching.mode_kernels import AGE, ENTERED, FURTHEST, SIZE, WEIGHT
from bayesftc.cosim.ops import absolute, both, either, exp, floor, maximum, minimum, select, sqrt

LAST, HEALTHY, TRUSTED, DENSITY, NOISE, NOISE_SHAPE, NOISE_RATE, REPEATS, SAMPLES, STEP, KNOWN, FIRST = range(12)
(
    ARRIVES,
    MISSING,
    KEEPS,
    SHAPE0,
    LEAST_NOISE,
    MOST_NOISE,
    WIDTH,
    REPEATS0,
    SAMPLES0,
    MOST_REPEATS,
    FINDS,
    FIRST_SETTINGS,
) = range(12)
BEGINS, LASTS, ENDS, MODE_ARRIVES, MODE_MISSING, OWN_SETTINGS = 0, 1, 2, 3, 4, 5

TYPICAL = 17.079468445347132
"""Squared width of a uniform density with the entropy of a normal one, in variances: 2 pi e."""

LEAST = 5e-131
"""Least probability of a mode, exp(-300), so that every mode can recover."""

LEAST_LOG = -380.0
"""Least log density relative to the largest one: far below `LEAST`, but their product is not subnormal, which would be slow."""

COARSEST, COARSE = 12.0, 6.0
"""Squared steps of a sensor, in variances of its noise: if that is all due to rounding, and from which on the sensor is coarse.
The samples of a sensor of smaller steps change with its noise, also while the plant is at rest."""

GRID = 0.05
"""Largest distance of a change from a whole multiple of the step, in standard deviations of the noise, on a grid. Its samples may
be rounded further, to some decimals or to single precision."""

UNKNOWN, ON_GRID, TOO_FINE = -5.0, 6.0, 15.0
"""What the changes of a sensor tell at the beginning, if they were multiples of a step often enough, and if they were so for long
but never the step itself, so that it is too fine."""

FINEST = 0.05
"""Squared step of a grid, in variances of the noise, below which it makes no difference."""

LEAST_TRUST = 1e-12
"""Least precision of a sensor in nominal ones, so that its covariance remains finite."""


def held(e, variance):
    """Return an innovation, limited for the computation of a density."""
    most = sqrt(FURTHEST * variance)
    return maximum(minimum(e, most), -most)


def pass_mode(memory, block, healthy, settings, row):
    """Apply the transitions of one sample to a mode; return the increase of the probability of healthy."""
    ended = memory[block + WEIGHT] * settings[row + ENDS]
    begun = healthy * settings[row + BEGINS]
    weight = memory[block + WEIGHT] * settings[row + LASTS] + begun
    entered = begun / weight
    memory[block + WEIGHT] = weight
    memory[block + ENTERED] = entered
    memory[block + AGE] = (1.0 - entered) * (memory[block + AGE] + 1.0)
    return ended - begun


def not_less(squared, step, nominal):
    """Return the square of a sensor's noise, in nominal variances, from which to learn: not less than rounding to a ``step``.

    The error of a repetition is that of the sample before: at rest it tells nothing about how large rounding errors are.
    """
    least = step * step / (COARSEST * nominal)
    return minimum(select(step > 0.0, maximum(squared, least), squared), FURTHEST)


def learn_noise(squared, sound, memory, at, settings, row):
    """Learn the variance of a sensor's noise while it is healthy, from its expected square in nominal variances.

    The precision is gamma distributed. A sample has the weight ``sound``, the probability of present and healthy.
    """
    lost = sound * (1.0 - settings[row + KEEPS])
    shape = memory[at + NOISE_SHAPE] + lost * (settings[row + SHAPE0] - memory[at + NOISE_SHAPE]) + 0.5 * sound
    rate = memory[at + NOISE_RATE] + lost * (settings[row + SHAPE0] - memory[at + NOISE_RATE]) + 0.5 * sound * squared
    memory[at + NOISE_SHAPE], memory[at + NOISE_RATE] = shape, rate
    memory[at + NOISE] = maximum(minimum(rate / shape, settings[row + MOST_NOISE]), settings[row + LEAST_NOISE])


def repeats_healthy(memory, at, settings, row):
    """Return the share of samples that a healthy sensor repeats, as learned."""
    return (memory[at + REPEATS] + settings[row + REPEATS0]) / (memory[at + SAMPLES] + settings[row + SAMPLES0])


def repetition(change, nominal, presumed, memory, at, settings, row):
    """Return the factor of a repeated sample's density relative to that by the sensor's resolution; 1 for other samples.

    The probability of a repetition is its share while the sensor was healthy. The width over which that share has the typical
    density of the noise, or the step of the sensor's grid (at the beginning as `indifferent` presumes), replaces the resolution,
    if it is larger. The log density of the samples is divided by the factor again: that is always by the resolution, so that the
    densities of two learners, or of two moments, can be compared.
    """
    share = minimum(repeats_healthy(memory, at, settings, row), settings[row + MOST_REPEATS])
    known = memory[at + KNOWN]
    grid = select(known < 0.0, presumed, select(known >= ON_GRID, 1.0, 0.0)) * settings[row + FINDS] * memory[at + STEP]
    width = maximum(maximum(share * sqrt(TYPICAL * nominal * memory[at + NOISE]), grid), settings[row + WIDTH])
    return select(absolute(change) <= 0.5 * settings[row + WIDTH], settings[row + WIDTH] / width, 1.0)


def is_fine(nominal, memory, at):
    """Return 1 if a sensor's samples lie on no grid, or on one that is finer than its noise; else 0, also at the beginning."""
    finer = memory[at + STEP] * memory[at + STEP] < COARSE * (nominal * memory[at + NOISE])
    return select(both(memory[at + KNOWN] >= 0.0, either(memory[at + KNOWN] < ON_GRID, finer)), 1.0, 0.0)


def indifferent(change, nominal, presumed, memory, at, settings, row):
    """Return the largest error with which a repeated sample of a coarse sensor tells of no freeze; -1 for all others.

    It is a step of the sensor, because a coarse sensor repeats its sample until the plant has moved by a step. At the beginning
    the sensor is ``presumed`` to be as coarse as its noise or its first change allows (1), or not to be coarse (0).
    """
    noise, step, known = nominal * memory[at + NOISE], memory[at + STEP], memory[at + KNOWN]
    first = presumed * select(step > 0.0, step, sqrt(COARSEST * noise))
    step = select(known >= ON_GRID, step, select(known < 0.0, first, 0.0))
    step = maximum(settings[row + FINDS] * step, settings[row + WIDTH])
    says_nothing = both(absolute(change) <= 0.5 * settings[row + WIDTH], step * step >= COARSE * noise)
    return select(says_nothing, step, -1.0)


def at_rest(step, nominal, memory, at, settings, row):
    """Return the largest probability with which a healthy coarse sensor repeats a sample: that in the middle of a step, at rest.

    Noise of half a step or more changes samples at rest, too. It is the noise without the rounding error; the error function is
    Winitzki's approximation. At the beginning, when noise and step are presumed, it is 1.
    """
    square = step * step
    noise = maximum(nominal * memory[at + NOISE] - square / COARSEST, 1e-6 * square)
    z = square / (8.0 * noise)
    part = 0.147 * z
    inside = sqrt(1.0 - exp(-z * (1.2732395447351628 + part) / (1.0 + part)))
    learned = repeats_healthy(memory, at, settings, row)
    return select(both(settings[row + FINDS] > 0.0, memory[at + KNOWN] < 0.0), 1.0, maximum(inside, learned))


def as_coarse(logp, normal, e, variance, step):
    """Return the log density of a coarse sensor's repetition if the sensor has failed, see `indifferent`.

    It is that of no fault (``logp``), and beyond a ``step`` that of no fault without an error, of the same ``normal`` density.
    Else a repetition, of which a healthy sensor has many, would be better than all other samples of a healthy sensor.
    """
    return select(absolute(e) <= step, logp, normal + 0.5 * (e * e / variance))


def off_grid(longer, shorter):
    """Return how far a change is from a whole multiple of a shorter one."""
    return absolute(longer - shorter * floor(longer / shorter + 0.5))


def learn_step(change, sound, nominal, memory, at, settings, row):
    """Learn the step of a sensor while it is healthy, from the last step and another change: their greatest common measure.

    The remainder of 3 and 2 steps is one step. The changes of a sensor with noise have no common measure; then the last change is
    the next candidate, so that a few changes after a fault the step is known again. After a single sample beside
    the grid the measure may be too fine for ever; therefore it is no longer believed if no change was the step itself for long.
    """
    by, step, known = absolute(change), memory[at + STEP], memory[at + KNOWN]
    noise = nominal * memory[at + NOISE]
    near = GRID * sqrt(noise)
    longer, shorter = maximum(by, step), maximum(minimum(by, step), 1e-300)
    times = floor(longer / shorter + 0.5)
    left = absolute(longer - shorter * times)
    exact = left <= near
    measure = select(exact, longer / times, left)
    common = both(either(exact, off_grid(shorter, maximum(left, 1e-300)) <= near), measure * measure >= FINEST * noise)
    changed = both(sound > 0.5, by > 0.5 * settings[row + WIDTH])
    later = both(changed, step > 0.0)
    more = select(known < 0.0, select(known + 1.0 < 0.0, known + 1.0, ON_GRID), known + 1.0)
    more = select(both(known >= ON_GRID, by < 1.5 * measure), ON_GRID, more)
    measure = select(more >= TOO_FINE, by, measure)
    more = select(more >= TOO_FINE, ON_GRID, more)
    memory[at + KNOWN] = select(later, select(common, more, 0.0), known)
    memory[at + STEP] = select(later, select(common, measure, by), select(changed, by, step))


def learn_repeats(change, sound, nominal, memory, at, settings, row):
    """Count the repetitions of a sensor with the weight ``sound``, the probability of present and healthy; learn its step.

    Those before its first change are not counted: the sensor may have been frozen from the beginning.
    """
    equal = absolute(change) <= 0.5 * settings[row + WIDTH]
    counts = select(both(both(equal, settings[row + FINDS] > 0.0), memory[at + STEP] <= 0.0), 0.0, sound)
    memory[at + REPEATS] = memory[at + REPEATS] + select(equal, counts, 0.0)
    memory[at + SAMPLES] = memory[at + SAMPLES] + counts
    learn_step(change, sound, nominal, memory, at, settings, row)


def share_of(logp, most):
    """Return a density relative to the largest one, from their logarithms."""
    return exp(maximum(logp - most, LEAST_LOG))


def failed(memory, at, width, faults):
    """Return the probability of a fault as a sum over the modes that are faults (1 or 0), which is accurate if small."""
    total = 0.0 * memory[at + HEALTHY]
    for k in range(len(faults)):
        if faults[k] > 0:
            total = total + memory[at + FIRST + k * width + WEIGHT]
    return minimum(total, 1.0)


def use_trust(memory, length, i, sample, trust):
    """Write a sensor's part of the sensor covariance: the nominal one, scaled by noise and inferred precision."""
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
    """Write each sensor's mode probabilities, then for all sensors the most probable mode, size and onset, then the log density.

    They are in ``outputs`` from ``first`` on. Size and onset (seconds, by the sample time ``step``) are NaN for a healthy sensor.
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
