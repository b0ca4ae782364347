"""The table of 64-bit words by which compiled functions know a model exchange FMU and its integrator.

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
    SET_TIME, SET_STATES, GET_STATES, GET_DERIVATIVES, GET_INDICATORS, GET_NOMINALS, COMPLETED_STEP, ENTER_EVENT,
    ENTER_CONTINUOUS, UPDATE_DISCRETE,
) = range(10)  # fmt: skip
# The FMU: version, instance, numbers of states and indicators, whether it wants to be told of steps and whether nobody goes
# back before one; its inputs and outputs: groups (`bayesftc.cosim.fmi.binaries.groups`) and how many, for inputs how
# many elements and
# where they lie; its states.
(
    MAJOR, COMPONENT, STATES, INDICATORS, WANTS_STEPS, NO_RETURN, IN_GROUPS, IN_GROUP_COUNT, IN_SIZE, INPUTS, OUT_GROUPS,
    OUT_GROUP_COUNT, X,
) = range(10, 23)  # fmt: skip
# Doubles: its time, its next time event (infinity for none); and the seconds of a communication step as a fraction.
TIME, NEXT_EVENT, NUMERATOR, DENOMINATOR = range(23, 27)
# The integrator: which one, absolute tolerances (an array), relative and absolute tolerance (doubles; -1 for that of nominal
# values), most steps in a stretch, memory to work in; CVODE's memory, vectors of states and tolerances, and functions.
(
    INTEGRATOR, TOLERANCES, RTOL, ATOL, LIMIT, WORK, MEMORY, VECTOR, TOLERANCE_VECTOR, INTEGRATE, RESTART, SET_STOP,
    SET_TOLERANCES,
) = range(27, 40)  # fmt: skip
# What is written: time reached (double), flags of a completed step, the role and status of a call that failed and its time
# (double), why a step stopped, what the integrator returned, its steps; which group or element of the ports it was; and what an
# event update answers.
REACHED, ENTER, TERMINATE, ROLE, STATUS, WHEN, REASON, FLAG, STEPS, UNFIT, INFO = range(40, 51)
WORDS = 57

STEP_WORD = 1
"""Word of what the engine keeps of an instance - the table's address and the step size in seconds - that may be changed."""

SAME = 1e-9
"""Part of a step that its end may be off a communication point and is that point all the same."""

NONE, CVODE, RUNGE_KUTTA, PYTHON = range(4)
"""Integrators; the last is called back, at the address of the word `INTEGRATE`."""

NAN_DERIVATIVE, NAN_INDICATOR, SET_VALUES, GET_VALUES, NAN_STATE = 101, 102, 103, 104, 105
"""Roles of what did not fail but came out NaN or infinite, and of the functions that set inputs and read outputs."""

(
    CALL, ENDS, ENDS_AFTER_STEP, ENDLESS, NO_TIME, CHATTERS, GIVES_UP, TOO_MANY, TOO_SMALL, UNFIT_INPUT, UNFIT_OUTPUT,
    TOO_MANY_EVENTS, RAISED,
) = range(1, 14)  # fmt: skip
"""Reasons: a call failed; the FMU ends the simulation, at an event or after a step; its event iteration does not end; its next
event is at NaN; its events do not end; the integrator gives up, needs too many steps, or steps that are too small; the type of
a port does not hold a value; there are too many events in a step; an integrator in Python has raised what it keeps."""

STOPPED = 501
"""The status of a step that stopped for one of these reasons."""

INTERRUPTED = 902  # as in bayesftc.cosim.isolation.protocol
"""The status where Python has raised what is no failure of the FMU: Ctrl-C, say."""

ITERATIONS = 1000
"""Turns of the event iteration at one instant, after which it is taken to be endless."""

QUIET_EVENTS = 100
"""Events one after the other, without time going on between them, that are taken for chattering."""

MOST_EVENTS = 100_000
"""Events in one communication step, after which it is taken not to end in anybody's lifetime."""

EPS = 2.220446049250313e-16
NEAR, QUIET, QUIET_STEP = 8 * EPS, 1e3 * EPS, 1e-9
"""Part of the present time in which two instants are one, and parts of time and step in which time has not gone on."""

PRECISION = 100 * EPS
"""Part of the present time and of an integrator's step to which an event is located."""
