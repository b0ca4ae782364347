"""Compute a group: sweeps until guesses and results agree, and substeps as small as the error requires.

One text for both engines: `build` takes the few functions that differ (the calls of a sweep, saving and restoring a state) and
returns the function that computes a group. So the arithmetic of both is the same to the last bit.
"""

from typing import Any, NamedTuple

from bayesftc.cosim.ops import sqrt

NOT_CONVERGED, NO_STEP, DIVERGED = 701, 702, 703
"""Status of a group that failed as a whole; a failed call has its own status."""

SAVING = 800
"""Status of a group whose FMUs could not be saved or restored; FMI's status is added."""

INNER, OUTER = 0, 1
"""The two saved states: of the beginning of an iterated step, and of a step that may be too long."""

PLAIN, AITKEN, ANDERSON = 0, 1, 2
DEPTH = 20
"""Number of differences that Anderson's method keeps. With fewer differences than values, a linear loop that diverges by itself
is not solved (measured with five differences, eight values and a spectral radius of 20)."""

# Rows of the working memory, each as long as there are guessed values.
GUESS, VALUE, NEXT, SCALE, RESIDUAL, RESIDUAL_BEFORE, VALUE_BEFORE, LEFT = range(8)
RESIDUALS, VALUES, BASIS = 8, 8 + DEPTH, 8 + 2 * DEPTH
WORK_ROWS = 8 + 3 * DEPTH

# Words of the record of a failure.
PART, STATUS, WHERE = range(3)
RECORD_WORDS = 3

# Numbers for messages, and numbers that the accelerations keep.
GAP, FACTOR, STEP = range(3)
NUMBERS = 3 + DEPTH * (DEPTH + 2)

FINEST = 1 << 16
"""Number of the smallest substeps in a step from t_k to t_k+1."""

HUGE = 1e100
"""A larger value means divergence. Otherwise values would grow until they are NaN, and NaN agrees with NaN."""

NOT_FINITE = 1_000_000  # as in bayesftc.cosim.diagram.schedule
FATAL = 4
CRASHED, INTERRUPTED = 901, 902  # as in bayesftc.cosim.isolation.protocol


class Iteration(NamedTuple):
    """The settings of an iteration: places of the guessed values (``torn``) and of their first guesses (``guesses``).

    ``work`` and ``numbers`` are scratch, and numbers for messages. ``tolerance`` and ``limit`` end the iteration. ``method`` is
    the acceleration.
    """

    torn: Any
    guesses: Any
    work: Any
    numbers: Any
    tolerance: float
    limit: int
    method: int


class Doubling(NamedTuple):
    """The settings of substeps: five ``places`` of each output (`Group.doubling`), that of the step size, and error limits."""

    places: Any
    size_at: int
    error: float
    divisor: float
    growth: float


