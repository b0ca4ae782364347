"""A diagram as two pure functions of time, state and inputs, as python-control needs them."""

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
"""Tolerance for times, as a part of a step, because python-control adds up step sizes."""

_CACHED = 8
"""Number of cached outputs. An interconnection evaluates the same outputs repeatedly while values pass through it."""

Point = tuple[int, bytes, bytes]
"""A step, and the bytes of state and inputs."""


class Machine:
    """Evaluates a diagram at any time, state and input: the next state, and the outputs.

    Parameters
    ----------
    diagram : Diagram
        The diagram.
    inputs, outputs : sequence of (str, str, int)
        Block, port and element of each input and output. An input is the element of a port that feeds others.
    seed : int or None
        Seed of the random streams; None for no noise.
    engine : {"auto", "compiled", "interpreted"}
        As in `Diagram.simulate`.

    Attributes
    ----------
    initial : ndarray
        The initial state of the diagram.
    names : list of str
        Names of the elements of the state.
    opaque : list of str
        Names of the FMUs whose states are hidden.
    hints : Hints
        Warnings for the user.
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
        """Start again with new instances of all FMUs."""
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
        # Cached outputs, the point of the values in memory, and the point of the last step.
        self._cache: dict[Point, Floats] = {}
        self._evaluated: Point | None = None
        self._stepped: Point | None = None
        self._after: Floats = np.zeros(0)

    def output(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the outputs at time `t`."""
        self.hints.params(params)
        key = self._point(t, x, u)
        values = self._cache.get(key)
        if values is None:
            self._evaluate(key)
            values = self._run.memory[self._out]
            if len(self._cache) == _CACHED:
                self._cache.clear()
            self._cache[key] = values
        return values.copy()

    def update(self, t: float, x: Any, u: Any, params: object = None) -> Floats:
        """Return the state one step after time `t`."""
        self.hints.params(params)
        key = self._point(t, x, u)
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
        """Return the machine for a linearization at a point, in which blocks do not learn, and its state there."""
        point = self._point(t, x, u)
        self._evaluate(point)
        schedule, memory = self._schedule, self._run.memory
        blocks = {
            node.name: node.block.held(
                {port.name: np.array(memory[schedule.signal(node, port)]) for port in node.block.outputs}
            )
            for node in schedule.nodes
        }
        state = np.frombuffer(point[1])
        if all(blocks[node.name] is node.block for node in schedule.nodes):
            return self, state
        diagram, inputs, outputs, seed, _ = self._settings
        # Interpreted, because compiling the new blocks takes longer than the few steps of a linearization.
        machine = Machine(diagram.rewired(blocks), inputs, outputs, seed, "interpreted")
        by_name = dict(zip(self.names, state, strict=True))
        values = [by_name.get(name, start) for name, start in zip(machine.names, machine.initial, strict=True)]
        return machine, np.array(values, dtype=np.float64)

    def _point(self, t: float, x: Any, u: Any) -> Point:
        if t != self._instant[0]:
            self._instant = t, self._step_of(t)
        return self._instant[1], np.asarray(x, dtype=np.float64).tobytes(), np.asarray(u, dtype=np.float64).tobytes()

    def _step_of(self, t: float) -> int:
        ratio = t * self._steps_per_time[0] / self._steps_per_time[1]
        k = round(ratio) if isfinite(ratio) else -1
        if k < 0 or abs(ratio - k) > _ROUNDING * max(k, 1):
            raise StepSizeError(
                f"The system cannot be evaluated at t = {t:g} s, because it has a sample time of {show(self._schedule.step)} s "
                "and begins at 0; give times that are whole multiples of the sample time."
            )
        return k

    def _evaluate(self, point: Point) -> None:
        """Compute outputs and inputs in memory for a step, a state, and inputs from outside."""
        if point == self._evaluated:
            return
        self._evaluated = None
        k, state, inputs = point[0], np.frombuffer(point[1]), np.frombuffer(point[2])
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
        self._evaluated = point

    def _parts(self, state: Floats) -> list[tuple[ExternalState, Floats]]:
        begin, parts = len(self._carried), []
        for external in self._externals:
            parts.append((external, state[begin : begin + len(external.names)]))
            begin += len(external.names)
        return parts

    def _make(self, phase: Callable[[int], Failure | None], k: int) -> None:
        """Make a phase of a step. If it fails or is interrupted, the state of the FMUs is unknown."""
        try:
            failure = phase(k)
            if failure is not None:
                raise SimulationError(explain(failure, self._run))
        except BaseException:
            for external in self._externals:
                external.lose()
            raise

    # A copy has its own FMUs. python-control copies a system that occurs twice in a diagram.
    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._settings


def _places(diagram: Diagram, elements: Sequence[tuple[str, str, int]]) -> np.ndarray[Any, np.dtype[np.int64]]:
    schedule = diagram.schedule
    places = [schedule.signal(diagram[name], diagram[name].block.port(port)).start + i for name, port, i in elements]
    return np.array(places, dtype=np.int64)
