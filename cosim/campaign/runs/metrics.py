"""Metrics of runs: numbers of each run, computed for many at once.

To write a metric you must:

1. derive from `Metric`, as a frozen dataclass; from `_OfSignal` if it reduces one signal, or a difference, to a number, without
   the times. Its fields are its settings, also in a campaign file;
2. return from ``signals(diagram)`` the names of the signals that it needs, recorded at every step;
3. return from ``columns(diagram)`` the names of its numbers, and refuse in ``check(diagram)`` settings that do not fit; both
   are called for the first point of a campaign, before anything runs;
4. return from ``units(diagram)`` the unit of each number that has one; without this method they have none;
5. return from ``evaluate(runs)`` an array for each of these names, with a number for each run; NaN if it is not defined. It
   gets only complete runs, and may be called in several threads at once;
6. list it in `METRICS` and in ``cosim/__init__.pyi``, and add it with its formula in NumPy to
   ``tests/cosim/campaign/test_campaign.py``. Campaign files can then name it.

Any function from a `Result` to a number is a metric as well, named after the function. It is called run by run.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bayesftc.cosim.diagram.roles import UnitsOfElements, units_of_elements
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.cosim.judging.metrics import figures
from bayesftc.cosim.judging.roles import loop_signals
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram

FEW = 16_000
"""Numbers of a signal that a metric takes at a time: to get new memory for larger results takes longer than to compute them."""


@dataclass(frozen=True)
class Runs:
    """Runs of one diagram, all recorded at every step.

    Attributes
    ----------
    diagram : Diagram
        The diagram.
    time : ndarray of shape (rows,)
        Time of each row in seconds.
    signals : mapping of str to ndarray of shape (runs, rows, ...)
        The signals by name.
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
        if base not in self.signals:
            base, index = _resolved(name, self.diagram)
        at: tuple[Any, ...] = (..., *index)
        values: Floats = self.signals[base][at]
        return values


class Metric(ABC):
    """A number, or several, of each run; the docstring of the module describes how to write one.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> @dataclass(frozen=True)
    ... class Swing(cosim.Metric):
    ...     signal: str
    ...     def signals(self, diagram):
    ...         return (self.signal,)
    ...     def columns(self, diagram):
    ...         return (f"swing({self.signal})",)
    ...     def evaluate(self, runs):
    ...         return {f"swing({self.signal})": np.ptp(runs.columns(self.signal), axis=1)}
    >>> diagram = cosim.Diagram(dt=0.25)
    >>> sine = diagram.add(cosim.Sine(amplitude=2.0, period=1.0, offset=5.0), "sine")
    >>> cosim.Campaign(diagram, duration=1.0, metrics=[Swing("sine.y")]).run().table["swing(sine.y)"].tolist()
    [4.0]
    """

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """Return the names of the signals that it needs."""
        return ()

    @abstractmethod
    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """Return the names of its numbers."""

    def units(self, diagram: Diagram) -> Mapping[str, str | None]:
        """Return the units of its numbers by their names; a number without a unit may be missing."""
        return {}

    def check(self, diagram: Diagram) -> None:  # noqa: B027 - most metrics have nothing to refuse
        """Refuse settings that do not fit the diagram, before anything runs."""

    @abstractmethod
    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """Return an array of shape (runs,) for each of its names."""


