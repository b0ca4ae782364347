"""The table of 64-bit words that describes a model exchange FMU and its integrator to compiled functions.

Addresses and counts are integers, times and tolerances doubles. `NAMES` are the FMI functions, in the order of their words, by
the roles that `bayesftc.cosim.fmi.binaries.model_library` gives them.
"""

NAMES = (
    "set_time",
    "set_states",
    "get_states",
    "get_derivatives",
    "get_indicators",
    "get_nominals",
    "completed_step",
    "enter_event_mode",
    "enter_continuous_mode",
    "update_discrete",
)

# The FMI functions.
(
    SET_TIME,
    SET_STATES,
    GET_STATES,
    GET_DERIVATIVES,
    GET_INDICATORS,
    GET_NOMINALS,
    COMPLETED_STEP,
    ENTER_EVENT,
    ENTER_CONTINUOUS,
    UPDATE_DISCRETE,
) = range(10)
# The FMU: version, instance, numbers of states and indicators, whether it needs completed steps, and whether no earlier state
# will be restored. Its inputs and outputs: groups (`bayesftc.cosim.fmi.binaries.groups`) and their number; for inputs, also the
# number of elements and their address. Its states.
(
    MAJOR,
    COMPONENT,
    STATES,
    INDICATORS,
    WANTS_STEPS,
    NO_RETURN,
    IN_GROUPS,
    IN_GROUP_COUNT,
    IN_SIZE,
    INPUTS,
    OUT_GROUPS,
    OUT_GROUP_COUNT,
    X,
) = range(10, 23)
# Doubles: its time, its next time event (infinity for none). Integers: the seconds of a communication step as a fraction.
TIME, NEXT_EVENT, NUMERATOR, DENOMINATOR = range(23, 27)
# The integrator: its kind, absolute tolerances (an array), relative and absolute tolerance (doubles; -1 for one from nominal
# values), most steps between two stops, scratch memory; CVODE's memory, vectors of states and tolerances, and functions.
(
    INTEGRATOR,
    TOLERANCES,
    RTOL,
    ATOL,
    LIMIT,
    WORK,
    MEMORY,
    VECTOR,
    TOLERANCE_VECTOR,
    INTEGRATE,
    RESTART,
    SET_STOP,
    SET_TOLERANCES,
) = range(27, 40)
# Results: time reached (double), flags of a completed step; role, status and time (double) of a failed call; why a step stopped,
# the integrator's status, its steps; the failed group or element of the ports; and the results of an event update.
REACHED, ENTER, TERMINATE, ROLE, STATUS, WHEN, REASON, FLAG, STEPS, UNFIT, INFO = range(40, 51)
WORDS = 57

STEP_WORD = 1
"""The engine has two words for an instance: the table's address and the step size in seconds. The latter may be changed."""

SAME = 1e-9
"""Fraction of a step within which its end counts as the communication point."""

NONE, CVODE, RUNGE_KUTTA, PYTHON = range(4)
"""Integrators; the last is a Python callback at the address in the word `INTEGRATE`."""

NAN_DERIVATIVE, NAN_INDICATOR, SET_VALUES, GET_VALUES, NAN_STATE = 101, 102, 103, 104, 105
"""Roles for results that are NaN or infinite, and for the functions that set inputs and read outputs."""

(
    CALL,
    ENDS,
    ENDS_AFTER_STEP,
    ENDLESS,
    NO_TIME,
    CHATTERS,
    GIVES_UP,
    TOO_MANY,
    TOO_SMALL,
    UNFIT_INPUT,
    UNFIT_OUTPUT,
    TOO_MANY_EVENTS,
    RAISED,
) = range(1, 14)
"""Reasons: a call failed; the FMU ends the simulation, at an event or after a step; its event iteration does not end; its next
event is at NaN; its events do not end; the integrator gives up, needs too many steps, or steps that are too small; a value does
not fit the type of a port; there are too many events in a step; an integrator in Python has raised an exception."""

STOPPED = 501
"""The status of a step that stopped for one of these reasons."""

INTERRUPTED = 902  # as in bayesftc.cosim.isolation.protocol
"""The status if Python has raised an exception that is no failure of the FMU, as Ctrl-C."""

ITERATIONS = 1000
"""Most passes of the event iteration at one instant before it counts as endless."""

QUIET_EVENTS = 100
"""Number of consecutive events at the same time that counts as chattering."""

MOST_EVENTS = 100_000
"""Most events in one communication step before it counts as endless."""

EPS = 2.220446049250313e-16
NEAR, QUIET, QUIET_STEP = 8 * EPS, 1e3 * EPS, 1e-9
"""Fraction of the time within which two instants are equal, and fractions of time and step that count as no progress."""

PRECISION = 100 * EPS
"""Accuracy of an event's time, as a fraction of the time and of the integrator's step."""
