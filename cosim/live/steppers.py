"""What a live run steps: a session or a single block, with one vector of inputs and one of outputs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import isnan, nan
from typing import ClassVar

import numpy as np

from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.errors import UnknownNameError, did_you_mean
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.run.online import Online
from bayesftc.cosim.run.session import Session
from bayesftc.cosim.types import Floats

SAMPLES = "y"
"""The input of controllers and estimators that bears missing samples."""


class Stepper(ABC):
    """A session, or a block, that makes one step for a vector of inputs.

    Attributes
    ----------
    step : Fraction
        Seconds.
    inputs, outputs : mapping of str to Port
        By name. They are known after `prepare`.

    Examples
    --------
    >>> from fractions import Fraction
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import live
    >>> class Twice(live.Stepper):
    ...     step, inputs, outputs, k = Fraction(1, 100), {"u": cosim.Port("u")}, {"y": cosim.Port("y")}, -1
    ...     def _prepare(self): ...
    ...     def bears_missing(self, name):
    ...         return True
    ...     def advance(self, inputs):
    ...         self.k += 1
    ...         return 2.0 * inputs
    >>> Twice().advance(np.array([1.5])).tolist()
    [3.0]
    """

    step: Fraction
    inputs: Mapping[str, Port]
    outputs: Mapping[str, Port]

    def prepare(self) -> None:
        """Compile, once; a session makes its first step, at t = 0."""
        if not self._is_prepared:
            self._prepare()
            self._is_prepared = True

    _is_prepared = False

    @abstractmethod
    def _prepare(self) -> None: ...

    @abstractmethod
    def advance(self, inputs: Floats) -> Floats:
        """Make a step with all elements of all inputs, and return those of all outputs."""

    @property
    @abstractmethod
    def k(self) -> int:
        """The number of the last step; -1 before the first."""

    @property
    def time(self) -> float:
        """The time of the last step in seconds."""
        return max(self.k, 0) * self.step.numerator / self.step.denominator

    @abstractmethod
    def bears_missing(self, name: str) -> bool:
        """Return whether an input may be NaN."""

    @property
    def input_names(self) -> list[str]:
        """The name of each element of the inputs."""
        return [element for name, port in self.inputs.items() for element in labels(name, port.shape)]

    @property
    def output_names(self) -> list[str]:
        """The name of each element of the outputs."""
        return [element for name, port in self.outputs.items() for element in labels(name, port.shape)]

    def start(self) -> Floats:
        """Return the start values of the inputs' elements; NaN where there is none."""
        values = [np.broadcast_to(np.nan if p.default is None else p.default, p.shape) for p in self.inputs.values()]
        return np.concatenate([np.empty(0), *(np.ravel(value) for value in values)])

    def input_places(self, name: str) -> list[int]:
        """Return the numbers of the elements of an input, or of one element of it.

        Raises
        ------
        UnknownNameError
            If there is no such input.
        """
        return _places(name, self.inputs, self.outputs, "input", "an output. Use from = ...")

    def output_places(self, name: str) -> list[int]:
        """Return the numbers of the elements of an output, or of one element of it.

        Raises
        ------
        UnknownNameError
            If there is no such output.
        """
        return _places(name, self.outputs, self.inputs, "output", "an input. Use to = ...")