@dataclass(frozen=True)
class _OfSignal(Metric):
    """A number from a signal, or from its difference to another signal; NaN if one of the values is NaN.

    Parameters
    ----------
    signal : str
        Name of the signal, or of an element of it (``"controller.x_hat[0]"``). All elements of a vector or matrix have equal
        weight.
    reference : str or float, optional
        A signal or a number to subtract; by default 0.
    shift : int
        Steps by which the signal is later than the reference: 1 for a controller that compares the goal at t_k with the state
        at t_k+1.
    start, stop : float, optional
        Only times start <= t < stop count, in seconds, as for faults; t is the time of the signal, not that of an earlier
        reference. NaN if there is no such t.
    name : str, optional
        Name of the number; by default the kind of the metric and the signal.

    Raises
    ------
    ModelError
        If a setting is wrong.
    """

    signal: str
    reference: str | float | None = None
    shift: int = 0
    start: float | None = None
    stop: float | None = None
    name: str | None = None
    _kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        kind = type(self).__name__
        for name, text in {"signal": self.signal, "name": self.name}.items():
            if not isinstance(text, str) and (text is not None or name == "signal"):
                raise ModelError(f"{kind} has {name}={text!r}; it must be a text, such as 'plant.v'.")
        for name, number in {"reference": self.reference, "start": self.start, "stop": self.stop}.items():
            if number is not None and not (name == "reference" and isinstance(number, str)) and not is_number(number):
                raise ModelError(
                    f"{kind} has {name}={number!r}; it must be a number{', or a signal' * (name == 'reference')}."
                )
        if isinstance(self.shift, bool) or not isinstance(self.shift, int) or self.shift < 0:
            raise ModelError(f"{kind} has shift={self.shift!r}; it must be a whole number of steps, at least 0.")

    def check(self, diagram: Diagram) -> None:
        """See `Metric.check`."""
        shapes = [_shape(name, diagram) for name in (self.signal, self.reference) if isinstance(name, str)]
        if len(shapes) == 2 and shapes[0] != shapes[1]:
            raise ModelError(
                f"{self.signal!r} has the shape {shapes[0]} and {self.reference!r} {shapes[1]}, so that there is no difference; "
                "name an element, such as 'controller.x_hat[0]'."
            )

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        named = [self.signal, *([self.reference] if isinstance(self.reference, str) else [])]
        return tuple(_resolved(name, diagram)[0] for name in named)

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return (self.name or f"{self._kind}({self.signal})",)

    def units(self, diagram: Diagram) -> Mapping[str, str | None]:
        """See `Metric.units`: that of the signal and the reference; none if these have different units."""
        known = units_of_elements(diagram)
        named = [name for name in (self.signal, self.reference) if isinstance(name, str)]
        found = {_unit(name, diagram, known) for name in named} - {None}
        return {self.columns(diagram)[0]: found.pop() if len(found) == 1 else None}

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        values = runs.columns(self.signal)
        rows = max(values.shape[1] - self.shift, 0)
        # The times are those of the signal, not of the reference.
        slack = 1e-6 * (runs.time[1] if len(runs.time) > 1 else 0.0)  # a start of 3 * 0.1 s means the step at 0.3 s
        first, last = np.searchsorted(runs.time, np.array([_or(self.start, -np.inf), _or(self.stop, np.inf)]) - slack)
        keep = slice(max(first - self.shift, 0), max(last + (self.stop is None) - self.shift, 0))
        values = values[:, self.shift :][:, keep]
        other: Any = self.reference
        if isinstance(other, str):
            other = runs.columns(other)[:, :rows][:, keep]
        name, numbers = self.columns(runs.diagram)[0], np.full(len(values), np.nan)
        few = max(1, FEW // max(values[0].size, 1)) if len(values) else 1
        for piece in (slice(first, first + few) for first in range(0, len(values) if values.size else 0, few)):
            some = values[piece]
            if other is not None:
                some = some - (other[piece] if isinstance(other, np.ndarray) else other)
            numbers[piece] = self._reduced(some.reshape(len(some), -1))
        return {name: numbers}

    def _reduced(self, values: Floats) -> Floats:
        raise NotImplementedError


class RMSE(_OfSignal):
    """Root mean square of a signal, or of its difference to another signal.

    Parameters
    ----------
    signal : str
        Name of the signal, or of an element of it (``"controller.x_hat[0]"``). All elements of a vector or matrix have equal
        weight.
    reference : str or float, optional
        A signal or a number to subtract; by default 0.
    shift : int
        Steps by which the signal is later than the reference: 1 for a controller that compares the goal at t_k with the state
        at t_k+1.
    start, stop : float, optional
        Only times start <= t < stop count, in seconds, as for faults; t is the time of the signal, not that of an earlier
        reference. NaN if there is no such t.
    name : str, optional
        Name of the number; by default the kind of the metric and the signal.

    Raises
    ------
    ModelError
        If a setting is wrong.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> sine = diagram.add(cosim.Sine(amplitude=2.0, period=1.0), "sine")
    >>> campaign = cosim.Campaign(diagram, duration=9.9, metrics=[cosim.RMSE("sine.y")])
    >>> campaign.run().table["rmse(sine.y)"].round(3).tolist()
    [1.414]
    """

    _kind = "rmse"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean(values * values, axis=1)))


