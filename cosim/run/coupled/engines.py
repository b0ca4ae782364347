"""Groups in a run: the tables of the compiled form, the Python form, and the FMUs' saved states for both."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayesftc._interrupt import import_whole
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.diagram.groups import WORDS, Group, Part
from bayesftc.cosim.diagram.memory import bind
from bayesftc.cosim.diagram.schedule import NOT_FINITE
from bayesftc.cosim.errors import FMUCrashed, FMUError
from bayesftc.cosim.run.coupled import steps
from bayesftc.cosim.run.state_functions import ERROR, StateFunctions

if TYPE_CHECKING:
    from bayesftc.cosim.block import External, VariableStep
    from bayesftc.cosim.run.engines import Run
    from bayesftc.cosim.types import Kernel

_ACCELERATION = {None: steps.PLAIN, "aitken": steps.AITKEN, "anderson": steps.ANDERSON}
_MARGIN = 0.5
"""Safety factor for a larger step size; without it every other step would be too long."""


class GroupRun(ABC):
    """A group in a run, in either engine: its tables and its error messages."""

    def __init__(self, run: Run, group: Group):
        self.run, self.group = run, group
        coupling = run.schedule.coupling
        self.torn = np.array(group.torn, dtype=np.int64)
        self.guesses = np.array(group.guesses, dtype=np.int64)
        self.doubling = np.array(group.doubling, dtype=np.int64).reshape(len(group.doubling), 5)
        self.work = np.zeros((steps.WORK_ROWS, len(group.torn)))
        self.numbers = np.zeros(steps.NUMBERS)
        self.record = np.zeros(steps.RECORD_WORDS, dtype=np.int64)
        self.length = float(run.schedule.step * group.every)
        self.order = coupling.order
        self.growth = _MARGIN / 2 ** (self.order + 1)
        self.divisor = float(2**self.order - 1)
        self.error = coupling.step_error or 0.0
        self.tolerance, self.limit = coupling.tolerance, coupling.iterations
        self.method = _ACCELERATION[coupling.acceleration]

    def culprit(self) -> tuple[Part | None, int]:
        """Return the part that has failed (None for the group as a whole) and the status."""
        part, status = int(self.record[steps.PART]), int(self.record[steps.STATUS])
        return (self.group.parts[part] if part >= 0 else None), status

    def explain(self, status: int) -> str:
        """Return the meaning of a status of the whole group, with the remedy."""
        schedule, group = self.run.schedule, self.group
        names = " and ".join(repr(schedule.nodes[i].name) for i in group.nodes)
        gap, where = self.numbers[steps.GAP], int(self.record[steps.WHERE])
        # A smaller step does not help against an algebraic loop.
        remedies = [] if group.is_loop else [f"a smaller step than {show(schedule.step * group.every)} s"]
        if status == steps.NOT_CONVERGED:
            remedies += ["more iterations", "another acceleration", "a UnitDelay between them"]
            return (
                f"the coupling of {names} did not converge in {self.limit} iterations: {group.names[where]} still changes by "
                f"{gap:.3g} (relative to 1 + its size), the tolerance is {self.tolerance:g}. Use {', or '.join(remedies)}."
            )
        if status == steps.DIVERGED:
            remedies += [] if self.method == steps.ANDERSON else ["acceleration='anderson'"]
            remedies += ["a UnitDelay between them"]
            largest = group.names[int(np.nanargmax(np.abs(self.work[steps.VALUE])))]
            return f"the iteration of {names} diverges: {largest} has grown beyond {steps.HUGE:g}. Use {', or '.join(remedies)}."
        if status == steps.NO_STEP:
            places = {begin: i for i in group.nodes for begin in [schedule.slots[i].start["outputs"]]}
            begin = max(b for b in places if b <= group.doubling[where][0])
            name = schedule.output_name(places[begin], group.doubling[where][0] - begin)
            return (
                f"no step of {names} is small enough for step_error={self.error:g}: in one of {self.numbers[steps.STEP]:.3g} s "
                f"the error of {name} is still {gap:.3g} (relative to 1 + its size). An output may jump there; use a larger "
                "step_error."
            )
        error = self._raised()
        if error is not None and not isinstance(error, FMUError):
            raise error  # such as Ctrl-C, which could not pass compiled code
        if isinstance(error, FMUCrashed):
            return str(error)  # the crash matters, not the function that was called
        reason = str(error) if error is not None else f"it returned the status {status - steps.SAVING} of FMI."
        return f"a state of {names} could not be saved or restored: {reason}"

    @abstractmethod
    def _raised(self) -> BaseException | None:
        """Return the exception of the FMUs' Python methods while states were saved or restored."""


def step_function(run: Run, i: int, kind: str, begin: int) -> Callable[[float, int], int]:
    """Return a step function of node `i`, in Python, that writes its outputs from place `begin` on."""
    schedule, memory = run.schedule, run.memory
    slots, block, instance = schedule.slots[i], schedule.nodes[i].block, run.instances.get(i)
    if instance is not None:
        function, here = instance.update if kind == "update" else instance.output, slots.start["inputs"]
        size_in, size_out = (sum(p.size for p in ports) for ports in (block.inputs, block.outputs))
        inputs, outputs = memory[here : here + size_in], memory[begin : begin + size_out]
        return lambda t, k: function(inputs, outputs, t)
    plain = bind(_kernel(run, i, kind), replace(slots, start={**slots.start, "outputs": begin}), memory)

    def step(t: float, k: int) -> int:
        plain(t, k)
        return 0

    return step


