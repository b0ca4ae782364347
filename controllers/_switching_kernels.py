"""Step functions of switching between fault modes: time passing, evidence, probabilities, and what they say of a sensor.

What is kept of a sensor stands in ``memory`` from ``at`` on: its last sample, the logarithm of the probability of being
`HEALTHY`, and from `FIRST` on a block of ``width`` numbers for each mode: the logarithm of its probability (`WEIGHT`), the
share of it that has just begun (`ENTERED`), its mean `AGE` in samples, and what the mode itself keeps (``_mode_kernels.py``).
The settings likewise, from ``row`` on: the logarithms of the probabilities that a healthy sensor `STAYS` so, that its sample
`ARRIVES`, that it is `MISSING`, and a block for each mode: of those that it `BEGINS`, `LASTS`, `ENDS`, that a sample arrives
and is missing, and the mode's own settings.
"""

from bayesftc.controllers._mode_kernels import AGE, ENTERED, FURTHEST, SIZE, TRUST, WEIGHT
from bayesftc.controllers._special import log_sum
from bayesftc.controllers.precision import NAN
from bayesftc.cosim.ops import exp, log, maximum, minimum, select, sqrt

LAST, HEALTHY, FIRST = 0, 1, 2
STAYS, ARRIVES, MISSING, FIRST_SETTINGS = 0, 1, 2, 3
BEGINS, LASTS, ENDS, MODE_ARRIVES, MODE_MISSING, OWN_SETTINGS = 0, 1, 2, 3, 4, 5

LEAST = -500.0
"""Least logarithm of a probability: its exponential is still a number, so that every mode can come back."""

LEAST_TRUST = 1e-12
"""Least precision of a sensor in nominal ones, so that its covariance stays a number."""


def error_of(i, e, variance):
    """Return the innovation, held within what a density is computed of."""
    most = sqrt(FURTHEST * variance)
    return maximum(minimum(e[i], most), -most)


def pass_time(memory, at, width, settings, row, width_of_settings, modes):
    """Let the time of one sample pass: modes begin and end."""
    healthy = memory[at + HEALTHY]
    stays = healthy + settings[row + STAYS]
    for k in range(modes):
        block = at + FIRST + k * width
        chance = row + FIRST_SETTINGS + k * width_of_settings
        begins = healthy + settings[chance + BEGINS]
        stays = log_sum(stays, memory[block + WEIGHT] + settings[chance + ENDS])
        weight = log_sum(memory[block + WEIGHT] + settings[chance + LASTS], begins)
        entered = exp(begins - weight)
        memory[block + WEIGHT] = weight
        memory[block + ENTERED] = entered
        memory[block + AGE] = (1.0 - entered) * (memory[block + AGE] + 1.0)
    memory[at + HEALTHY] = stays


def normalise(memory, at, width, modes):
    """Turn log-weights into the logarithms of probabilities, and return the probability of a fault."""
    largest = memory[at + HEALTHY]
    for k in range(modes):
        largest = maximum(largest, memory[at + FIRST + k * width])
    failed = 0.0 * largest
    for k in range(modes):
        failed = failed + exp(memory[at + FIRST + k * width] - largest)
    total = exp(memory[at + HEALTHY] - largest) + failed
    norm = largest + log(total)
    memory[at + HEALTHY] = maximum(memory[at + HEALTHY] - norm, LEAST)
    for k in range(modes):
        weight = at + FIRST + k * width
        memory[weight] = maximum(memory[weight] - norm, LEAST)
    return failed / total


def trusted(memory, at, width, modes):
    """Return the precision that a sensor deserves in nominal ones: 1 if it is healthy, else as its mode says."""
    total = exp(memory[at + HEALTHY])
    for k in range(modes):
        block = at + FIRST + k * width
        total = total + exp(memory[block + WEIGHT]) * memory[block + TRUST]
    return maximum(minimum(total, 1.0), LEAST_TRUST)


def use_trust(trust, present, nominal, R, used, precision, beta):
    """Write the sensors' covariance: the nominal one over what each sensor deserves."""
    for i in range(trust.shape[1]):
        for j in range(trust.shape[1]):
            R[i, j] = nominal[i, j] / sqrt(trust[0, i] * trust[0, j])
        used[i] = present[i]
        precision[i] = trust[0, i] / nominal[i, i]
        beta[i] = NAN


def report_modes(memory, length, width, modes, sensors, step, first, outputs):
    """Write each sensor's mode probabilities; then for all sensors the most probable mode, its size, and its onset.

    They stand in ``outputs`` from ``first`` on. Size and onset (seconds, by the sample time ``step``) are NaN of a healthy
    sensor.
    """
    kinds = first + sensors * (modes + 1)
    for i in range(sensors):
        at = i * length
        best = memory[at + HEALTHY]
        outputs[first + i * (modes + 1)] = exp(best)
        kind, size = 0.0 * best, NAN + 0.0 * best
        failed, age = 0.0 * best, 0.0 * best
        for k in range(modes):
            block = at + FIRST + k * width
            p = exp(memory[block + WEIGHT])
            outputs[first + i * (modes + 1) + 1 + k] = p
            failed = failed + p
            age = age + p * memory[block + AGE]
            likelier = memory[block + WEIGHT] > best
            kind = select(likelier, k + 1.0, kind)
            size = select(likelier, memory[block + SIZE], size)
            best = maximum(best, memory[block + WEIGHT])
        count = memory[sensors * length]
        outputs[kinds + i] = kind
        outputs[kinds + sensors + i] = size
        outputs[kinds + 2 * sensors + i] = select(kind > 0.5, step * (count - 1.0 - age / failed), NAN)
