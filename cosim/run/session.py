"""A live run: it goes on piece by piece, is saved and put back, and starts anew, while FMUs stay loaded.

Pieces add up to the bits of one `simulate`: time is an integer step, every random number is a function of seed and step, and
all else that a run remembers stands in its memory and in its FMUs.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, closing, nullcontext
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from math import prod
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.timebase import EXACT, whole_number, whole_steps
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.diagram.diagram import is_external
from bayesftc.cosim.diagram.nodes import PortRef, label
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.isolation.spares import Spares
from bayesftc.cosim.ports import labels
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.run.engines import CompiledEngine, Engine, Run
from bayesftc.cosim.run.pacing import Pacer
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.run.result import Result
from bayesftc.cosim.run.running import advance, choose_engine, failed, make_room, open_run, place_tables
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.diagram.schedule import Schedule
    from bayesftc.cosim.run.running import Progress


@dataclass(frozen=True, eq=False)
class RunState:
    """All that a live run remembers at one step; made by `Session.save_state`.

    It pickles if the state of every FMU does, and can then be restored in another process.

    Attributes
    ----------
    k : int
        The last complete step; -1 before the first.
    seed : int
        Seed of the run.
    memory : ndarray
        States, parameters, inputs and outputs of all blocks, without what is only recorded.
    instances : mapping of str to object
        The saved state of each FMU.
    layout : tuple
        What the diagram is like, so that a state goes back only where it fits.
    parameters : mapping of str to mapping
        What each FMU was given as parameters, which its saved state holds as well.
    """

    k: int
    seed: int
    memory: Floats = field(repr=False)
    instances: Mapping[str, Any] = field(repr=False)
    layout: tuple[Any, ...] = field(repr=False)
    parameters: Mapping[str, Mapping[str, Any]] = field(repr=False)


class Session:
    """A live run of a diagram; `Diagram.start` makes it, ``with`` or `close` ends it.

    Parameters
    ----------
    diagram : Diagram
        What to run; it is built and frozen if it is not yet.
    seed : int
        Seed of all random streams.
    record : iterable of str, optional
        Names or patterns of the signals that results hold; by default all outputs.
    decimation : int
        Keep every `decimation`-th step, counted from step 0.
    engine : {"auto", "compiled", "interpreted"}
        Both give the same bits.

    Examples
    --------
    >>> from bayesftc import cosim, fmus
    >>> diagram = cosim.Diagram(dt=0.02)
    >>> car = diagram.add(cosim.FMU(fmus.path("CruiseControl")), "car")
    >>> with diagram.start() as session:
    ...     session.set("car.force", 500.0)
    ...     first = session.advance(1.0)
    ...     here = session.save_state()
    ...     second = session.advance(1.0)
    ...     session.restore(here)
    ...     again = session.advance(1.0)
    >>> float(second["car.v"][-1]) == float(again["car.v"][-1])
    True
    """

    def __init__(
        self,
        diagram: Diagram,
        *,
        seed: int = 0,
        record: Iterable[str | PortRef] | None = None,
        decimation: int = 1,
        engine: Literal["auto", "compiled", "interpreted"] = "auto",
    ):
        if isinstance(record, Iterable) and not isinstance(record, str):
            record = list(record)
            diagram = diagram.watching(record)
        self._schedule: Schedule = diagram.schedule
        self._parts = copy(diagram)  # without its live run: a result that is kept keeps no FMU open
        self._decimation = whole_number(decimation, "decimation is ")
        self._selection = select_signals(self._schedule, record)
        self._free = _settable(self._schedule)
        self._fed = {
            f"{node.name}.{port.name}": source[0].name
            for node in diagram.nodes
            for port in node.block.inputs
            if (source := diagram.source_of(node, port, 0))
        }
        self._wanted = engine
        self._engine: Engine
        self._run: Run | None = None
        self._is_running = False
        self._pacer: Pacer | None = None
        self._asked: tuple[Any, int] = (None, 0)
        self._stack = ExitStack()
        self._finalizer = weakref.finalize(
            self, self._stack.close
        )  # FMUs of a session that is dropped are freed as well
        self._open(check_seed(seed))

    def advance(
        self,
        duration: float | str | Fraction,
        *,
        pace: float | None = None,
        progress: Progress | None = None,
        time_limit: float | None = None,
    ) -> Result:
        """Go on for `duration` seconds; return the signals of this piece.

        Rows follow those of the piece before; only the first piece has the row at t = 0. ``advance(0)`` at the beginning
        yields that row alone.

        Parameters
        ----------
        duration : float, str or Fraction
            Seconds; a whole number of base steps.
        pace : float, optional
            Simulated seconds for each second of the clock, 1.0 for real time. The clock runs on between calls with the same
            pace, so that what is computed outside counts, too; a call without it, `restore` and `reset` stop the clock.
            ``result.metadata["pace"]`` has the pace, the number of late steps (``overruns``) and the seconds by which the worst
            was late (``worst_overrun``), since the clock has started.
        progress : callable, optional
            Called as ``progress(step, steps)`` now and then, of this piece.
        time_limit : float, optional
            Seconds of computing after which the run is stopped; it can go on from there.

        Raises
        ------
        SimulationError
            If the run has to stop; its ``result`` has the signals of this piece up to the last complete step. After the failure
            of a block the session goes on only after `restore` or `reset`.

        Warns
        -----
        UserWarning
            If an FMU has asked to end the simulation: the result then ends there, and its ``stopped`` says why.
        """
        run = self._sound_run()
        step = self._schedule.step
        if not (isinstance(duration, float) and duration == self._asked[0]):  # many calls for a step each are usual
            self._asked = duration, whole_steps(duration, step, "The duration")
        steps = self._asked[1]
        end = max(run.k, 0) + steps
        if end * step.numerator > EXACT:
            whole_steps(end * step, step, "The run's length")  # says so
        if time_limit is not None and not (isinstance(time_limit, Real) and time_limit >= 0):
            raise ModelError(f"time_limit is {time_limit!r}; it must be a number of seconds, or None.")
        if progress is not None and not callable(progress):
            raise ModelError(
                f"progress is {progress!r}; it must be a function that is called with step and steps, or None."
            )
        if pace is None or self._pacer is None or self._pacer.pace != pace:
            self._pacer = None if pace is None else Pacer(pace, self._schedule.step, max(run.k, 0))
        make_room(run, end)
        try:
            self._is_running = True
            stopped = advance(self._engine, end, run, progress, time_limit, self._pacer)
        finally:
            self._is_running = False
        metadata: dict[str, Any] = {
            "seed": run.seed,
            "duration": float(steps * self._schedule.step),
            "step": str(self._schedule.step),
            "engine": self.engine,
            "blocks": {node.name: type(node.block).__name__ for node in self._schedule.nodes},
        }
        if self._pacer:
            metadata["pace"] = self._pacer.report()
        result = Result(
            run.recording[: max(run.k // run.decimation + 1 - run.before, 0)],
            self._selection.columns,
            self._schedule.step,
            decimation=run.decimation,
            before=run.before,
            parts=self._parts,
            units=self._selection.units,
            metadata=metadata,
            stopped=stopped,
        )
        if run.ended:
            warn_user(str(stopped))
        elif stopped:
            raise failed(stopped, result, run)
        return result

    def set(self, name: str | PortRef, value: ArrayLike) -> None:
        """Give an input that nothing feeds a value, which it keeps until it is set again; `reset` brings its start value back.

        A plant takes it in its next step, a block that feeds it through shows it at the next t_k.

        Parameters
        ----------
        name : str or port
            Name of the input, ``"plant.force"``, or of one of its elements, ``"plant.u[1]"``; or the port, ``plant["force"]``.
        value : float or array
            One number for each element, or one for all. An FMU takes no NaN and no infinity.

        Raises
        ------
        UnknownNameError
            If there is no such input, or it has a source.
        ModelError
            If the value does not fit.
        """
        run = self._sound_run()
        asked = label(name) if isinstance(name, PortRef) else name
        if asked not in self._free:
            raise UnknownNameError(self._not_free(asked))
        lies, shape, is_plant = self._free[asked]
        try:
            if np.asarray(value).dtype.kind in "USV":  # of which NumPy would read the digits
                raise TypeError
            values = np.broadcast_to(np.asarray(value, dtype=np.float64), shape or (1,)).ravel()
        except (ValueError, TypeError, OverflowError):
            size = lies.stop - lies.start
            raise ModelError(
                f"{asked} cannot be set to {brief(value)}; give {'one number' if size == 1 else f'{size} numbers'}."
            ) from None
        if is_plant and not np.isfinite(values).all():
            raise ModelError(
                f"{asked} cannot be set to {value!r}: an FMU must be given finite numbers; see what computed it."
            )
        run.memory[lies] = values

    @property
    def k(self) -> int:
        """The last complete step; -1 before the first."""
        return self._sound_run().k

    @property
    def time(self) -> float:
        """The time of the last complete step in seconds."""
        return max(self.k, 0) * self._schedule.step.numerator / self._schedule.step.denominator

    @property
    def engine(self) -> str:
        """The engine that is used: ``"compiled"`` or ``"interpreted"``."""
        return "compiled" if isinstance(self._engine, CompiledEngine) else "interpreted"

    def save_state(self) -> RunState:
        """Return all that the run remembers now; `restore` goes back to it as often as one likes.

        Raises
        ------
        FMUError
            If an FMU cannot save its state; the sentence names it.
        """
        run = self._sound_run()
        saved = {self._schedule.nodes[i].name: instance.save() for i, instance in run.instances.items()}
        given = {
            node.name: dict(node.block.parameters or {}) for node in self._schedule.nodes if isinstance(node.block, FMU)
        }
        return RunState(run.k, run.seed, run.memory[self._schedule.remembered], saved, self._schedule.layout(), given)

    def restore(self, state: RunState) -> None:
        """Go back to a saved state: of this session, or of another one of the same diagram, whatever that recorded.

        What is only recorded of an FMU that runs at a multiple of the step is NaN until its next step: it is no part of a state.

        Raises
        ------
        ModelError
            If it is no state of such a diagram, or of one in which a block has other parameters: the saved state of an FMU
            has its parameters in it, so that the new ones would be without effect.
        FMUError
            If an FMU cannot take it: one without ``canSerializeFMUState`` takes states of this session only, and none from before
            a `reset`.
        """
        if not isinstance(state, RunState) or state.layout != self._schedule.layout():
            raise ModelError(
                f"{state!r} is no saved state of this diagram; restore what save_state() has returned for the same blocks."
            )
        memory = self._schedule.initial.copy()
        memory[self._schedule.remembered] = state.memory
        _check_parameters(self._schedule, memory, state.parameters)
        run = self._opened()
        run.sound = False  # until all of it is restored
        for i, instance in run.instances.items():
            instance.restore(state.instances[self._schedule.nodes[i].name])
        run.memory[:] = memory
        place_tables(run)
        self._pacer = None
        if state.seed != run.seed:
            run.seed = state.seed
            self._engine = choose_engine(self._wanted, run)  # an engine holds numbers that it has drawn ahead
        run.k, run.sound = state.k, True

    def reset(self, seed: int | None = None) -> None:
        """Go back to the beginning, with new instances of the FMUs, whose binaries stay loaded.

        Parameters
        ----------
        seed : int, optional
            A new seed; by default that of the run before.
        """
        before = self._opened().seed
        seed = before if seed is None else check_seed(seed)
        with closing(Spares()) as spares, spares.lent() if self._opened().sound else nullcontext():
            self._stack.close()
            self._open(seed)

    def close(self) -> None:
        """End the run and free its FMUs; the session cannot be used any more."""
        if self._run is not None:
            self._opened()
        self._run = None
        self._stack.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._run is None

    def __repr__(self) -> str:
        if self._run is None:
            return "<Session: closed>"
        return f"<Session at t = {max(self._run.k, 0) * float(self._schedule.step):g} s: {self.engine}>"

    def __reduce__(self) -> NoReturn:
        raise ModelError("A live session cannot be pickled; pickle the diagram, and what save_state() returns.")

    def _not_free(self, name: object) -> str:
        source = self._fed.get(name if isinstance(name, str) else "")
        if source:
            return f"{name} is fed by {source} and cannot be set; leave that connection out, or set what feeds it."
        return f"There is no input {name!r} that nothing feeds; {did_you_mean(name, self._free)}"

    def _open(self, seed: int) -> None:
        self._run, self._pacer = None, None
        try:
            run = open_run(self._schedule, self._stack, seed, self._selection, 0, self._decimation)
            self._engine = choose_engine(self._wanted, run)
        except BaseException:
            self._stack.close()
            raise
        self._run = run

    def _opened(self) -> Run:
        if self._run is None:
            raise ModelError("The session is closed; start a new one with diagram.start().")
        if self._is_running:
            raise ModelError(
                "The session is running, in another thread or around this call; wait until advance() has returned."
            )
        return self._run

    def _sound_run(self) -> Run:
        run = self._opened()
        if not run.sound:
            raise ModelError(
                f"The session stopped in the middle of a step after step {run.k}; go back with restore(state) or reset() first."
            )
        return run


def _settable(schedule: Schedule) -> dict[str, tuple[slice, tuple[int, ...], bool]]:
    """Return the inputs that nothing feeds, and their elements, by name: where in memory, the shape, whether an FMU's."""
    found: dict[str, tuple[slice, tuple[int, ...], bool]] = {}
    for node, port in schedule.free:
        lies, name, is_plant = schedule.signal(node, port), f"{node.name}.{port.name}", is_external(node)
        found[name] = lies, port.shape, is_plant
        if port.shape:
            for i, element in enumerate(labels(name, port.shape), lies.start):
                found[element] = slice(i, i + 1), (), is_plant
    return found