class MeanAbsoluteError(_OfSignal):
    """Mean of the absolute value of a signal, or of its difference to another signal.

    Parameters
    ----------
    signal, reference, shift, start, stop, name
        See `RMSE`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.5)
    >>> ramp = diagram.add(cosim.Ramp(slope=1.0), "ramp")
    >>> campaign = cosim.Campaign(diagram, duration=2.0, metrics=[cosim.MeanAbsoluteError("ramp.y", reference=1.0)])
    >>> campaign.run().table["mean_absolute(ramp.y)"].tolist()
    [0.6]
    """

    _kind = "mean_absolute"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.abs(values).mean(axis=1))


class MaxAbsoluteError(_OfSignal):
    """Largest absolute value of a signal, or of its difference to another signal.

    Parameters
    ----------
    signal, reference, shift, start, stop, name
        See `RMSE`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> pulse, lag = diagram.add(cosim.Pulse(1.0, period=2.0), "pulse"), diagram.add(cosim.ExponentialFilter(0.5), "lag")
    >>> diagram.connect(pulse["y"], lag["u"])
    >>> error = cosim.MaxAbsoluteError("lag.y", reference="pulse.y", start=1.1, stop=2.0, name="error")
    >>> cosim.Campaign(diagram, duration=4.0, metrics=[error]).run().table["error"].round(3).tolist()
    [0.67]
    """

    _kind = "max_absolute"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(np.abs(values).max(axis=1))


class Mean(_OfSignal):
    """Mean of a signal, or of its difference to another signal; for a flag, the share of time in which it is set.

    Parameters
    ----------
    signal, reference, shift, start, stop, name
        See `RMSE`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> fault = diagram.add(cosim.Freeze(start=2.0, duration=1.0, channels=1), "fault")
    >>> diagram.connect(diagram.add(cosim.Sine(1.0, 3.0))["y"], fault["u"])
    >>> campaign = cosim.Campaign(diagram, duration=4.9, metrics=[cosim.Mean("fault.active", name="share")])
    >>> campaign.run().table["share"].tolist()
    [0.2]
    """

    _kind = "mean"

    def _reduced(self, values: Floats) -> Floats:
        return np.asarray(values.mean(axis=1))


class Final(_OfSignal):
    """Last value of a signal, or of its difference to another signal; for a vector, name an element.

    Parameters
    ----------
    signal, reference, shift, start, stop, name
        See `RMSE`, also for errors.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> one, integral = diagram.add(cosim.Constant(1.0), "one"), diagram.add(cosim.Integrator(), "integral")
    >>> diagram.connect(one["y"], integral["u"])
    >>> campaign = cosim.Campaign(diagram, duration=5.0, metrics=[cosim.Final("integral.y", reference=4.5)])
    >>> campaign.run().table["final(integral.y)"].round(9).tolist()
    [0.5]
    """

    _kind = "final"

    def check(self, diagram: Diagram) -> None:
        """See `Metric.check`."""
        super().check(diagram)
        if _shape(self.signal, diagram):
            raise ModelError(
                f"Final needs one number, but {self.signal!r} has several; name an element, such as '{self.signal}[0]'."
            )

    def _reduced(self, values: Floats) -> Floats:
        return values[:, -1]