def build(sweep, save, restore, forget, resize, compiled=lambda function: function):
    """Return the function that computes a group.

    Parameters
    ----------
    sweep : callable
        ``sweep(machine, memory, t, h, k, record)`` makes the calls of a sweep; 0, or 1 with the failed part in `record`.
    save, restore, forget : callable
        ``save(machine, memory, slot)`` and so on, for the states of all members; 0, or a status.
    resize : callable
        ``resize(machine, memory, h)`` sets the size of the FMUs' next steps in seconds.
    compiled : callable
        Registers a function for compiling.
    """

    @compiled
    def accelerate(work, numbers, count, n, method):
        """Compute the next guess from the guesses and results of the iterations up to number `n`."""
        for i in range(count):
            # A sample that is missing in the guess or the result has no part in the acceleration: its next guess is the result.
            residual = (work[VALUE, i] - work[GUESS, i]) * work[SCALE, i]
            work[RESIDUAL, i] = residual if residual == residual else 0.0
            work[NEXT, i] = work[VALUE, i]
        if method == AITKEN:
            factor = 1.0
            if n > 0:
                top, bottom = 0.0, 0.0
                for i in range(count):
                    change = work[RESIDUAL, i] - work[RESIDUAL_BEFORE, i]
                    top += work[RESIDUAL_BEFORE, i] * change
                    bottom += change * change
                if bottom > 0.0:
                    factor = -numbers[FACTOR] * top / bottom
                    if factor - factor != 0.0 or factor == 0.0:
                        factor = 1.0
            numbers[FACTOR] = factor
            for i in range(count):
                change = work[VALUE, i] - work[GUESS, i]
                if change == change:
                    work[NEXT, i] = work[GUESS, i] + factor * change
        if method == ANDERSON and n > 0:
            depth = min(DEPTH, count)
            newest = (n - 1) % depth
            for i in range(count):
                work[RESIDUALS + newest, i] = work[RESIDUAL, i] - work[RESIDUAL_BEFORE, i]
                change = work[VALUE, i] - work[VALUE_BEFORE, i]
                work[VALUES + newest, i] = change if change == change else 0.0
                work[LEFT, i] = work[RESIDUAL, i]
            used = min(n, depth)
            # Modified Gram-Schmidt, from the newest difference to the oldest; linearly dependent differences are left out.
            triangle, right = 3, 3 + DEPTH * DEPTH
            for j in range(used):
                column = (newest + depth - j) % depth
                whole = 0.0
                for i in range(count):
                    value = work[RESIDUALS + column, i]
                    work[BASIS + j, i] = value
                    whole += value * value
                for m in range(j):
                    product = 0.0
                    for i in range(count):
                        product += work[BASIS + m, i] * work[BASIS + j, i]
                    numbers[triangle + m * DEPTH + j] = product
                    for i in range(count):
                        work[BASIS + j, i] = work[BASIS + j, i] - product * work[BASIS + m, i]
                size = 0.0
                for i in range(count):
                    size += work[BASIS + j, i] * work[BASIS + j, i]
                length = 0.0
                if size > 1e-24 * whole:
                    length = sqrt(size)
                numbers[triangle + j * DEPTH + j] = length
                product = 0.0
                for i in range(count):
                    if length > 0.0:
                        work[BASIS + j, i] = work[BASIS + j, i] / length
                        product += work[BASIS + j, i] * work[LEFT, i]
                    else:
                        work[BASIS + j, i] = 0.0
                numbers[right + j] = product
                for i in range(count):
                    work[LEFT, i] = work[LEFT, i] - product * work[BASIS + j, i]
            for back in range(used):
                j = used - 1 - back
                part = numbers[right + j]
                for m in range(j + 1, used):
                    part -= numbers[triangle + j * DEPTH + m] * numbers[right + DEPTH + m]
                length = numbers[triangle + j * DEPTH + j]
                numbers[right + DEPTH + j] = part / length if length > 0.0 else 0.0
            for j in range(used):
                column = (newest + depth - j) % depth
                for i in range(count):
                    work[NEXT, i] = work[NEXT, i] - numbers[right + DEPTH + j] * work[VALUES + column, i]
        for i in range(count):
            work[RESIDUAL_BEFORE, i] = work[RESIDUAL, i]
            work[VALUE_BEFORE, i] = work[VALUE, i]

    @compiled
    def is_fatal(status):
        """Return whether a status is FMI's ``fatal``, after which no function may be called, or a crash or interruption."""
        return status < NOT_FINITE and (status % 100 == FATAL or status in (CRASHED, INTERRUPTED))

    @compiled
    def agree(machine, memory, iteration, t, h, k, record):
        """Sweep from the same state until the results agree with the guesses; return 0, or a status."""
        torn, guesses, work, numbers, tolerance, limit, method = iteration
        count = torn.size
        if count == 0:
            return sweep(machine, memory, t, h, k, record)
        for i in range(count):
            first = memory[guesses[i]]
            memory[torn[i]] = first if first == first else 0.0  # NaN before the first step
        status = save(machine, memory, INNER)
        if status != 0:
            return status
        for n in range(limit):
            for i in range(count):
                work[GUESS, i] = memory[torn[i]]
            if n > 0:
                status = restore(machine, memory, INNER)
                if status != 0:
                    return status
            status = sweep(machine, memory, t, h, k, record)
            if status != 0:
                break
            worst, where = 0.0, 0
            for i in range(count):
                value, guess = memory[torn[i]], work[GUESS, i]
                work[VALUE, i] = value
                scale = 1.0 / (1.0 + abs(value))
                if n == 0:
                    work[SCALE, i] = scale if scale == scale else 1.0
                gap = abs(value - guess) * scale
                if value != value and guess != guess:
                    gap = 0.0  # a missing sample that stays missing
                if abs(value) > HUGE:
                    status = DIVERGED
                if worst == worst and not gap <= worst:
                    worst, where = gap, i
            numbers[GAP] = worst
            record[WHERE] = where
            if status != 0:
                record[STATUS] = status
                break
            if worst <= tolerance:
                return forget(machine, memory, INNER)
            accelerate(work, numbers, count, n, method)
            for i in range(count):
                memory[torn[i]] = work[NEXT, i]
        if status == 0:
            status = NOT_CONVERGED
            record[STATUS] = status
        if not is_fatal(record[STATUS]):
            forget(machine, memory, INNER)
        return status

    @compiled
    def double(machine, memory, iteration, doubling, t, h, k, record):
        """Advance from `t` to ``t + h`` in substeps, with an error estimate from two steps of half the size."""
        places, size_at, error, divisor, growth = doubling
        count = places.shape[0]
        for i in range(count):
            memory[places[i, 1]] = memory[places[i, 0]]
        size = FINEST if not memory[size_at] >= 1.0 else int(memory[size_at])
        position = 0
        while position < FINEST:
            start, length = t + h * (position / FINEST), h * (size / FINEST)
            status = save(machine, memory, OUTER)
            if status != 0:
                return status
            for i in range(count):
                memory[places[i, 4]] = memory[places[i, 1]]
            gap = 0.0
            where = 0
            # Once in one step, then in two.
            for part in range(3):
                if part == 1:
                    for i in range(count):
                        memory[places[i, 3]] = memory[places[i, 2]]
                    status = restore(machine, memory, OUTER)
                    if status != 0:
                        return status
                if part == 2:
                    for i in range(count):
                        memory[places[i, 1]] = memory[places[i, 2]]
                size_now = length if part == 0 else 0.5 * length
                at = start + size_now if part == 2 else start
                resize(machine, memory, size_now)
                status = agree(machine, memory, iteration, at, size_now, k, record)
                if status != 0:
                    break
            if status == 0:
                for i in range(count):
                    fine = memory[places[i, 2]]
                    each = abs(fine - memory[places[i, 3]]) / divisor / (1.0 + abs(fine))
                    if gap == gap and not each <= gap:
                        gap, where = each, i
            elif is_fatal(record[STATUS]) or status >= SAVING:
                return status
            if status == 0 and gap <= error:
                status = forget(machine, memory, OUTER)
                if status != 0:
                    return status
                for i in range(count):
                    memory[places[i, 1]] = memory[places[i, 2]]
                position += size
                if gap <= growth * error and size < FINEST and position % (2 * size) == 0:
                    size = 2 * size
            elif size == 1:
                if status == 0:
                    status = NO_STEP
                    record[STATUS], record[WHERE], iteration.numbers[GAP], iteration.numbers[STEP] = (
                        status,
                        where,
                        gap,
                        length,
                    )
                forget(machine, memory, OUTER)
                return status
            else:
                # The step is too long for the error limit, for the iteration or for an FMU.
                record[PART], record[STATUS] = -1, 0
                status = restore(machine, memory, OUTER)
                if status == 0:
                    status = forget(machine, memory, OUTER)
                if status != 0:
                    return status
                for i in range(count):
                    memory[places[i, 1]] = memory[places[i, 4]]
                size = size // 2
        memory[size_at] = float(size)
        return 0

    @compiled
    def compute(machine, memory, iteration, doubling, t, h, k, record):
        """Compute a group; return 0, or a status, with details in `record`."""
        record[PART], record[STATUS], record[WHERE] = -1, 0, 0
        if doubling.places.shape[0] > 0:
            status = double(machine, memory, iteration, doubling, t, h, k, record)
        else:
            status = agree(machine, memory, iteration, t, h, k, record)
        if status != 0 and record[STATUS] == 0:
            record[STATUS] = status
        return status

    return compute
