"""The tables of 64-bit words by which compiled code uses the instances of a prediction."""

# The pool of instances: callbacks that add an instance and that replace one that has failed; sizes of the arrays that are filled
# with NaN after a failure (next state, control, sensors); the number of instances; then two words for each of them.
ADD, REPLACE, STATES, CONTROLS, SENSORS, COUNT = range(6)
HEAD = 6
LOCK, TABLE = range(2)
PLACE = 2

MOST = 64
"""Most instances of a pool; threads beyond wait."""

# An instance: whether it is for model exchange, the address of its own table, and the numbers of its states, controls, loads
# (one for each control, or none), inputs and outputs.
EXCHANGE, OWN, PLANT_STATES, DRIVEN, LOADS, INPUTS, OUTPUTS = range(7)
# Addresses: values of the inputs at rest, and present ones; outputs; sizes of states and controls for differences; the output of
# each sensor; scratch memory.
HELD, VALUES, SHOWN, SCALES, ORDER, WORK = range(7, 13)
# The step in seconds (double) and the number of parts into which the integrator divides it.
STEP, PARTS = range(13, 15)
# Directional derivatives: the function (0: none), the version of FMI; references of states and inputs, of derivatives and of
# outputs, each with their number.
DIRECTIONAL, MAJOR, KNOWNS, KNOWN_COUNT, RATES, RATE_COUNT, SEEN, SEEN_COUNT = range(15, 23)
# Scratch memory of matrices of derivatives, and of differences.
SLOPES, MOVED = range(23, 25)
# Co-simulation: the instance; its state in initialization mode and the function that restores it; the start values of the states
# (references) and the function that sets them; the function that ends initialization; its step and its outputs.
COMPONENT, RESTORE, SAVED, STARTS, SET_STARTS, EXIT, UPDATE, OUTPUT = range(25, 33)
WORDS = 33

REFUSED, BROKEN = 1, 2
"""Results of a computation: no finite value there; the instance may not be called any more."""
