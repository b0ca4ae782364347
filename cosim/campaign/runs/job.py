"""Make the runs of a piece, in this thread, in another process or on another machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import Any

import numpy as np

from bayesftc.cosim.base.timebase import whole_steps
from bayesftc.cosim.blocks.faults.base import Fault
from bayesftc.cosim.campaign.designs.factors import unit_of_factor, varied
from bayesftc.cosim.campaign.designs.plan import FAILED, OK, Outcome, Piece, Plan
from bayesftc.cosim.campaign.runs.columns import OWN, column_of
from bayesftc.cosim.campaign.runs.metrics import Metric, Runs, is_number
from bayesftc.cosim.campaign.runs.truth import FAULTY, MISSING, SensorTruth
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.schedule import Schedule
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief
from bayesftc.cosim.run.many import Block, KeepGoing, ManyRuns, Overhead
from bayesftc.cosim.run.raised import reason_of
from bayesftc.cosim.run.recording import Selection, select_signals
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.run.running import too_large
from bayesftc.cosim.types import Floats

Loop = Diagram | Callable[..., Diagram]
Shapes = Mapping[str, tuple[int, ...]]

EVERYWHERE = (
    "Recorded signals must be the same at every point: give their blocks the same name everywhere (name=...), or record "
    "other signals."
)


@dataclass(frozen=True)
class Recorded:
    """A signal that is kept: its shape and unit."""

    shape: tuple[int, ...]
    unit: str | None


class Job:
    """The work of a campaign; it can be pickled if the loop and the metrics can.

    Parameters
    ----------
    loop : Diagram or callable
        A diagram, which is varied by paths, or a function of the factors of a point.
    plan : Plan
        Points and seeds.
    duration : Fraction
        Duration of each run in seconds.
    record : sequence of str
        Names or patterns of the signals to keep.
    metrics : sequence of Metric
        The metrics of each run.
    decimation : int
        Every `decimation`-th step of the signals is kept. Metrics use all steps.
    time_limit : float, optional
        Largest computing time of a run in seconds.

    Raises
    ------
    BayesFTCError
        If the loop of the first point cannot be built, or lacks a signal.
    """

    def __init__(
        self,
        loop: Loop,
        plan: Plan,
        duration: float | str | Fraction,
        record: Sequence[str],
        metrics: Sequence[Metric],
        *,
        decimation: int = 1,
        time_limit: float | None = None,
    ):
        self.loop, self.plan, self.duration = loop, plan, duration
        self.record, self.metrics = tuple(record), tuple(metrics)
        self.decimation, self.time_limit = decimation, time_limit
        if time_limit is not None and not (is_number(time_limit) and 0 < time_limit < np.inf):
            raise ModelError(f"time_limit is {time_limit!r}; it must be a number of seconds, above 0.")
        first = self.diagram(0)
        self.starts = fault_starts(first)
        kept = select_signals(first.schedule, self.record)
        self.signals = {name: Recorded(shape, kept.units.get(name)) for name, (_, shape) in kept.columns.items()}
        truth = SensorTruth.of(first, self.signals)
        self.truths = {} if truth is None else {name: Recorded(truth.shape, None) for name in (FAULTY, MISSING)}
        self.signals |= self.truths
        # This raises if a signal of a metric is unknown.
        select_signals(first.schedule, [name for metric in self.metrics for name in metric.signals(first)])
        for metric in self.metrics:
            metric.check(first)
        self.columns = tuple(name for metric in self.metrics for name in metric.columns(first))
        if len(set(self.columns)) < len(self.columns):
            twice = next(name for name in self.columns if self.columns.count(name) > 1)
            raise ModelError(
                f"Two metrics are called {twice!r}; give one of them another name=... (for a function, OfResult(f, name=...))."
            )
        for name in self.columns:
            if name in OWN or not name:
                raise ModelError(f"A metric is called {name!r}, which is not allowed; give it another name=...")
        self.units = {name: unit for metric in self.metrics for name, unit in metric.units(first).items() if unit}
        for name, unit in self.units.items():
            if not isinstance(unit, str):
                raise ModelError(f"The metric {name!r} has the unit {brief(unit)}; it must be a text, such as 'm/s'.")
        self.units_of_factors = {path: unit_of_factor(first, path) for path in self.plan.points[0]}
        self.step, self.steps = first.step, whole_steps(duration, first.step, "The duration")
        self._prepare()

    @property
    def time(self) -> Floats:
        """Time in seconds of each row of the kept signals.

        Raises
        ------
        ModelError
            If there are more rows than fit into memory.
        """
        try:
            return _times(self.steps, self.decimation, self.step)
        except (MemoryError, ValueError):
            columns = sum(int(np.prod(kept.shape)) for kept in self.signals.values())
            raise too_large(self.steps // self.decimation + 1, columns) from None

    def diagram(self, point: int) -> Diagram:
        """Return the loop at one point of the design.

        Raises
        ------
        BayesFTCError
            If the loop cannot be built with these factors.
        """
        factors = self.plan.points[point]
        diagram = varied(self.loop, factors) if isinstance(self.loop, Diagram) else self.loop(**factors)
        if not isinstance(diagram, Diagram):
            raise ModelError(
                f"The loop of a campaign must be a Diagram, or a function that returns one, not {diagram!r}."
            )
        return diagram.watching(self.record).build()

    def units_of_columns(self, labels: Sequence[Mapping[str, Any]]) -> dict[str, str]:
        """Return the unit of each column that has one: of a factor, if it stands there by its plain numbers, and of a metric.

        Parameters
        ----------
        labels : sequence of mapping of str to object
            The label of each factor in tables, for each point.
        """
        pairs = list(zip(self.plan.points, labels, strict=True))
        reserved = {*OWN, *self.columns, *self.signals}
        factors = {
            column_of(name, reserved): unit
            for name, unit in self.units_of_factors.items()
            if unit and all(is_number(point.get(name)) and point[name] == label.get(name) for point, label in pairs)
        }
        return factors | self.units

    def run(self, piece: Piece, keep_going: KeepGoing = lambda: True, overhead: Overhead = lambda: None) -> Outcome:
        """Make the runs of a piece.

        Parameters
        ----------
        piece : Piece
            The runs.
        keep_going : callable
            Called about twenty times a second; returns whether to continue.
        overhead : callable
            Called before work that counts for no time limit.

        Raises
        ------
        StoppedFromOutside
            If `keep_going` returns False.
        """
        began = time.perf_counter()
        collected = _Collected(self, piece)
        for point, seeds in self.plan.groups(piece):
            overhead()
            try:
                loop = self._prepared(point)
            except MemoryError:
                raise
            except Exception as error:  # noqa: BLE001 - a user's function or block may raise anything
                collected.fail(len(seeds), reason_of(error, "The loop of this point could not be built"))
                continue
            for block in loop.many.run(seeds, keep_going, overhead, len(self.plan.seeds[point])):
                overhead()
                collected.add(loop, block)
        return collected.outcome(time.perf_counter() - began)

    def failed(self, piece: Piece, what: str) -> Outcome:
        """Return the outcome of runs whose process has died: failed, with the reason.

        Parameters
        ----------
        piece : Piece
            The runs.
        what : str
            How the process ended, such as "was killed by ...".
        """
        collected = _Collected(self, piece)
        for point, seeds in self.plan.groups(piece):
            factors = "".join(f", {name} = {brief(value)}" for name, value in self.plan.points[point].items())
            for seed in seeds:
                reason = f"The process of this run (seed {seed}{factors}) {what}."
                collected.fail(1, reason)
        return collected.outcome(0.0)

    def close(self) -> None:
        """Free the loops of all threads."""
        with self._lock:
            loops = list(self._loops)
            self._loops.clear()
        for loop in loops:
            loop.many.close()
        self._local = threading.local()

    def _prepare(self) -> None:
        self._local = threading.local()
        self._lock: threading.Lock = threading.Lock()
        self._loops: list[_Loop] = []

    def _prepared(self, point: int) -> _Loop:
        """Return the loop of a point, ready to run in this thread, which keeps one loop at a time."""
        kept: _Loop | None = getattr(self._local, "loop", None)
        if kept is not None and kept.point == point:
            return kept
        if kept is not None:
            self._local.loop = None
            with self._lock, suppress(ValueError):
                self._loops.remove(kept)
            kept.many.close()
        if isinstance(self.loop, Diagram):
            with self._lock:  # threads share what takes longest, the diagram; each has its own FMUs
                built = next((other.diagram for other in self._loops if other.point == point), None)
                loop = _Loop(self, point, built or self.diagram(point))
                self._loops.append(loop)
        else:  # a function may make blocks with a state of their own, one for each thread
            loop = _Loop(self, point, self.diagram(point))
            with self._lock:
                self._loops.append(loop)
        self._local.loop = loop
        return loop

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in {"_local", "_lock", "_loops"}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()


class _Loop:
    """The loop of one point, with the recorded signals: those to keep, and those of metrics, which need every step."""

    def __init__(self, job: Job, point: int, diagram: Diagram):
        self.point, self.diagram = point, diagram
        schedule = self.diagram.schedule
        kept = _selected(job, schedule)
        self.truth = SensorTruth.of(self.diagram, kept.columns) if job.truths else None
        truths = {name: s.shape if self.truth is None else self.truth.shape for name, s in job.truths.items()}
        shapes = {name: shape for name, (_, shape) in kept.columns.items()} | truths
        if unlike := _unlike(shapes, {name: s.shape for name, s in job.signals.items()}):
            raise ModelError(f"{unlike} {EVERYWHERE}")
        needed = [name for metric in job.metrics for name in metric.signals(self.diagram)]
        self.decimation = 1 if job.metrics else job.decimation
        if self.truth is not None:
            needed += self.truth.needs
        self.selection: Selection = select_signals(schedule, [*kept.columns, *needed])
        self.time = _times(job.steps, self.decimation, self.diagram.step)
        self.many = ManyRuns(schedule, self.selection, job.steps, self.decimation, job.time_limit)

    def views(self, recording: Floats) -> dict[str, Floats]:
        """Return each recorded signal of some runs, of shape (runs, rows, ...), without copying."""
        runs, rows = recording.shape[:2]
        return {
            name: recording[:, :, start : start + int(np.prod(shape))].reshape(runs, rows, *shape)
            if shape
            else recording[:, :, start]
            for name, (start, shape) in self.selection.columns.items()
        }

    def truths(self, block: Block, decimation: int) -> dict[str, Floats]:
        """Return the true faults of the sensors in some runs, every `decimation`-th step; NaN after the failure of a run."""
        if self.truth is None:
            return {}
        recording = block.recording[:, :: decimation // self.decimation]
        runs, rows, numbers = recording.shape
        of_all = Result(recording.reshape(runs * rows, numbers), self.selection.columns, self.diagram.step)
        after = np.arange(rows) * decimation > block.steps[:, None]
        return {
            name: np.where(after[:, :, None], np.nan, values)
            for name, values in self.truth.signals(of_all, runs).items()
        }

    def results(self, recording: Floats) -> Iterator[Result]:
        """Yield each run as a result."""
        for rows in recording:
            yield Result(
                rows, self.selection.columns, self.diagram.step, decimation=self.decimation, units=self.selection.units
            )


def _selected(job: Job, schedule: Schedule) -> Selection:
    """Return the signals to keep at a point."""
    try:
        return select_signals(schedule, job.record)
    except UnknownNameError as error:
        raise UnknownNameError(f"{error} {EVERYWHERE}") from None


def _unlike(here: Shapes, first: Shapes) -> str:
    """Return a sentence if a point does not have the kept signals of the first point; else nothing."""
    for name in [*first, *here]:
        if name not in here:
            return f"This point has no signal {name!r}, but the first point has it."
        if name not in first:
            return f"This point has the signal {name!r}, which the first point does not have."
        if here[name] != first[name]:
            return f"The signal {name!r} has the shape {here[name]}, but {first[name]} at the first point."
    return ""


class _Collected:
    """Collects the outcomes of a piece."""

    def __init__(self, job: Job, piece: Piece):
        self._job, self._piece, self._done = job, piece, 0
        n, rows = len(piece), len(job.time)
        self._signals = {name: np.empty((n, rows, *s.shape)) for name, s in job.signals.items()}
        self._metrics = {name: np.full(n, np.nan) for name in job.columns}
        self._steps = np.full(n, -1, dtype=np.int64)
        self._reasons: list[str] = []

    def add(self, loop: _Loop, block: Block) -> None:
        job, begin, end = self._job, self._done, self._done + len(block.steps)
        thinned = slice(None, None, job.decimation // loop.decimation)
        kept = {name: values[:, thinned] for name, values in loop.views(block.recording).items()}
        kept |= loop.truths(block, job.decimation)
        for name, array in self._signals.items():
            array[begin:end] = kept.get(name, np.nan)  # a point that is no closed loop has no true faults
        good = np.array([not reason for reason in block.reasons])
        self._steps[begin:end] = block.steps
        self._reasons += block.reasons
        self._done = end
        if job.metrics and good.any():
            whole = block.recording if good.all() else block.recording[good]
            with np.errstate(all="ignore"):
                self._measure(loop, whole, begin + np.flatnonzero(good))

    def _measure(self, loop: _Loop, recording: Floats, places: np.ndarray[Any, np.dtype[np.int64]]) -> None:
        """Compute the metrics of runs; if one raises, run by run, so that only runs with an error count as failed."""
        runs = Runs(loop.diagram, loop.time, loop.views(recording), lambda: loop.results(recording), len(recording))
        for metric in self._job.metrics:
            try:
                for name, values in metric.evaluate(runs).items():
                    if name in self._metrics:
                        self._metrics[name][places] = values
            except MemoryError:
                raise
            except Exception as error:  # noqa: BLE001 - a user's metric may raise anything
                if len(places) > 1:
                    for i in range(len(places)):
                        self._measure(loop, recording[i : i + 1], places[i : i + 1])
                    return
                self._reasons[places[0]] = reason_of(
                    error, f"The metric {_called(metric, loop.diagram)} could not be computed"
                )
                for numbers in self._metrics.values():
                    numbers[places] = np.nan
                return

    def fail(self, runs: int, reason: str) -> None:
        """Record runs that could not begin."""
        for array in self._signals.values():
            array[self._done : self._done + runs] = np.nan
        self._reasons += [reason] * runs
        self._done += runs

    def outcome(self, seconds: float) -> Outcome:
        status = tuple(FAILED if reason else OK for reason in self._reasons)
        return Outcome(self._piece, self._metrics, self._signals, status, tuple(self._reasons), self._steps, seconds)


def fault_starts(diagram: Diagram) -> dict[str, float]:
    """Return the earliest start of each fault in seconds: 0 for a condition, which may be fulfilled at once."""
    starts = {node.name: node.block.times[0] for node in diagram.nodes if isinstance(node.block, Fault)}
    return {name: float(start) if isinstance(start, Real) else 0.0 for name, start in starts.items()}


def _called(metric: Metric, diagram: Diagram) -> str:
    return ", ".join(map(repr, metric.columns(diagram)[:1])) or type(metric).__name__


def _times(steps: int, decimation: int, step: Fraction) -> Floats:
    k = np.arange(steps // decimation + 1, dtype=np.int64) * (decimation * step.numerator)
    times: Floats = k / step.denominator
    return times


__all__ = ["Job", "Loop", "Recorded", "fault_starts"]
