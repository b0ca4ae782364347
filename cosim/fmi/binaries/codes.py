"""What the step of an FMU returns, and where it keeps what FMI returns: numbers that compiled code and Python share."""

GET, SET, STEP, EVENTS = 100, 200, 300, 500
"""Functions that failed; FMI's own status is added."""

EARLY, TERMINATED, ENDLESS = 401, 402, 403
UNFIT_INPUT, UNFIT_OUTPUT = 601, 602

LAST = 5
"""The last status that FMI knows."""

ODD, MOST = 100, 4_999
"""Of any other status: factor of where it came from, and the largest that is told from larger ones."""

DISCARD, FATAL, PENDING = 2, 4, 5

# Words of the scratch memory for what fmi3DoStep returns; a C bool takes the lowest byte of its word. Then what the status of
# fmi2DoStep is asked, the place of a value that does not fit, and what fmi3UpdateDiscreteStates returns; last whether a promise
# is made that no state before the step will be restored (noSetFMUStatePriorToCurrentPoint), and when a clock is to tick next.
EVENT, TERMINATE, RETURNED_EARLY, REACHED, ANSWER, UNFIT, UPDATE = range(7)
UPDATE_TERMINATE, NEXT_DEFINED, NEXT_TIME = UPDATE + 1, UPDATE + 4, UPDATE + 5
NO_RETURN, DUE = 12, 13
SCRATCH_WORDS = 14

TOLERANCE = 1e-9
"""Part of a step that an FMU may fall short of its end before it counts as an early return."""

SMALLEST = 1e-6
"""Part of a step below which a step that was discarded is not cut further."""

TRIES = 10_000
"""How often a step may return early or be discarded, and an event be updated, before it counts as endless."""

LAST_TIME, HAS_TERMINATED = 2, 3
"""Kinds of fmi2GetRealStatus and fmi2GetBooleanStatus."""

EXACT = 2.0**53
"""From here on, not every whole number is a double."""


def failed(where: int, status: int) -> int:
    """Return 0 for FMI's OK and Warning, else the status of a step, see `decoded`; it is compiled as well."""
    if status == 0 or status == 1:
        return 0
    if status > 1 and status <= LAST:
        return where + status
    return ODD * where + min(max(status, -MOST), MOST) + MOST


def decoded(status: int) -> tuple[int, int]:
    """Return what has failed (`GET`, `SET`, `STEP`, `EVENTS`, or another code), and the status that FMI's function returned."""
    if status >= ODD * GET:
        where, code = divmod(status, ODD * GET)
        return where * GET, code - MOST
    where = status // GET * GET
    return (where, status - where) if where in {GET, SET, STEP, EVENTS} else (where, 0)
