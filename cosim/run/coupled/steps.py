"""How a group is computed: sweeps until guesses and results agree, and steps as small as the error allows.

One text for both engines: `build` takes the few things that they do differently (to go through the calls of a sweep, to save
and restore a state) and returns the function that computes a group, whose arithmetic is then the same to the last bit.
"""

from typing import Any, NamedTuple

from bayesftc.cosim.ops import sqrt

NOT_CONVERGED, NO_STEP, DIVERGED = 701, 702, 703
"""Status of a group that failed as a whole; a failed call has its own."""

SAVING = 800
"""Status of a group, plus FMI's own, whose FMUs could not be saved or restored."""

INNER, OUTER = 0, 1
"""The two saved states: of the beginning of an iterated step, and of a step that may be too long."""

PLAIN, AITKEN, ANDERSON = 0, 1, 2
DEPTH = 20
"""How many differences Anderson's method keeps: with fewer than there are values, a linear loop that diverges by itself is not
solved (of five, none of eight values with a spectral radius of 20 was)."""

# Rows of the working memory, each as long as there are guessed values.
GUESS, VALUE, NEXT, SCALE, RESIDUAL, RESIDUAL_BEFORE, VALUE_BEFORE, LEFT = range(8)
RESIDUALS, VALUES, BASIS = 8, 8 + DEPTH, 8 + 2 * DEPTH
WORK_ROWS = 8 + 3 * DEPTH

# Words of the record of what went wrong.
PART, STATUS, WHERE = range(3)
RECORD_WORDS = 3

# Numbers that the engines leave for messages, and that Aitken's method keeps.
GAP, FACTOR, STEP = range(3)
NUMBERS = 3 + DEPTH * (DEPTH + 2)

FINEST = 1 << 16
"""Parts of a step from t_k to t_k+1 below which a group's own step is not cut."""

HUGE = 1e100
"""No value of a loop that has a solution; what is near the end of the numbers would soon come out NaN, which agrees with NaN."""

NOT_FINITE = 1_000_000  # as in bayesftc.cosim.diagram.schedule
FATAL = 4
CRASHED, INTERRUPTED = 901, 902  # as in bayesftc.cosim.isolation.protocol


class Iteration(NamedTuple):
    """What is guessed until it agrees: the places of the values, where their first guesses stand, and how.

    ``work`` and ``numbers`` are scratch space, and what the engines leave for messages; ``tolerance`` and ``limit`` end it;
    ``method`` is the acceleration.
    """

    torn: Any
    guesses: Any
    work: Any
    numbers: Any
    tolerance: float
    limit: int
    method: int


class Doubling(NamedTuple):
    """Steps of a group's own: five ``places`` of each output (`Group.doubling`), that of the step size, and what is borne."""

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
        ``resize(machine, memory, h)`` tells the FMUs the size of their next steps in seconds.
    compiled : callable
        Registers a function for compiling.
    """

    @compiled
    def accelerate(work, numbers, count, n, method):
        """Set the next guess from the guesses and results so far, of which these are number `n`."""
        for i in range(count):
            # A missing sample, or one that was missing in the guess, follows as it came out, and the others from each other.
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
            # Gram and Schmidt's method, modified, from the newest difference to the oldest; one that adds nothing is left out.
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
        """Return whether an FMU has said that no function of it may be called any more, or has been stopped from outside."""
        return status < NOT_FINITE and (status % 100 == FATAL or status in (CRASHED, INTERRUPTED))

    @compiled
    def agree(machine, memory, iteration, t, h, k, record):
        """Sweep from the same state until the values that were guessed come out; 0, or a status."""
        torn, guesses, work, numbers, tolerance, limit, method = iteration
        count = torn.size
        if count == 0:
            return sweep(machine, memory, t, h, k, record)
        for i in range(count):
            first = memory[guesses[i]]
            memory[torn[i]] = first if first == first else 0.0  # before the first step there is no value yet
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
        """Go from `t` to ``t + h`` in steps of the group's own, whose error two of half the size show."""
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
                own = length if part == 0 else 0.5 * length
                at = start + own if part == 2 else start
                resize(machine, memory, own)
                status = agree(machine, memory, iteration, at, own, k, record)
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
                # Too long, or too long for the iteration or for an FMU.
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
        """Compute a group: 0, or a status, with more in `record`."""
        record[PART], record[STATUS], record[WHERE] = -1, 0, 0
        if doubling.places.shape[0] > 0:
            status = double(machine, memory, iteration, doubling, t, h, k, record)
        else:
            status = agree(machine, memory, iteration, t, h, k, record)
        if status != 0 and record[STATUS] == 0:
            record[STATUS] = status
        return status

    return compute