class SessionStepper(Stepper):
    """The step of a session: its unconnected inputs are set, and all its recorded signals are outputs.

    Parameters
    ----------
    session : Session
        The session.
    names : mapping of str to str
        Other names of its unconnected inputs: ``{"controller.y": "received.u"}``.
    """

    def __init__(self, session: Session, names: Mapping[str, str] | None = None):
        self._session, self.step = session, session.step
        other = {inner: name for name, inner in (names or {}).items()}
        ports = session.inputs
        self.inputs = {other.get(name, name): port for name, port in ports.items()}
        self._inner = dict(zip(self.inputs, ports, strict=True))
        self._duration = float(self.step)

    def _prepare(self) -> None:
        result = self._session.advance(0 if self._session.k < 0 else self._duration)
        self.outputs = {name: Port(name, result[name].shape[1:], result.units.get(name)) for name in result}
        first, self._ranges = 0, []
        for name, port in self.inputs.items():
            self._ranges.append((self._inner[name], slice(first, first + port.size), port.shape))
            first += port.size
        self._last = self.start()

    def advance(self, inputs: Floats) -> Floats:
        """Set the inputs that have changed, and make a step."""
        for name, places, shape in self._ranges:
            values = inputs[places]
            if not np.array_equal(values, self._last[places], equal_nan=True):
                self._session.set(name, values.reshape(shape))
        self._last = inputs.copy()
        result = self._session.advance(self._duration)
        return np.concatenate([np.empty(0), *(result[name][-1].ravel() for name in self.outputs)])

    @property
    def k(self) -> int:
        """The number of the last step."""
        return self._session.k

    def bears_missing(self, name: str) -> bool:
        """Return whether the start value of an input is missing, as that of `Received`."""
        default = self.inputs[name].default
        return isinstance(default, float) and isnan(default)


class OnlineStepper(Stepper):
    """The step of a single block.

    Parameters
    ----------
    online : Online
        The block, from `Block.online`.
    """

    def __init__(self, online: Online):
        self._online, self.step = online, online.step
        self.inputs, self.outputs = online.inputs, online.outputs
        self._k = -1

    def _prepare(self) -> None:
        self._online(**{name: np.zeros(port.shape) for name, port in self.inputs.items()})
        self._online.reset()
        self._k = -1

    def advance(self, inputs: Floats) -> Floats:
        """Make a step."""
        self._k += 1
        return self._online.advance(inputs)

    @property
    def k(self) -> int:
        """The number of the last step."""
        return self._k

    def bears_missing(self, name: str) -> bool:
        """Return whether the input has the name of samples, ``y``."""
        return name == SAMPLES


def _places(name: str, ports: Mapping[str, Port], others: Mapping[str, Port], what: str, remedy: str) -> list[int]:
    first = 0
    for full, port in ports.items():
        numbers = list(range(first, first + port.size))
        if name == full:
            return numbers
        elements = labels(full, port.shape)
        if name in elements:
            return [numbers[elements.index(name)]]
        first += port.size
    near = {element: None for full, port in ports.items() for element in (full, *labels(full, port.shape))}
    if name in {element for full, port in others.items() for element in (full, *labels(full, port.shape))}:
        raise UnknownNameError(f"{name!r} is not an {what}, but {remedy}")
    raise UnknownNameError(f"There is no {what} {name!r}; {did_you_mean(name, near)}")


def _copy(u, y):
    for i in range(y.shape[0]):
        y[i] = u[i]


@dataclass(frozen=True)
class Received(Block):
    """The last samples from outside: ``y = u``, where the input ``u`` is set at each step.

    Parameters
    ----------
    size : int
        Number of samples.
    unit : str, optional
        Unit of the samples.
    start : float
        Value before the first sample; by default missing (NaN).

    Examples
    --------
    >>> from bayesftc import cosim
    >>> from bayesftc.cosim import live
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> received = diagram.add(live.Received(2), "received")
    >>> with diagram.start(engine="interpreted") as session:
    ...     session.set("received.u[0]", 20.0)
    ...     session.advance(0)["received.y"].tolist()
    [[20.0, nan]]
    """

    size: int
    unit: str | None = None
    start: float = nan
    sample_time: ClassVar[None] = None

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Input ``u``."""
        return (Port("u", (self.size,), self.unit, default=self.start),)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``y``."""
        return (Port("y", (self.size,), self.unit),)

    def define(self, dt: object) -> Definition:
        """Return the copy of the input."""
        return Definition(_copy)
