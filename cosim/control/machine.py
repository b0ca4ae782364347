"""A diagram as two pure functions of time, state and inputs, which is how python-control looks at a system."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from math import isfinite
from typing import Any

import numpy as np

from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.control.externals import ExternalState, external_state
from bayesftc.cosim.control.hints import Hints
from bayesftc.cosim.control.state import state_places
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.errors import SimulationError, StepSizeError
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.run.engines import Draws, Failure
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.run.running import choose_engine, explain, open_run
from bayesftc.cosim.types import Floats

_ROUNDING = 1e-6
"""Part of a step by which python-control's sum of steps may miss the instant that it means."""

_SHOWN = 8
"""How many outputs are remembered: an interconnection asks for the same ones again and again while values pass through it."""

Asked = tuple[int, bytes, bytes]
"""A step, and the bytes of state and inputs."""


class Machine:
    """Evaluates a diagram at any time, state and input: the next state, and the outputs.

    Parameters
    ----------
    diagram : Diagram
        What to evaluate.
    inputs, outputs : sequence of (str, str, int)
        Block, port and element of each input and output; an input is the element of a port that feeds the others.
    seed : int or None
        Of the random streams; None for no noise.
    engine : {"auto", "compiled", "interpreted"}
        As in `Diagram.simulate`.

    Attributes
    ----------
    initial : ndarray
        The state at which the diagram begins.
    names : list of str
        Of the elements of the state.
    opaque : list of str
        Names of the FMUs of which the state is known to themselves alone.
    hints : Hints
        What its user is told.
    """

    def __init__(
        self,
        diagram: Diagram,
        inputs: Sequence[tuple[str, str, int]],
        outputs: Sequence[tuple[str, str, int]],
        seed: int | None,
        engine: str,
    ):
        self._settings = diagram, inputs, outputs, seed, engine
        self._schedule = schedule = diagram.schedule
        self._steps_per_time = schedule.step.denominator, schedule.step.numerator
        self._instant = 0.0, 0
        self._in, self._out = (_places(diagram, elements) for elements in (inputs, outputs))
        self._state = state_places(schedule)
        self._carried = np.array([place for place, _ in self._state], dtype=np.int64)
        self._stack = ExitStack()
        weakref.finalize(self, self._stack.close)
        self._open()
        self.initial = np.concatenate([schedule.initial[self._carried], *(e.initial for e in self._externals)])
        self.names = [name for _, name in self._state] + [name for e in self._externals for name in e.names]
        self.opaque = [e.title for e in self._externals if not e.real]
        self.hints = Hints(self.names, self.initial, [node.block for node in diagram.nodes])

    def _open(self) -> None:
        """Begin anew: with new instances of all FMUs."""
        seed, engine = self._settings[3:]
        self._stack.close()
        schedule = self._schedule
        self._run = open_run(
            schedule, self._stack, check_seed(seed or 0), select_signals(schedule, []), steps=0, decimation=1
        )
        self._engine = choose_engine(engine, self._run)
        self._draws = None if seed is None else Draws(self._run)
        for draw in schedule.draws:
            self._run.memory[draw.offset] = 0.5 if draw.uniform else 0.0  # the middle of either distribution
        self._externals: list[ExternalState] = [
            external_state(instance, schedule, i) for i, instance in sorted(self._run.instances.items())
        ]
        # The outputs that were asked for last, what memory stands at, and the step that was made last.
        self._shown: dict[Asked, Floats] = {}
        self._evaluated: Asked | None = None
        self._stepped: Asked | None = None
        self._after: Floats = np.zeros(0)

    def output(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the outputs at time `t`."""
        self.hints.params(params)
        key = self._asked(t, x, u)
        values = self._shown.get(key)
        if values is None:
            self._evaluate(key)
            values = self._run.memory[self._out]
            if len(self._shown) == _SHOWN:
                self._shown.clear()
            self._shown[key] = values
        return values.copy()

    def update(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the state one step after time `t`."""
        self.hints.params(params)
        key = self._asked(t, x, u)
        if key != self._stepped:
            if key[0] == 0:
                self.hints.beginning(np.frombuffer(key[1]))
            self._evaluate(key)
            k, self._evaluated, self._stepped = key[0], None, None
            self._make(self._engine.step, k)
            parts = [external.leave(k, self._run.memory) for external in self._externals]
            self._after = np.concatenate([self._run.memory[self._carried], *parts])
            self._stepped = key
        return self._after.copy()

    def held(self, t: float, x: Any, u: Any) -> tuple[Machine, Floats]:
        """Return what stands for the diagram in a linearization at a point, and the state there: what blocks learn is held."""
        asked = self._asked(t, x, u)
        self._evaluate(asked)
        schedule, memory = self._schedule, self._run.memory
        blocks = {
            node.name: node.block.held(
                {port.name: np.array(memory[schedule.signal(node, port)]) for port in node.block.outputs}
            )
            for node in schedule.nodes
        }
        state = np.frombuffer(asked[1])
        if all(blocks[node.name] is node.block for node in schedule.nodes):
            return self, state
        diagram, inputs, outputs, seed, _ = self._settings
        # Interpreted: to compile blocks anew takes longer than the few steps of a linearization.
        machine = Machine(diagram.rewired(blocks), inputs, outputs, seed, "interpreted")
        known = dict(zip(self.names, state, strict=True))
        values = [known.get(name, start) for name, start in zip(machine.names, machine.initial, strict=True)]
        return machine, np.array(values, dtype=np.float64)

    def _asked(self, t: float, x: Any, u: Any) -> Asked:
        if t != self._instant[0]:
            self._instant = t, self._step_of(t)
        return self._instant[1], np.asarray(x, dtype=np.float64).tobytes(), np.asarray(u, dtype=np.float64).tobytes()

    def _step_of(self, t: float) -> int:
        ratio = t * self._steps_per_time[0] / self._steps_per_time[1]
        k = round(ratio) if isfinite(ratio) else -1
        if k < 0 or abs(ratio - k) > _ROUNDING * max(k, 1):
            raise StepSizeError(
                f"The system was asked for t = {t:g} s, but it has a sample time of {show(self._schedule.step)} s and begins "
                "at 0; give times that are whole multiples of it."
            )
        return k

    def _evaluate(self, asked: Asked) -> None:
        """Bring outputs and inputs into memory as they are at a step, in a state, with inputs from outside."""
        if asked == self._evaluated:
            return
        self._evaluated = None
        k, state, inputs = asked[0], np.frombuffer(asked[1]), np.frombuffer(asked[2])
        parts = self._parts(state)
        if any(external.over(part) for external, part in parts):
            self._open()
            parts = self._parts(state)
        memory = self._run.memory
        memory[self._carried] = state[: len(self._carried)]
        memory[self._in] = inputs[: len(self._in)]
        for external, part in parts:
            external.load(k, part)
        if self._draws is not None:
            self._draws.fill(k)
        self._make(self._engine.evaluate, k)
        for external in self._externals:
            external.evaluated(k)
        self._evaluated = asked

    def _parts(self, state: Floats) -> list[tuple[ExternalState, Floats]]:
        begin, parts = len(self._carried), []
        for external in self._externals:
            parts.append((external, state[begin : begin + len(external.names)]))
            begin += len(external.names)
        return parts

    def _make(self, phase: Callable[[int], Failure | None], k: int) -> None:
        """Make a phase of a step; where it fails or is interrupted, the FMUs are in no state that is known."""
        try:
            failure = phase(k)
            if failure is not None:
                sentence = explain(failure, self._run)
                raise SimulationError(sentence.replace("; the signals up to the step before are kept", ""))
        except BaseException:
            for external in self._externals:
                external.lose()
            raise

    # A copy, as python-control makes of a system that stands twice in a diagram, has FMUs of its own.
    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._settings


def _places(diagram: Diagram, elements: Sequence[tuple[str, str, int]]) -> np.ndarray[Any, np.dtype[np.int64]]:
    schedule = diagram.schedule
    found = [schedule.signal(diagram[name], diagram[name].block.port(port)).start + i for name, port, i in elements]
    return np.array(found, dtype=np.int64)
