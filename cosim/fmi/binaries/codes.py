"""Statuses of the step of an FMU, and the layout of its scratch memory; shared by compiled code and Python."""

GET, SET, STEP, EVENTS = 100, 200, 300, 500
"""Which function failed; FMI's own status is added."""

EARLY, TERMINATED, ENDLESS = 401, 402, 403
UNFIT_INPUT, UNFIT_OUTPUT = 601, 602

LAST = 5
"""The last status that FMI defines."""

ODD, MOST = 100, 4_999
"""For any other status: the factor of the failed function's code, and the largest status that is not clipped."""

DISCARD, FATAL, PENDING = 2, 4, 5

# Words of the scratch memory. The first four receive the results of fmi3DoStep; a C bool takes the lowest byte of its word. Then
# come the answer of fmi2GetXStatus, the index of a value that does not fit, and the results of fmi3UpdateDiscreteStates. The
# last two are noSetFMUStatePriorToCurrentPoint and the time of the next tick of a clock.
EVENT, TERMINATE, RETURNED_EARLY, REACHED, ANSWER, UNFIT, UPDATE = range(7)
UPDATE_TERMINATE, NEXT_DEFINED, NEXT_TIME = UPDATE + 1, UPDATE + 4, UPDATE + 5
NO_RETURN, DUE = 12, 13
SCRATCH_WORDS = 14

TOLERANCE = 1e-9
"""Fraction of a step that may be missing at its end without counting as an early return."""

SMALLEST = 1e-6
"""Fraction of a step below which a discarded step is not cut further."""

TRIES = 10_000
"""Most early returns or discards of a step, and updates of an event, before it counts as endless."""

LAST_TIME, HAS_TERMINATED = 2, 3
"""Kinds of fmi2GetRealStatus and fmi2GetBooleanStatus."""

EXACT = 2.0**53
"""From here on, doubles cannot represent every whole number."""


def failed(where: int, status: int) -> int:
    """Return 0 for FMI's OK and Warning, else the status of a step, see `decoded`; it is also used in compiled code."""
    if status == 0 or status == 1:
        return 0
    if status > 1 and status <= LAST:
        return where + status
    return ODD * where + min(max(status, -MOST), MOST) + MOST


def decoded(status: int) -> tuple[int, int]:
    """Return what has failed (`GET`, `SET`, `STEP`, `EVENTS`, or another code), and FMI's own status."""
    if status >= ODD * GET:
        where, code = divmod(status, ODD * GET)
        return where * GET, code - MOST
    where = status // GET * GET
    return (where, status - where) if where in {GET, SET, STEP, EVENTS} else (where, 0)
