"""Metrics of runs: numbers of each run, computed for many at once.

To write a metric you must:

1. derive from `Metric`, as a frozen dataclass; its fields are its settings, and what a campaign file may say;
2. return from ``signals(diagram)`` the names of the signals that it needs, recorded at every step;
3. return from ``columns(diagram)`` the names of its numbers, the same for each point of a campaign;
4. return from ``evaluate(runs)`` an array for each of these names, with a number for each run; NaN where it is not defined. It
   sees runs that went to their end only, and may be called in several threads at once;
5. name it in `METRICS`.

Any other function from a `Result` to a number is a metric as well, by the name of the function; it is called run by run.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.metrics import figures
from bayesftc.cosim.recording import select_signals
from bayesftc.cosim.result import Result
from bayesftc.cosim.roles import loop_signals

if TYPE_CHECKING:
    from bayesftc.cosim.diagram import Diagram


@dataclass(frozen=True)
class Runs:
    """Runs of one diagram, all recorded at every step.

    Attributes
    ----------
    diagram : Diagram
        What has run.
    time : ndarray of shape (rows,)
        In seconds.
    signals : mapping of str to ndarray of shape (runs, rows, ...)
        By name.
    """

    diagram: Diagram
    time: Floats
    signals: Mapping[str, Floats]
    results: Callable[[], Iterable[Result]] = field(repr=False)
    count: int

    def __len__(self) -> int:
        return self.count

    def columns(self, name: str) -> Floats:
        """Return a signal by name, or one of its elements (``"controller.x_hat[0]"``)."""
        if name in self.signals:
            return self.signals[name]
        base, index = _element(name)
        at: tuple[Any, ...] = (..., *index)
        values: Floats = self.signals[base][at]
        return values


class Metric(ABC):
    """A number, or several, of each run; see the module's text for how to write one."""

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """Return the names of the signals that it needs."""
        return ()

    @abstractmethod
    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """Return the names of its numbers."""

    @abstractmethod
    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """Return an array of shape (runs,) for each of its names."""


@dataclass(frozen=True)
class _OfSignal(Metric):
    """What is computed from a signal, or from its difference to another one.

    Parameters
    ----------
    signal : str
        Its name, or that of one of its elements (``"controller.x_hat[0]"``).
    reference : str or float, optional
        What it is compared with; by default 0.
    shift : int
        Steps by which the signal is later than the reference: 1 for a controller that aims at the goal of t_k with the state of
        t_k+1.
    start, stop : float, optional
        Only from and up to these times, in seconds.
    name : str, optional
        Of the number; by default the kind of the metric and the signal.
    """

    signal: str
    reference: str | float | None = None
    shift: int = 0
    start: float | None = None
    stop: float | None = None
    name: str | None = None
    _kind: ClassVar[str] = ""

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        named = [self.signal, *([self.reference] if isinstance(self.reference, str) else [])]
        return tuple(_element(name)[0] for name in named)

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return (self.name or f"{self._kind}({self.signal})",)

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        values = runs.columns(self.signal)
        rows = values.shape[1] - self.shift
        # The times are those of the signal, not of the reference.
        first, last = np.searchsorted(runs.time, [_or(self.start, -np.inf), _or(self.stop, np.inf)])
        keep = slice(max(first - self.shift, 0), max(last + (self.stop is None) - self.shift, 0))
        values = values[:, self.shift :]
        if self.reference is not None:
            other = runs.columns(self.reference)[:, :rows] if isinstance(self.reference, str) else self.reference
            values = values - other
        values = values[:, keep].reshape(len(values), -1)
        if not values.shape[1]:
            return {self.columns(runs.diagram)[0]: np.full(len(values), np.nan)}
        return {self.columns(runs.diagram)[0]: self._reduced(values)}

    def _reduced(self, values: Floats) -> Floats:
        raise NotImplementedError


class RMSE(_OfSignal):
    """Root mean square of a signal, or of its difference to another one."""

    _kind = "rmse"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean(values * values, axis=1)))


class MeanAbsoluteError(_OfSignal):
    """Mean of the absolute value of a signal, or of its difference to another one."""

    _kind = "mean_absolute"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.abs(values).mean(axis=1))


class MaxAbsoluteError(_OfSignal):
    """Largest absolute value of a signal, or of its difference to another one."""

    _kind = "max_absolute"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.abs(values).max(axis=1))


class Mean(_OfSignal):
    """Mean of a signal, or of its difference to another one; of a flag the share of time in which it is set."""

    _kind = "mean"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(values.mean(axis=1))