def _check_parameters(schedule: Schedule, memory: Floats, parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse the memory, and the parameters of the FMUs, of a diagram of the same blocks with other parameters."""
    for node, slots, definition in zip(schedule.nodes, schedule.slots, schedule.definitions, strict=True):
        for name, (section, _, shape) in slots.sections.items() if definition else ():
            if section == "parameters":
                place = slice(slots.offset(name), slots.offset(name) + prod(shape))
                there, here = memory[place], schedule.initial[place]
                # What is computed for a sample time may differ in its last bits on another machine.
                last = 1e-13 * float(np.max(np.abs(here[np.isfinite(here)]), initial=0.0))
                if not np.allclose(there, here, rtol=1e-9, atol=last, equal_nan=True):
                    raise _other_parameters(node.name, name)
        if isinstance(node.block, FMU):
            before, now = parameters.get(node.name, {}), dict(node.block.parameters or {})
            own = {variable.name: variable.start for variable in node.block.description.variables}
            for name in sorted(before.keys() | now.keys()):
                values = before.get(name, own.get(name)), now.get(name, own.get(name))
                if values[0] != values[1]:
                    raise _other_parameters(node.name, name, f", {values[0]!r} and not {values[1]!r}")


def _other_parameters(block: str, name: str, values: str = "") -> ModelError:
    return ModelError(
        f"The saved state is of a diagram in which block {block!r} has another parameter {name!r}{values}, and parameters are "
        "part of a state; restore it where they are the same, and make what is to change an input (an FMU's with tunable=...)."
    )
