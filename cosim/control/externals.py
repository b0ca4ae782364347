"""The states of FMUs as numbers: quantities if they are accessible, else the number of a saved state or of steps made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.block import External
from bayesftc.cosim.errors import FMUError, ModelError
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.running.states import SavedState
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.schedule import Schedule

SNAPSHOTS = 100
"""Number of saved states that are kept besides the first one, because an FMU may need megabytes for each."""

_HEADER = 64 + 4 * 4 + 8
"""Bytes before the numbers in a serialised state of an FMU of this package: token, four ints, stop time."""

Key = tuple[int, int, bytes]


class ExternalState(ABC):
    """The state of one FMU in a diagram, as numbers for python-control.

    Attributes
    ----------
    title : str
        Name of the FMU in errors.
    names : list of str
        Names of the numbers.
    real : bool
        Whether the numbers are quantities, which may be changed; else the FMU's state is hidden.
    initial : ndarray
        The initial numbers.
    """

    real = False
    names: list[str]
    initial: Floats

    def __init__(self, instance: External, schedule: Schedule, i: int):
        node, slots = schedule.nodes[i], schedule.slots[i]
        self._instance, self._every, self._step = instance, node.every, schedule.step
        self._timing = getattr(node.block, "timing", "plant")
        begin = slots.start["inputs"]
        self._inputs = slice(begin, begin + sum(port.size for port in node.block.inputs))
        self.title = node.name

    def over(self, part: Floats) -> bool:
        """Return whether this state needs a new instance of the FMU."""
        return False

    @abstractmethod
    def load(self, k: int, part: Floats) -> None:
        """Set the state of the FMU, at step `k` of the diagram."""

    def evaluated(self, k: int) -> None:
        """Take into account that the outputs at step `k` were read, which gives an FMU that is no plant its inputs."""
        if self._timing != "plant" and k % self._every == 0:
            self.lose()

    @abstractmethod
    def leave(self, k: int, memory: Floats) -> Floats:
        """Return the state after step `k`."""

    @abstractmethod
    def lose(self) -> None:
        """Take into account that the state of the FMU is unknown."""


class Snapshots(ExternalState):
    """The state of an FMU that can save it: the number of the saved state."""

    def __init__(self, instance: External, schedule: Schedule, i: int):
        super().__init__(instance, schedule, i)
        self.names, self.initial = [f"{self.title}.snapshot"], np.zeros(1)
        self._saved: dict[int, object] = {0: instance.save()}
        self._steps: dict[int, int] = {0: 0}
        self._origins: dict[int, Key] = {}  # from where each state was reached, and the inverse
        self._reached: dict[Key, int] = {}
        self._next, self._loaded = 1, 0
        self._present: int | None = 0

    def load(self, k: int, part: Floats) -> None:
        """See `ExternalState.load`."""
        number = int(part[0]) if np.isfinite(part[0]) else -1
        if number != part[0] or not 0 <= number < self._next:
            raise ModelError(_no_number(self.title, part[0]))
        if number not in self._saved:
            raise ModelError(
                f"The FMU {self.title!r} cannot return to its saved state number {number}, because only the first and the latest "
                f"{SNAPSHOTS} are kept; start again from the beginning, or from a later state."
            )
        steps = -(-k // self._every)
        if self._steps[number] != steps:
            h = self._step * self._every
            raise ModelError(
                f"The FMU {self.title!r} cannot be evaluated at t = {float(k * self._step):g} s in its saved state number "
                f"{number}, which is of t = {float(self._steps[number] * h):g} s; begin at the time of the saved state."
            )
        if self._present != number:
            self._present = None
            self._instance.restore(self._saved[number])
        self._present = self._loaded = number

    def leave(self, k: int, memory: Floats) -> Floats:
        """See `ExternalState.leave`."""
        if k % self._every:
            return np.array([float(self._loaded)])
        key = self._loaded, k, memory[self._inputs].tobytes()
        number = self._reached.get(key)
        if number is None:
            number, self._next = self._next, self._next + 1
            self._saved[number], self._steps[number] = self._instance.save(), k // self._every + 1
            self._origins[number], self._reached[key] = key, number
            if len(self._origins) > SNAPSHOTS:
                self._forget(next(iter(self._origins)))
        self._present = number
        return np.array([float(number)])

    def lose(self) -> None:
        """See `ExternalState.lose`."""
        self._present = None

    def _forget(self, number: int) -> None:
        self._instance.forget(self._saved.pop(number))
        del self._steps[number], self._reached[self._origins.pop(number)]


class InOrder(ExternalState):
    """The state of an FMU that cannot save it: the number of steps made. It can only be stepped in order, or restarted."""

    def __init__(self, instance: External, schedule: Schedule, i: int):
        super().__init__(instance, schedule, i)
        if self._timing == "sampled":
            raise FMUError(
                f"The FMU {self.title!r} has timing='sampled' and cannot save its state (canGetAndSetFMUstate), so that "
                "python-control cannot compute its outputs without changing it; export it with that capability."
            )
        self.names, self.initial = [f"{self.title}.step"], np.zeros(1)
        self._made: int | None = 0

    def over(self, part: Floats) -> bool:
        """See `ExternalState.over`."""
        return part[0] == 0.0 and self._made != 0

    def load(self, k: int, part: Floats) -> None:
        """See `ExternalState.load`."""
        if part[0] != np.floor(part[0]):
            raise ModelError(_no_number(self.title, part[0]))
        if part[0] != self._made:
            present = "after a step that failed" if self._made is None else f"after {self._made} steps"
            raise ModelError(
                f"The FMU {self.title!r} cannot be set to its state after {part[0]:g} steps, because it is in that {present} and "
                "cannot save its state (canGetAndSetFMUstate); step it in order, from t = 0 on."
            )
        if part[0] != -(-k // self._every):
            raise ModelError(
                f"The FMU {self.title!r} is in its state after {part[0]:g} steps of {show(self._step * self._every)} s, and "
                f"cannot be evaluated at t = {float(k * self._step):g} s; begin at t = 0."
            )

    def evaluated(self, k: int) -> None:
        """See `ExternalState.evaluated`: the state does not change."""

    def leave(self, k: int, memory: Floats) -> Floats:
        """See `ExternalState.leave`."""
        assert self._made is not None
        if k % self._every == 0:
            self._made += 1
        return np.array([float(self._made)])

    def lose(self) -> None:
        """See `ExternalState.lose`."""
        self._made = None


class OwnNumbers(ExternalState):
    """The state of an FMU of this package: the numbers of its instance, except for inputs, parameters and time.

    ``fmus/c/instance.h`` serialises the token, the phase of the instance, and all numbers: those of the variables, the time, and
    those that are hidden from importers.
    """

    real = True

    def __init__(self, instance: External, schedule: Schedule, i: int, saved: SavedState):
        super().__init__(instance, schedule, i)
        description = schedule.nodes[i].block.description  # type: ignore[attr-defined]
        self._saved, self._content = saved, np.frombuffer(saved.serialised(), dtype=np.uint8).copy()
        numbers = self._content[_HEADER:].view(np.float64)
        variables = [v for v in description.variables if v.causality != "independent"]
        kept = [v for v in variables if v.causality in {"output", "local"}]
        hidden = range(len(variables) + 1, len(numbers))
        self.names = [f"{self.title}.{v.name}" for v in kept] + [
            f"{self.title}.hidden[{j}]" for j, _ in enumerate(hidden)
        ]
        self._numbers, self._time = numbers, len(variables)
        self._places = np.array([*(v.reference for v in kept), *hidden], dtype=np.int64)
        self.initial = numbers[self._places]
        self._part = self.initial
        self._present: tuple[int, bytes] | None = (0, self.initial.tobytes())

    def load(self, k: int, part: Floats) -> None:
        """See `ExternalState.load`."""
        made = -(-k // self._every)
        if self._present == (made, part.tobytes()):
            return
        self._present = None
        self._numbers[self._places] = part
        h = self._step * self._every
        # The same sum as in the FMU, which adds the step size to the beginning of the step.
        self._numbers[self._time] = float((made - 1) * h) + float(h) if made else 0.0
        self._instance.restore(self._saved.changed_to(self._content.tobytes()))
        self._present, self._part = (made, part.tobytes()), part.copy()

    def leave(self, k: int, memory: Floats) -> Floats:
        """See `ExternalState.leave`."""
        if k % self._every == 0:
            saved: Any = self._instance.save()
            self._part = np.frombuffer(saved.serialised(), offset=_HEADER)[self._places]
            self._instance.forget(saved)
            self._present = k // self._every + 1, self._part.tobytes()
        return self._part

    def lose(self) -> None:
        """See `ExternalState.lose`."""
        self._present = None


def external_state(instance: External, schedule: Schedule, i: int) -> ExternalState:
    """Return the state, as numbers, of a running FMU, the node number `i` of a diagram."""
    if not instance.can_save:
        return InOrder(instance, schedule, i)
    block = schedule.nodes[i].block
    if isinstance(block, FMU) and block.description.timing is not None:
        saved = instance.save()
        if isinstance(saved, SavedState) and _has_layout(saved, block):
            return OwnNumbers(instance, schedule, i, saved)
        instance.forget(saved)
    return Snapshots(instance, schedule, i)


def _has_layout(saved: SavedState, block: FMU) -> bool:
    """Return whether the saved state of an FMU with this package's annotation really has this package's layout."""
    try:
        content = saved.serialised()
    except FMUError:
        return False
    variables = [v for v in block.description.variables if v.causality != "independent"]
    size = len(content) - _HEADER
    if size % 8 or size < 8 * (len(variables) + 1) or not content.startswith(block.description.token.encode()):
        return False
    numbers = np.frombuffer(content, offset=_HEADER)
    parameters = [v for v in variables if v.causality == "parameter"]
    return all(numbers[v.reference] == block.start_value(v.name) for v in parameters)


def _no_number(title: str, given: float) -> str:
    return (
        f"The state of the FMU {title!r} is hidden: in python-control it is the number of a saved state, and {given:g} is not. "
        "So the FMU cannot be linearized, no operating point can be found, and it begins at its start values (parameters=...); "
        "make a linear model of it with LinearModel.from_fmu."
    )
