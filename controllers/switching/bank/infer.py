"""A bank of hypotheses about offsets, each with its own belief about state and offset together: the joint form of switching.

One hypothesis has no fault of these kinds. Each other one has one of the following:

- an offset of one kind on one sensor, or a fault of one kind of one actuator, which is estimated together with the state, so that
  a drift of one sensor is told from the state's own motion;
- a sensor that goes a course of its own (`Unmodelled`): the state is inferred without it;
- the same offset on all sensors that read the same: they failed, and the plant was not kicked; or such an offset has just ended;
- a mode of the process: more process noise than nominal, or a belief that fades.

All that needs no moments together with the state (frozen, noisier, dropped out, and the offsets of *further* sensors) each
hypothesis keeps sensor by sensor, as the per-sensor form does. So for K kinds of offsets, of which J jump, and U courses on m
sensors, g groups of sensors that read the same (one, if all do, else none), L modes of p actuators and G of the process there are
1 + m (K + J + U) + 2 g + p L + (G + 1 if there are any) of them, however many sensors fail at once.

At each sample every hypothesis moves; then offsets begin and end. What has ended is merged first (the pool) and goes on from
there: to no offset, or to the offset that a further sensor has meanwhile. Three go on later: an offset that jumps joins earlier
ones after its first sample; that one of all sensors that read the same has ended remains a hypothesis for one sample, and that a
mode of the process has ended for a while (the one more). Beliefs that arrive at the same hypothesis are merged by moments, as in
an interacting-multiple-model filter (Blom and Bar-Shalom 1988). Then each hypothesis is conditioned on the sensors one after the
other, and gets the probability of what they said.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.layout import LOAD, PUSHES, STEERS, WORKS, Layout
from bayesftc.controllers.switching.bank.samples import make_conclude, make_listen, make_summarise, make_weigh
from bayesftc.controllers.switching.bank.time import make_pass_time
from bayesftc.controllers.switching.sensor_kernels import failed, use_trust


@cache
def make_infer(
    layout: Layout,
    pass_alone: Callable[..., None], weigh_alone: Callable[..., float],
    pass_other: Callable[..., None], weigh_other: Callable[..., float],
) -> Callable[..., None]:  # fmt: skip
    """Return the step function that infers state and faults together.

    Parameters
    ----------
    layout : Layout
        Where everything stands.
    pass_alone, weigh_alone : function
        Time passing and weighing of a sensor's modes where no sensor has an offset.
    pass_other, weigh_other : function
        The same of the other sensors where one has an offset.
    """
    pass_time, weigh = make_pass_time(layout, pass_alone, pass_other), make_weigh(layout, weigh_alone, weigh_other)
    conclude, summarise, listen = make_conclude(layout), make_summarise(layout), make_listen(layout)
    m, p, sensor, width, faults = layout.m, layout.p, layout.sensor, layout.width, layout.faults
    count, first, actuator = m * layout.sensor, layout.actuators, layout.actuator

    def infer(sample, trust, belief, model, actuators, learning, reach):
        memory, settings = learning.memory, learning.settings
        pass_time(sample, model, memory[count] < 0.5, belief.covariance, reach[0], actuators.applied, memory, settings)
        weigh(sample, model.C, memory, settings)
        conclude(belief, memory, settings)
        summarise(memory, settings)
        listen(sample, memory, settings)
        for i in range(m):
            use_trust(memory, sensor, i, sample, trust)
            trust.fault_probability[i] = failed(memory, i * sensor, width, faults)
        for j in range(p):
            own = first + j * actuator
            actuators.works[0, j], actuators.load[0, j] = memory[own + WORKS], memory[own + LOAD]
            actuators.works[1, j], actuators.load[1, j] = memory[own + STEERS], memory[own + PUSHES]
        memory[count] = memory[count] + 1.0

    return infer