@dataclass(frozen=True)
class LoopFigures(Metric):
    """The figures of a closed loop, as ``bayesftc run`` prints them: errors of tracking and belief, and fault detection.

    They are all numbers of `bayesftc.cosim.judging.metrics.figures`, with names such as ``tracking.v.overall`` and
    ``sensors.0.delay``. The page "Columns of results" of the documentation defines each.

    Parameters
    ----------
    only : sequence of str, optional
        Patterns of the names to keep, such as ``("tracking.*", "*.delay")``.

    Notes
    -----
    The columns of a campaign are the figures of its first point. A figure that the loop of another point lacks is NaN there.

    Examples
    --------
    >>> import control
    >>> from bayesftc import controllers, cosim
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)
    >>> loop = cosim.closed_loop(
    ...     cosim.StateSpace(control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)), controllers.LQGController(model), control="u",
    ...     measured="y", sensors=cosim.Sensors(2, 0.2), reference=1.0,
    ... )
    >>> figures = cosim.LoopFigures(only=["tracking.*.overall"])
    >>> cosim.Campaign(loop, duration=5.0, seeds=3, metrics=[figures]).run().table["tracking.y.overall"].round(1).tolist()
    [0.3, 0.3, 0.3]
    """

    only: Sequence[str] | None = None

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        trial = _Trial(diagram)
        loop_signals(diagram, trial, drawn=False)
        return tuple(dict.fromkeys(trial.names))

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return tuple(self.units(diagram))

    def units(self, diagram: Diagram) -> Mapping[str, str | None]:
        """See `Metric.units`."""
        return {name: unit for name, _, unit in self._figures(diagram, _Trial(diagram))}

    def check(self, diagram: Diagram) -> None:
        """See `Metric.check`."""
        if not self.columns(diagram):
            names = LoopFigures().columns(diagram)
            raise ModelError(
                f"LoopFigures has only={self.only!r}, which matches no figure; the figures are {', '.join(names)}."
            )

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        rows = [{name: n for name, n, _ in self._figures(runs.diagram, result)} for result in runs.results()]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _figures(self, diagram: Diagram, result: Result) -> Iterator[Figure]:
        signals = loop_signals(diagram, result, drawn=False)
        for figure in _flat(figures(signals), {quantity.name: quantity.unit for quantity in signals.quantities}):
            if self.only is None or any(fnmatchcase(figure[0], pattern) for pattern in self.only):
                yield figure


class _Trial(Result):
    """A result of one row of zeros, which records the names of the signals that are read."""

    def __init__(self, diagram: Diagram):
        selection = select_signals(diagram.schedule, None)
        super().__init__(np.zeros((1, len(selection.places))), selection.columns, diagram.step)
        self.names: list[str] = []

    def __getitem__(self, name: str) -> Floats:
        self.names.append(name)
        return super().__getitem__(name)


Figure = tuple[str, float, str | None]
"""Name, number and unit."""


def _flat(
    value: Any, units: Mapping[str, str | None], name: str = "", own: str | None = None, unit: str | None = None
) -> Iterator[Figure]:
    """Yield the numbers in nested dataclasses, mappings and tuples, by their paths, with the units in their fields.

    `units` are those of the quantities, the keys of the mappings, and `own` that of the quantity of the value.
    """
    if isinstance(value, float):
        yield name, value, unit
        return
    of_tuple = isinstance(value, tuple)
    declared, own = getattr(value, "__dataclass_fields__", {}), getattr(value, "unit", own)
    inner = enumerate(value) if of_tuple else (value if isinstance(value, Mapping) else vars(value)).items()
    for key, item in inner:
        if item is None or isinstance(item, str | int):
            continue
        part = getattr(item, "name", key) if of_tuple else key
        text = declared[key].metadata.get("unit", "") if key in declared else ""
        unit = None if "{" in text and not own else text.format(unit=own) or None
        of_item = units.get(str(key)) if isinstance(value, Mapping) else own
        yield from _flat(item, units, f"{name}.{part}" if name else str(part), of_item, unit)


