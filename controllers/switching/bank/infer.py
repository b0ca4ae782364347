"""The joint form of switching: a bank of hypotheses about offsets, each with a belief about state and offset together.

One hypothesis has none of these faults. Each other one has one of the following:

- an offset of one kind on one sensor, or a fault of one kind of one actuator, estimated together with the state, which
  distinguishes a drift of one sensor from the state's motion;
- an unmodelled course of a sensor (`Unmodelled`): the state is inferred without it;
- the same offset on all sensors that measure the same: they failed, and the plant was not kicked; or the recent end of it;
- a mode of the process: more process noise than nominal, or a belief that fades.

Each hypothesis keeps all else sensor by sensor, as the per-sensor form does: frozen, noisier, dropped out, and the offsets of
*further* sensors. Let there be K kinds of offsets, of which J jump, and U unmodelled courses on m sensors, g groups of sensors
that measure the same (one, if all do, else none), L modes of p actuators and G of the process. The number of hypotheses is then
1 + m (K + J + U) + 2 g + p L + (G + 1 if there are any), for any number of simultaneous sensor faults.

At each sample every hypothesis is predicted; then offsets begin and end. Ended ones are first merged (the pool), and go from
there to no offset, or to the offset that a further sensor has meanwhile. Three transitions come later. An offset that jumps joins
earlier ones after its first sample. The end of a common offset remains a hypothesis for one sample, and the end of a process mode
for a while (the one more). Faults of actuators and the process also begin while a sensor has an offset, which then becomes one of
its modes (`merges.make_gather`). Beliefs with the same hypothesis are merged by moments, as in an interacting-multiple-model
filter (Blom and Bar-Shalom 1988); only a vague state of the pool counts less in the hypothesis without a fault (`onsets.py`).
Then each hypothesis is conditioned on the sensors one after the other, and gets the probability of their samples. At last each
sensor is judged anew given all others (`conditioning.make_review`). The probability of an unmodelled course is limited while the
process is quieter than the model says (`calm.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from bayesftc.controllers.switching.bank.layout import LOAD, PUSHES, STEERS, WORKS, Layout
from bayesftc.controllers.switching.bank.outages import make_keep, make_restore
from bayesftc.controllers.switching.bank.samples import make_conclude, make_learn_sensors, make_summarise, make_weigh
from bayesftc.controllers.switching.bank.time import make_pass_time
from bayesftc.controllers.switching.outages import make_outage
from bayesftc.controllers.switching.sensor_kernels import failed, use_trust


@cache
def make_infer(
    layout: Layout,
    pass_alone: Callable[..., None],
    weigh_alone: Callable[..., float],
    pass_other: Callable[..., None],
    weigh_other: Callable[..., float],
) -> Callable[..., None]:
    """Return the step function that infers state and faults together.

    Parameters
    ----------
    layout : Layout
        Places in memory and settings.
    pass_alone, weigh_alone : function
        Transitions and weights of a sensor's modes where no sensor has an offset.
    pass_other, weigh_other : function
        The same for the other sensors where one has an offset.
    """
    pass_time, weigh = make_pass_time(layout, pass_alone, pass_other), make_weigh(layout, weigh_alone, weigh_other)
    conclude, summarise, learn_sensors = make_conclude(layout), make_summarise(layout), make_learn_sensors(layout)
    m, p, sensor, width, faults = layout.m, layout.p, layout.sensor, layout.width, layout.faults
    count, first, actuator = m * layout.sensor, layout.actuators, layout.actuator
    outages, keep, restore = layout.outages, make_keep(layout), make_restore(layout)
    outage = make_outage(sensor, layout.row, width, layout.drops)

    def infer(sample, trust, belief, model, actuators, learning, reach):
        memory, settings = learning.memory, learning.settings
        if outages:
            keep(memory)
        pass_time(sample, model, memory[count] < 0.5, belief.covariance, reach[0], actuators.applied, memory, settings)
        weigh(sample, model.C, memory, settings)
        if outages:
            restore(outage(sample, memory, settings), memory)
        conclude(belief, memory, settings)
        summarise(memory, settings)
        learn_sensors(sample, memory, settings)
        for i in range(m):
            use_trust(memory, sensor, i, sample, trust)
            trust.fault_probability[i] = failed(memory, i * sensor, width, faults)
        for j in range(p):
            place = first + j * actuator
            actuators.works[0, j], actuators.load[0, j] = memory[place + WORKS], memory[place + LOAD]
            actuators.works[1, j], actuators.load[1, j] = memory[place + STEERS], memory[place + PUSHES]
        memory[count] = memory[count] + 1.0

    return infer