class Final(_OfSignal):
    """Last value of a signal, or of its difference to another one."""

    _kind = "final"

    def _reduced(self, values: Floats) -> Floats:
        return values[:, -1]


@dataclass(frozen=True)
class LoopFigures(Metric):
    """The figures of a closed loop, as ``bayesftc run`` prints them: errors of tracking and belief, and how faults were detected.

    Of `bayesftc.cosim.metrics.figures` all numbers, by names such as ``tracking.v.overall`` and ``sensors.0.delay``.

    Parameters
    ----------
    only : sequence of str, optional
        Patterns of the names that are kept, as ``("tracking.*", "*.delay")``.
    """

    only: Sequence[str] | None = None

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        asked = _Asked(diagram)
        loop_signals(diagram, asked)
        return tuple(dict.fromkeys(asked.names))

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return tuple(self._numbers(diagram, _Asked(diagram)))

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        rows = [self._numbers(runs.diagram, result) for result in runs.results()]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _numbers(self, diagram: Diagram, result: Result) -> dict[str, float]:
        numbers = dict(_flat(asdict(figures(loop_signals(diagram, result)))))
        if self.only is None:
            return numbers
        return {name: n for name, n in numbers.items() if any(fnmatchcase(name, pattern) for pattern in self.only)}


class _Asked(Result):
    """The result of a run of one row, of any numbers, which notes the signals that it is asked for."""

    def __init__(self, diagram: Diagram):
        selection = select_signals(diagram.schedule, None)
        super().__init__(np.zeros((1, len(selection.places))), selection.columns, diagram.step)
        self.names: list[str] = []

    def __getitem__(self, name: str) -> Floats:
        self.names.append(name)
        return super().__getitem__(name)


def _flat(value: object, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers in nested mappings and lists, by their paths."""
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else ()
    for key, item in inner:
        named = isinstance(item, Mapping) and isinstance(value, list | tuple) and isinstance(item.get("name"), str)
        yield from _flat(item, f"{name}.{item['name'] if named else key}" if name else str(key))
    if isinstance(value, float):
        yield name, value


@dataclass(frozen=True)
class OfResult(Metric):
    """A function from a `Result` to a number, as a metric by the name of the function.

    Parameters
    ----------
    function : callable
        Called with the result of each run.
    needs : sequence of str, optional
        Names or patterns of the signals that it needs; by default all outputs.
    name : str, optional
        Of the number.
    """

    function: Callable[[Result], float]
    needs: Sequence[str] | None = None
    name: str | None = None

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        return ("*",) if self.needs is None else tuple(self.needs)

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return (self.name or str(getattr(self.function, "__name__", type(self.function).__name__)),)

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        return {self.columns(runs.diagram)[0]: np.array([float(self.function(r)) for r in runs.results()])}


def _element(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the name of a signal and the place of the element that is named: ``"x_hat[0]"`` is ``"x_hat"``, (0,)."""
    base, bracket, index = name.partition("[")
    if not bracket:
        return name, ()
    try:
        return base, tuple(int(i) for i in index.rstrip("]").split(","))
    except ValueError:
        raise ModelError(
            f"{name!r} is no signal and no element of one; write it as in 'controller.x_hat[0]'."
        ) from None


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


METRICS = (RMSE, MeanAbsoluteError, MaxAbsoluteError, Mean, Final, LoopFigures)
"""All metrics that a campaign file may name."""


def as_metrics(given: object) -> tuple[Metric, ...]:
    """Return metrics as such, functions wrapped.

    Raises
    ------
    ModelError
        If something else is among them.
    """
    items = [given] if isinstance(given, Metric) or callable(given) else given
    if not isinstance(items, Iterable) or isinstance(items, str | Mapping):
        raise ModelError(
            f"metrics is {given!r}; it must be a list of metrics, such as [cosim.RMSE('plant.v', 'reference.y')]."
        )
    metrics = []
    for item in items:
        if not isinstance(item, Metric) and not callable(item):
            raise ModelError(
                f"{item!r} is no metric; give cosim.RMSE('plant.v', 'reference.y') or the like, or a function from a result to a "
                "number."
            )
        metrics.append(item if isinstance(item, Metric) else OfResult(item))
    return tuple(metrics)


__all__ = [
    *(cls.__name__ for cls in METRICS), "METRICS", "Metric", "OfResult", "Runs", "as_metrics",
]  # fmt: skip