@dataclass(frozen=True)
class OfResult(Metric):
    """A function from a `Result` to a number as a metric, named after the function.

    Parameters
    ----------
    function : callable
        Called with the result of each run.
    needs : sequence of str, optional
        Names or patterns of the signals that it needs; by default all outputs.
    name : str, optional
        Name of the number; by default that of the function.
    unit : str, optional
        Unit of the number, for headings and axes.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> step, lag = diagram.add(cosim.Step(0.5, 1.0), "step"), diagram.add(cosim.ExponentialFilter(0.5), "lag")
    >>> diagram.connect(step["y"], lag["u"])
    >>> def rise_time(result):
    ...     return result.time[result["lag.y"] >= 0.9][0] - 0.5
    >>> metric = cosim.OfResult(rise_time, needs=["lag.y"], unit="s")
    >>> result = cosim.Campaign(diagram, duration=4.0, metrics=[metric]).run()
    >>> result.table["rise_time"].round(9).tolist(), result.units
    ([1.1], {'rise_time': 's'})
    """

    function: Callable[[Result], float]
    needs: Sequence[str] | None = None
    name: str | None = None
    unit: str | None = None

    def signals(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.signals`."""
        return ("*",) if self.needs is None else tuple(self.needs)

    def columns(self, diagram: Diagram) -> tuple[str, ...]:
        """See `Metric.columns`."""
        return (self.name or str(getattr(self.function, "__name__", type(self.function).__name__)),)

    def units(self, diagram: Diagram) -> Mapping[str, str | None]:
        """See `Metric.units`."""
        return {self.columns(diagram)[0]: self.unit}

    def evaluate(self, runs: Runs) -> Mapping[str, Floats]:
        """See `Metric.evaluate`."""
        return {self.columns(runs.diagram)[0]: np.array([float(self.function(r)) for r in runs.results()])}


def _element(name: str) -> tuple[str, tuple[int, ...]]:
    """Return the name of a signal and the index of a named element: ``"x_hat", (0,)`` for ``"x_hat[0]"``."""
    base, bracket, index = name.partition("[")
    if not bracket:
        return name, ()
    if not re.fullmatch(r"\d+(, ?\d+)*\]", index):
        raise ModelError(
            f"{name!r} is not a signal or an element of one; write an element as in 'controller.x_hat[0]'."
        )
    return base, tuple(int(i) for i in index[:-1].split(","))


def _resolved(name: str, diagram: Diagram) -> tuple[str, tuple[int, ...]]:
    """Return signal and index as `_element` does; for a signal with brackets in its name, or another name, without an index."""
    with suppress(UnknownNameError):
        columns = list(select_signals(diagram.schedule, [name]).columns)
        labelled = re.fullmatch(r"[^*?\[]+\[\d+\]", name) and columns != [name.partition("[")[0]]
        if columns == [name] or labelled:
            return columns[0], ()  # such as `plant.u0` for python-control's label `plant.u[0]`
    return _element(name)


def _shape(name: str, diagram: Diagram) -> tuple[int, ...]:
    """Return the shape of a signal, or of a named element of it.

    Raises
    ------
    ModelError
        If there is no such element.
    UnknownNameError
        If there is no such signal.
    """
    base, index = _resolved(name, diagram)
    columns = select_signals(diagram.schedule, [base]).columns
    if base not in columns:
        raise ModelError(
            f"{base!r} is a pattern, but a metric needs one signal; use {next(iter(columns))!r}, for example."
        )
    shape = columns[base][1]
    if index and (len(index) != len(shape) or any(i >= n for i, n in zip(index, shape, strict=True))):
        raise ModelError(
            f"{base!r} has the shape {shape}, and no element {name.removeprefix(base)}; name another element."
        )
    return () if index else shape


def _unit(name: str, diagram: Diagram, known: UnitsOfElements) -> str | None:
    """Return the unit of a signal or of a named element of it; None if it is not known, or its elements have several."""
    base, index = _resolved(name, diagram)
    (shape,) = (shape for _, shape in select_signals(diagram.schedule, [base]).columns.values())
    block, _, port = base.rpartition(".")
    elements = np.arange(prod(shape)).reshape(shape)[index].ravel()
    units = {known.get((block, port, int(i))) for i in elements}
    return units.pop() if len(units) == 1 else None


def is_number(value: object) -> bool:
    """Return whether a setting is a number other than NaN."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and not np.isnan(value)


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


METRICS = (RMSE, MeanAbsoluteError, MaxAbsoluteError, Mean, Final, LoopFigures)
"""All metrics for campaign files."""


def as_metrics(given: object) -> tuple[Metric, ...]:
    """Return a tuple of metrics, with functions wrapped.

    Raises
    ------
    ModelError
        If an item is neither a metric nor a function.
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
                f"{item!r} is no metric; give a metric such as cosim.RMSE('plant.v', 'reference.y'), or a function from a result "
                "to a number."
            )
        metrics.append(item if isinstance(item, Metric) else OfResult(item))
    return tuple(metrics)


__all__ = [
    *(cls.__name__ for cls in METRICS),
    "METRICS",
    "Metric",
    "OfResult",
    "Runs",
    "as_metrics",
    "is_number",
]