def address_of(run: Run, i: int, kind: str) -> int:
    """Return the address of a compiled step function of node `i`."""
    instance = run.instances.get(i)
    if instance is not None:
        return instance.update_address if kind == "update" else instance.output_address
    from bayesftc.cosim.stepping.machine.steps import compile_kernel

    return compile_kernel(_kernel(run, i, kind), run.schedule.slots[i].sections)


def _kernel(run: Run, i: int, kind: str) -> Kernel:
    definition = run.schedule.definitions[i]
    assert definition is not None
    kernel = definition.update if kind == "update" else definition.output
    assert kernel is not None
    return kernel


class InterpretedGroup(GroupRun):
    """A group in plain Python."""

    def __init__(self, run: Run, group: Group):
        super().__init__(run, group)
        self._parts = [(part, step_function(run, part.node, part.kind, part.outputs)) for part in group.parts]
        self._saved: list[list[Any]] = [[], []]
        self._error: FMUError | None = None
        self._compute = steps.build(_sweep, _save, _restore, _forget, _resize)

    def __call__(self, t: float, k: int) -> int:
        """Compute the group; return a status."""
        iteration = self.torn, self.guesses, self.work, self.numbers, self.tolerance, self.limit, self.method
        doubling = steps.Doubling(self.doubling, self.group.size, self.error, self.divisor, self.growth)
        status: int = self._compute(
            self, self.run.memory, steps.Iteration(*iteration), doubling, t, self.length, k, self.record
        )
        return status

    def sweep(self, t: float, h: float, k: int) -> int:
        """Make the calls of a sweep."""
        memory, schedule = self.run.memory, self.run.schedule
        for c, (part, function) in enumerate(self._parts):
            node = schedule.nodes[part.node]
            every = node.every if self.group.every == 1 else 1
            if k % every:
                continue
            for to, origin, other in part.gathers:
                memory[to] = memory[origin] if other < 0 else 0.5 * (memory[other] + memory[origin])
            status = function(t + h if part.kind == "ahead" else t, k // every)
            if status:
                self.record[steps.PART], self.record[steps.STATUS] = c, status
                return 1
            if part.node in schedule.finite and part.kind != "update":
                for i in range(part.outputs, part.outputs + schedule.depended_on(part.node)):
                    if not np.isfinite(memory[i]):
                        self.record[steps.PART], self.record[steps.STATUS] = c, NOT_FINITE + i
                        return 1
        return 0

    def save(self, slot: int) -> int:
        """Save the states of all members."""
        memory = self.run.memory
        self._saved[slot] = [memory[begin:end].copy() for begin, end in self.group.states]
        return self._tried(lambda i, _: self._saved[slot].append(self.run.instances[i].save()), slot)

    def restore(self, slot: int) -> int:
        """Restore the saved states."""
        kept = self._saved[slot]
        for (begin, end), values in zip(self.group.states, kept, strict=False):
            self.run.memory[begin:end] = values
        return self._tried(lambda i, saved: self.run.instances[i].restore(saved), slot)

    def forget(self, slot: int) -> int:
        """Free the saved states."""
        status = self._tried(lambda i, saved: self.run.instances[i].forget(saved), slot)
        self._saved[slot] = []
        return status

    def _tried(self, action: Callable[[int, Any], None], slot: int) -> int:
        """Call `action` with each FMU and its saved state (None if there is none yet); return a status."""
        saved = self._saved[slot][len(self.group.states) :]
        try:
            for j, i in enumerate(self.group.externals):
                action(i, saved[j] if j < len(saved) else None)
        except FMUError as error:
            self._error = error
            return steps.SAVING + ERROR
        return 0

    def _raised(self) -> BaseException | None:
        return self._error

    def resize(self, h: float) -> None:
        """Set the step size of the FMUs to `h` seconds."""
        for i in self.group.externals:
            cast("VariableStep", self.run.instances[i]).resize(h)


def _sweep(machine: InterpretedGroup, memory: Any, t: float, h: float, k: int, record: Any) -> int:
    return machine.sweep(t, h, k)


def _save(machine: InterpretedGroup, memory: Any, slot: int) -> int:
    return machine.save(slot)


def _restore(machine: InterpretedGroup, memory: Any, slot: int) -> int:
    return machine.restore(slot)


def _forget(machine: InterpretedGroup, memory: Any, slot: int) -> int:
    return machine.forget(slot)


def _resize(machine: InterpretedGroup, memory: Any, h: float) -> None:
    machine.resize(h)


class CompiledGroup(GroupRun):
    """The tables of a group's compiled form."""

    def __init__(self, run: Run, group: Group):
        from bayesftc.cosim.run.coupled import kernels

        super().__init__(run, group)
        schedule, memory = run.schedule, run.memory
        rows: list[list[int]] = []
        gathers: list[tuple[int, int, int]] = []
        for part in group.parts:
            node, start = schedule.nodes[part.node], schedule.slots[part.node].start
            outputs = part.outputs, part.outputs + schedule.depended_on(part.node)
            checked = part.node in schedule.finite and part.kind != "update"
            rows.append(
                [
                    address_of(run, part.node, part.kind),
                    node.every if group.every == 1 else 1,
                    *(start[s] for s in ("state", "parameters", "inputs")),
                    part.outputs,
                    len(gathers),
                    len(gathers) + len(part.gathers),
                    *(outputs if checked else (0, 0)),
                    int(part.kind == "ahead"),
                ]
            )
            gathers += part.gathers
        fmus = [
            (group.words + WORDS * j, schedule.slots[i].start["parameters"] + step_word(run.instances[i]))
            for j, i in enumerate(group.externals)
        ]
        self._tables = [
            np.array(rows, dtype=np.int64).reshape(len(rows), kernels.COLUMNS),
            np.array(gathers, dtype=np.int64).reshape(len(gathers), 3),
            np.array(fmus, dtype=np.int64).reshape(len(fmus), 2),
            np.array(group.states, dtype=np.int64).reshape(len(group.states), 2),
            np.zeros((2, sum(end - begin for begin, end in group.states))),
        ]
        parts, copies, places, states, kept = (array.ctypes.data for array in self._tables)
        words = [
            memory.ctypes.data,
            len(memory),
            parts,
            len(rows),
            copies,
            len(gathers),
            places,
            len(fmus),
            states,
            len(group.states),
            kept,
            self._tables[4].shape[1],
            self.torn.ctypes.data,
            len(self.torn),
            self.guesses.ctypes.data,
            self.doubling.ctypes.data,
            len(self.doubling),
            group.size,
            self.work.ctypes.data,
            self.numbers.ctypes.data,
            len(self.numbers),
            self.record.ctypes.data,
            self.limit,
            self.method,
        ]
        numbers = [self.tolerance, self.error, self.divisor, self.growth, self.length]
        self._words = np.array([*words, *np.array(numbers).view(np.int64)], dtype=np.int64)

    @property
    def address(self) -> int:
        """Address of the compiled function."""
        return int(_compiled().address)

    @property
    def parameters(self) -> int:
        """Offset of its table from the beginning of memory, in numbers."""
        return (self._words.ctypes.data - self.run.memory.ctypes.data) // 8

    def _raised(self) -> BaseException | None:
        kept = [self.run.state_functions[i] for i in self.group.externals if i in self.run.state_functions]
        errors = [functions.take() for functions in kept]
        return next((error for error in errors if error is not None), None)


@cache
def _compiled() -> Any:
    import_whole("bayesftc.cosim.stepping.compiler")

    from bayesftc.cosim.run.coupled import kernels
    from bayesftc.cosim.stepping.compiler import compile_raw

    function: Any = kernels.group
    return compile_raw(function)


def step_word(instance: External) -> int:
    """Return the index of the step size in an instance's table; 0 if it has none."""
    return int(getattr(instance, "step_word", 0))


def place_words(run: Run) -> None:
    """Write into memory the addresses of the FMUs' instances and functions for the groups of a run."""
    for group in run.schedule.groups:
        for j, i in enumerate(group.externals if group.restores else ()):
            instance = run.instances[i]
            addresses = getattr(instance, "state_functions", None)
            if addresses is None:
                if i not in run.state_functions:
                    run.state_functions[i] = StateFunctions(instance)
                addresses = run.state_functions[i].addresses
            words = np.array([*addresses, 0, 0], dtype=np.int64)
            begin = group.words + WORDS * j
            run.memory[begin : begin + WORDS] = words.view(np.float64)


def check_groups(run: Run) -> None:
    """Refuse FMUs without the capabilities that their group needs.

    Raises
    ------
    FMUError
        If an FMU cannot restore its state, or cannot vary its step size; the message names it.
    """
    schedule, coupling = run.schedule, run.schedule.coupling
    for group in schedule.groups:
        names = " and ".join(schedule.nodes[i].name for i in group.nodes)
        for i in group.externals if group.restores else ():
            node, instance = schedule.nodes[i], run.instances[i]
            instance.expect_return()
            if not instance.can_save:
                what = "step_error" if group.doubling else f"{coupling.method} coupling"
                raise FMUError(
                    f"The FMU {node.name!r} cannot save and restore its state (canGetAndSetFMUState), which {what} of {names} "
                    f"needs; put a UnitDelay into a connection of {node.name!r} with the others (a visible delay of one step), "
                    "or export the FMU as FMI 2.0 or 3.0 with that capability."
                )
            if group.doubling and not (step_word(instance) and cast("VariableStep", instance).can_resize):
                raise FMUError(
                    f"The FMU {node.name!r} makes steps of one size only (canHandleVariableCommunicationStepSize), but "
                    f"step_error varies those of {names}; leave step_error out, or export the FMU with that capability."
                )
