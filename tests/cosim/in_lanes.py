"""One block stepped in lanes, without a diagram."""

import ctypes
from fractions import Fraction

import numpy as np

from bayesftc.cosim.diagram.memory import arrange
from bayesftc.cosim.stepping.machine.code import load, machine_code
from bayesftc.cosim.stepping.machine.lanes import lowered_to_lanes
from bayesftc.cosim.stepping.machine.steps import name_of, text_of

_STEP = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_void_p] * 4, ctypes.c_double, ctypes.c_int64)


def stepped_in_lanes(block, dt, values):
    """Return the outputs for inputs of shape (steps, lanes, inputs), of a block with an output function only."""
    _, lanes, _ = values.shape
    definition = block.define(Fraction(str(dt)))
    slots, memory = arrange(block, definition, 0)
    name = f"{name_of(definition.output, slots.sections)}_lanes"
    text, apart = text_of(definition.output, slots.sections, name)
    step = _STEP(load(machine_code(lowered_to_lanes(text, lanes, apart), wide=True), name))
    space = np.empty((len(memory) + 1) * lanes)
    first = -space.ctypes.data // 8 % lanes
    wide = space[first : first + len(memory) * lanes].reshape(len(memory), lanes)
    wide[:] = memory[:, None]
    starts = [slots.start[section] for section in ("state", "parameters", "inputs", "outputs")]
    places = [wide.ctypes.data + 8 * lanes * start for start in starts]
    places[1] = memory.ctypes.data + 8 * starts[1]
    rows = []
    for k, u in enumerate(values):
        wide[starts[2] : starts[2] + u.shape[1]] = u.T
        assert step(*places, k * dt, k) == 0
        rows.append(wide[starts[3] :].T.copy())
    return np.array(rows)
