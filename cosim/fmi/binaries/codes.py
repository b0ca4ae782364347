"""What the step of an FMU returns, and where it keeps what FMI returns: the same numbers for both engines."""

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
# is made that no state before the step will be restored (noSetFMUStatePriorToCurrentPoint).
EVENT, TERMINATE, RETURNED_EARLY, REACHED, ANSWER, UNFIT, UPDATE = range(7)
UPDATE_TERMINATE, NEXT_DEFINED, NEXT_TIME = UPDATE + 1, UPDATE + 4, UPDATE + 5
NO_RETURN = 12
SCRATCH_WORDS = 13

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
