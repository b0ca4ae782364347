"""Run a subsystem, one step at a time, in your own loop or on hardware."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.diagram.diagram import Diagram, is_external
from bayesftc.cosim.diagram.opening import OUTSIDE, opened
from bayesftc.cosim.diagram.schedule import Call, Schedule
from bayesftc.cosim.errors import ModelError, StepSizeError
from bayesftc.cosim.run.online import Online, Step, compiled_step, plain_step

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.subsystem import Subsystem


class OnlineSubsystem(Online):
    """A subsystem as a callable that makes one step at each call; made by `Subsystem.online`.

    It is called as `Online`.

    Parameters
    ----------
    block : Subsystem
        The subsystem. This object holds its state.
    dt : float, str or Fraction, optional
        Its sample time in seconds, if given.
    compiled : bool
        False for the plain Python form.
    """

    def __init__(self, block: Subsystem, dt: float | str | Fraction | None = None, *, compiled: bool = True):
        if dt is not None and rational_step(dt) != block.sample_time:
            raise StepSizeError(
                f"The subsystem runs every {show(block.sample_time)} s, not every {show(rational_step(dt))} s."
            )
        self._block, self._step, self._compiled = block, block.sample_time, compiled
        diagram = Diagram(self._step)
        node = diagram.add(block)
        if external := [each.name for each in diagram.nodes if is_external(each)]:
            raise ModelError(f"{external[0]} in the subsystem is an FMU, which runs in diagrams only.")
        places = [(node, port, i) for port in block.inputs for i in range(port.size)]
        whole, _ = opened(diagram, places, "online")
        schedule = whole.schedule
        if schedule.draws:
            raise ModelError(
                f"{schedule.draws[0].stream} in the subsystem is random; make it an input of the subsystem."
            )
        self._initial = schedule.initial
        self._memory = schedule.initial.copy()
        self._calls = [self._call(schedule, call, compiled) for call in (*schedule.evaluate, *schedule.advance)]
        first = schedule.signal(whole[OUTSIDE], whole[OUTSIDE].port("u")).start if places else 0
        self._inputs = {}
        for port in block.inputs:
            self._inputs[port.name] = port, self._memory[first : first + port.size].reshape(port.shape or (1,))
            first += port.size
        shown = whole[node.name]
        self._outputs = {
            port.name: (port, self._memory[schedule.signal(shown, port)].reshape(port.shape or (1,)))
            for port in block.outputs
        }
        self._k = 0
        self._of_nodes = tuple(schedule.slots)

    @property
    def _fixed(self) -> Any:
        spans = [np.arange(slots.start["parameters"], slots.start["inputs"]) for slots in self._of_nodes]
        return np.concatenate([np.arange(0), *spans])

    def _call(self, schedule: Schedule, call: Call, compiled: bool) -> Step:
        """Return one call of the schedule: it copies inputs, then runs the step function, in the steps in which it is due."""
        kernel, definition = schedule.kernel(call), schedule.definitions[call.node]
        assert definition is not None
        made = compiled_step if compiled and definition.compiled else plain_step
        function = None if kernel is None else made(kernel, schedule.slots[call.node], self._memory)
        targets, sources = (np.array([gather[side] for gather in call.gathers], dtype=int) for side in (0, 1))
        memory, every = self._memory, schedule.every(call)

        def step(t: float, k: int) -> None:
            if k % every == 0:
                memory[targets] = memory[sources]
                if function is not None:
                    function(t, k // every)

        return step
