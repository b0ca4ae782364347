"""Prediction with a co-simulation FMU: initialize it at the state, and make one step.

A state can only be set as start values, in initialization mode. So the FMU's saved state of that mode is restored each time.
"""

# mypy expects the typing context of intrinsics, which numba passes by itself.
# mypy: disable-error-code="call-arg, var-annotated, misc"

from bayesftc.cosim.fmi.prediction.by_exchange import of_step
from bayesftc.cosim.fmi.prediction.words import (
    BROKEN,
    COMPONENT,
    EXIT,
    MAJOR,
    OUTPUT,
    OWN,
    PLANT_STATES,
    REFUSED,
    RESTORE,
    SAVED,
    SET_STARTS,
    SHOWN,
    STARTS,
    UPDATE,
    VALUES,
)
from bayesftc.cosim.fmi.running.kernels import mode3, number, put_number, values2, values3, word
from bayesftc.cosim.stepping.by_address import call_block, put_back
from bayesftc.cosim.stepping.numba_called import callee


@callee
def _begin(table, x):
    """Initialize the FMU at the state at an address."""
    component, n = word(table, COMPONENT), word(table, PLANT_STATES)
    status = put_back(word(table, RESTORE), component, word(table, SAVED))
    if status > 1 or status < 0:
        return BROKEN
    if word(table, MAJOR) == 2:
        status = values2(word(table, SET_STARTS), component, word(table, STARTS), n, x)
    else:
        status = values3(word(table, SET_STARTS), component, word(table, STARTS), n, x, n)
    if status == 0 or status == 1:
        status = mode3(word(table, EXIT), component)
    if status == 0 or status == 1:
        return 0
    return REFUSED if status == 2 else BROKEN


@callee
def step(table, x, following):
    """Write the state one step after the state at the address `x`, with the inputs in ``VALUES`` held."""
    own, shown = word(table, OWN), word(table, SHOWN)
    result = _begin(table, x)
    if result != 0:
        return result
    result = of_step(call_block(word(table, UPDATE), 0, own, word(table, VALUES), 0, 0.0, 0))
    if result != 0:
        return result
    result = of_step(call_block(word(table, OUTPUT), 0, own, 0, shown, 0.0, 0))
    for i in range(word(table, PLANT_STATES)):  # the states are the first of the instance's outputs
        put_number(following, i, number(shown, i))
    return result


@callee
def show_begin(table, x):
    """Write the states and the outputs at a state into ``SHOWN``."""
    result = _begin(table, x)
    if result != 0:
        return result
    return of_step(call_block(word(table, OUTPUT), 0, word(table, OWN), 0, word(table, SHOWN), 0.0, 0))
