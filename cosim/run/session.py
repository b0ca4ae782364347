"""A live run: it continues piece by piece, is saved, restored and reset, while FMUs stay loaded.

The pieces together have the bits of one `simulate`: time is an integer step, every random number is a function of seed and
step, and the rest of a run's state is in its memory and in its FMUs.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, closing, nullcontext
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from math import isfinite, prod
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.timebase import EXACT, whole_number, whole_steps
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.diagram.diagram import is_external
from bayesftc.cosim.diagram.nodes import PortRef, label
from bayesftc.cosim.diagram.roles import check_units_of_goals
from bayesftc.cosim.errors import ModelError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.isolation.spares import Spares
from bayesftc.cosim.ports import Port, labels
from bayesftc.cosim.random import check_seed
from bayesftc.cosim.run.engines import CompiledEngine, Engine, Run
from bayesftc.cosim.run.pacing import Pacer
from bayesftc.cosim.run.recording import select_signals
from bayesftc.cosim.run.result import Result, with_rows
from bayesftc.cosim.run.running import advance, choose_engine, failed, make_room, open_run, place_tables
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.diagram.diagram import Diagram
    from bayesftc.cosim.diagram.schedule import Schedule
    from bayesftc.cosim.run.running import Progress


@dataclass(frozen=True, eq=False)
class RunState:
    """The complete state of a live run at one step; made by `Session.save_state`.

    It can be pickled if the state of every FMU can, and then be restored in another process.

    Attributes
    ----------
    k : int
        The last complete step; -1 before the first.
    seed : int
        Seed of the run.
    memory : ndarray
        States, parameters, inputs and outputs of all blocks, without outputs that are only recorded.
    instances : mapping of str to object
        The saved state of each FMU.
    layout : tuple
        Properties of the diagram. A state is restored only in a diagram with the same.
    parameters : mapping of str to mapping
        The parameters of each FMU, which are also part of its saved state.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> diagram = cosim.Diagram(dt=0.1)
    >>> noise = diagram.add(cosim.Gaussian(std=1.0), "noise")
    >>> with diagram.start(seed=1, engine="interpreted") as session:
    ...     first = session.advance(1.0)
    ...     state = session.save_state()
    ...     second = session.advance(1.0)
    ...     session.restore(state)
    ...     again = session.advance(1.0)
    >>> state.k, second["noise.y"].tolist() == again["noise.y"].tolist()
    (10, True)
    """

    k: int
    seed: int
    memory: Floats = field(repr=False)
    instances: Mapping[str, Any] = field(repr=False)
    layout: tuple[Any, ...] = field(repr=False)
    parameters: Mapping[str, Mapping[str, Any]] = field(repr=False)


NO_CALL: tuple[Any, int, dict[str, Any]] = (None, 0, {})
"""What a session keeps of its last `Session.advance`: duration, steps and metadata. Before the first call there are none."""


class Session:
    """A live run of a diagram; `Diagram.start` makes it, ``with`` or `close` ends it.

    Parameters
    ----------
    diagram : Diagram
        The diagram; it is built and frozen if necessary.
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
        check_units_of_goals(diagram)  # of a loop that is wired by hand
        self._schedule: Schedule = diagram.schedule
        self._decimation = whole_number(decimation, "decimation is ")
        self._selection = select_signals(self._schedule, record)
        self._free = _settable(self._schedule)
        self._fed = {
            f"{node.name}.{port.name}": source[0].name
            for node in diagram.nodes
            for port in node.block.inputs
            if (source := diagram.source_of(node, port, 0))
        }
        self._engine_name = engine
        self._metadata: dict[str, Any] = {}  # the part that all pieces share
        # What all results have in common. A copy of the diagram has no live run, so that a kept result keeps no FMU open.
        self._common = Result(
            np.empty((0, len(self._selection.places))),
            self._selection.columns,
            self._schedule.step,
            decimation=self._decimation,
            parts=copy(diagram),
            units=self._selection.units,
            unrecorded=self._selection.others,
        )
        self._last_end = EXACT // self._schedule.step.numerator
        self._engine: Engine
        self._run: Run | None = None
        self._is_running = False
        self._pacer: Pacer | None = None
        self._room: Callable[[int, int], Floats] | None = None
        # Duration, steps and metadata of the last call, assigned together: Ctrl-C may come at any moment.
        self._last = NO_CALL
        self._stack = ExitStack()
        # This also frees the FMUs of a session that is dropped without close().
        self._finalizer = weakref.finalize(self, self._stack.close)
        self._open(check_seed(seed))

    def advance(
        self,
        duration: float | str | Fraction,
        *,
        pace: float | None = None,
        progress: Progress | None = None,
        time_limit: float | None = None,
    ) -> Result:
        """Continue for `duration` seconds; return the signals of this piece.

        Rows follow those of the piece before; only the first piece has the row at t = 0. ``advance(0)`` at the beginning
        returns only that row.

        Parameters
        ----------
        duration : float, str or Fraction
            Seconds; a whole number of base steps.
        pace : float, optional
            Simulated seconds for each second of the clock, 1.0 for real time. The clock runs on between calls with the same
            pace, so that computing time outside counts, too. A call without pace, `restore` and `reset` stop the clock.
            ``result.metadata["pace"]`` has the pace, the number of late steps (``overruns``) and the largest delay in seconds
            (``worst_overrun``) since the clock has started. After Ctrl-C the ``KeyboardInterrupt`` has the signals up to then as
            its ``result``.
        progress : callable, optional
            Called as ``progress(step, steps)`` about twenty times a second, with the steps of this piece.
        time_limit : float, optional
            Seconds of computing after which the run is stopped; it can continue from there.

        Raises
        ------
        SimulationError
            If the run has to stop; its ``result`` has the signals of this piece up to the last complete step. After the failure
            of a block the session can continue only after `restore` or `reset`.

        Warns
        -----
        UserWarning
            If an FMU has requested the end of the simulation: the result ends there, and its ``stopped`` has the reason.
        """
        run, step = self._sound_run(), self._schedule.step
        # What follows from the duration is kept, because many calls with the same short duration are usual.
        usual, steps, metadata = self._last
        if not (type(duration) in (float, Fraction) and duration == usual):
            steps = whole_steps(duration, step, "The duration")
            seconds = steps * step.numerator / step.denominator
            metadata = {"seed": run.seed, "duration": seconds, **self._metadata}
            self._last = duration, steps, metadata
        end = max(run.k, 0) + steps
        if end > self._last_end:
            whole_steps(end * step, step, "The run's length")  # raises
        if time_limit is not None and not (isinstance(time_limit, Real) and time_limit >= 0):
            raise ModelError(f"time_limit is {time_limit!r}; it must be a number of seconds, or None.")
        if progress is not None and not callable(progress):
            raise ModelError(
                f"progress is {progress!r}; it must be a function of two arguments, step and steps, or None."
            )
        if pace is None or self._pacer is None or self._pacer.pace != pace:
            self._pacer = None if pace is None else Pacer(pace, self._schedule.step, max(run.k, 0))
        make_room(run, end, self._room)
        try:
            self._is_running = True
            if self._pacer is None:  # compiling would make paced steps late
                self._engine.prepare(steps)
            stopped = advance(self._engine, end, run, progress, time_limit, self._pacer)
        except BaseException as stop:
            if not isinstance(stop, Exception):
                self._note_interrupt(stop, run, metadata, end)
            raise
        finally:
            self._is_running = False
        result = self._piece(run, metadata, stopped)
        if run.ended:
            warn_user(str(stopped))
        elif stopped:
            raise failed(stopped, result, run)
        return result

    def _piece(self, run: Run, metadata: dict[str, Any], stopped: str | None) -> Result:
        """Return the rows of a piece, those up to the last complete step if it was ``stopped``."""
        rows = run.recording if stopped is None else run.recording[: max(run.k // run.decimation + 1 - run.before, 0)]
        result = with_rows(self._common, metadata, rows, run.before, stopped)
        if self._pacer:
            result.metadata["pace"] = self._pacer.report()
        return result

    def _note_interrupt(self, stop: BaseException, run: Run, metadata: dict[str, Any], end: int) -> None:
        """Say when Ctrl-C came; a paced piece, which may have taken hours, is kept as its ``result``."""
        step = float(self._schedule.step)
        sentence = f"Stopped by Ctrl-C at t = {max(run.k, 0) * step:g} s of {end * step:g} s"
        if self._pacer:
            stop.result = self._piece(run, metadata, f"{sentence}.")  # type: ignore[attr-defined]
            stop.add_note(f"{sentence}; the exception's result has the signals of this call.")
        else:
            stop.add_note(
                f"{sentence}; the signals of this call are lost. To keep them, give time_limit= in seconds, or call start() and "
                "then advance() in pieces."
            )

    def record_into(self, room: Callable[[int, int], Floats] | None) -> None:
        """Choose where the signals of the next pieces are written, so that whoever collects them need not copy them.

        Parameters
        ----------
        room : callable or None
            Called as ``room(rows, columns)`` by `advance`; returns the array for these rows. None for a new array each time.

        Examples
        --------
        >>> import numpy as np
        >>> from bayesftc import cosim
        >>> diagram = cosim.Diagram(dt=0.1)
        >>> ramp = diagram.add(cosim.Ramp(1.0), "ramp")
        >>> rows = np.zeros((11, 1))
        >>> with diagram.start(engine="interpreted") as session:
        ...     session.record_into(lambda rows_, columns: rows[:rows_])
        ...     piece = session.advance(1.0)
        >>> round(float(rows[10, 0]), 6)
        1.0
        """
        self._room = room

    def set(self, name: str | PortRef, value: ArrayLike) -> None:
        """Set the value of an unconnected input. It stays until it is set again; `reset` restores its start value.

        A plant uses it in its next step. A block with direct feedthrough uses it at the next t_k.

        Parameters
        ----------
        name : str or port
            Name of the input, ``"plant.force"``, or of one of its elements, ``"plant.u[1]"``; or the port, ``plant["force"]``.
        value : float or array
            One number for each element, or one for all. Inputs of an FMU must be finite.

        Raises
        ------
        UnknownNameError
            If there is no such input, or it has a source.
        ModelError
            If the value does not fit.
        """
        run = self._sound_run()
        signal = label(name) if isinstance(name, PortRef) else name
        if signal not in self._free:
            raise UnknownNameError(self._not_free(signal))
        place, shape, is_plant = self._free[signal]
        try:
            if np.asarray(value).dtype.kind in "USV":  # NumPy would convert text with digits
                raise TypeError
            values = np.asarray(value, dtype=np.float64)
            if values.shape != shape:  # else most of the time of a single number
                values = np.broadcast_to(values, shape or (1,))
        except (ValueError, TypeError, OverflowError):
            size = place.stop - place.start
            raise ModelError(
                f"{signal} cannot be set to {brief(value)}; give {'one number' if size == 1 else f'{size} numbers'}."
            ) from None
        if is_plant and not all(map(isfinite, values.flat)):
            raise ModelError(
                f"{signal} cannot be set to {value!r}, because inputs of an FMU must be finite; check the computation of the "
                "value."
            )
        run.memory[place] = values.ravel()

    @property
    def k(self) -> int:
        """The last complete step; -1 before the first."""
        return self._sound_run().k

    @property
    def time(self) -> float:
        """The time of the last complete step in seconds."""
        return max(self.k, 0) * self._schedule.step.numerator / self._schedule.step.denominator

    @property
    def step(self) -> Fraction:
        """The base step in seconds."""
        return self._schedule.step

    @property
    def inputs(self) -> dict[str, Port]:
        """The unconnected inputs, which `set` can set: their ports by name, such as ``"plant.force"``."""
        return {f"{node.name}.{port.name}": port for node, port in self._schedule.free}

    @property
    def engine(self) -> str:
        """The engine that is used: ``"compiled"`` or ``"interpreted"``."""
        return "compiled" if isinstance(self._engine, CompiledEngine) else "interpreted"

    def save_state(self) -> RunState:
        """Return the complete state of the run; `restore` can return to it repeatedly.

        Raises
        ------
        FMUError
            If an FMU cannot save its state; the message names it.
        """
        run = self._sound_run()
        saved = {self._schedule.nodes[i].name: instance.save() for i, instance in run.instances.items()}
        parameters = {
            node.name: dict(node.block.parameters or {}) for node in self._schedule.nodes if isinstance(node.block, FMU)
        }
        return RunState(
            run.k, run.seed, run.memory[self._schedule.remembered], saved, self._schedule.layout(), parameters
        )

    def restore(self, state: RunState) -> None:
        """Return to a saved state: of this session, or of another session of the same diagram, with any recorded signals.

        Outputs that are only recorded are no part of a state. For an FMU that runs at a multiple of the step they are NaN until
        its next step.

        Raises
        ------
        ModelError
            If it is not a state of such a diagram, or if a block has other parameters. The saved state of an FMU contains its
            parameters, so that new ones would have no effect.
        FMUError
            If an FMU cannot restore it. An FMU without ``canSerializeFMUState`` can only restore states of this session from
            after the last `reset`.
        """
        if not isinstance(state, RunState) or state.layout != self._schedule.layout():
            raise ModelError(
                f"{state!r} is not a saved state of this diagram; restore a state from save_state() of the same blocks."
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
            run.seed, self._last = state.seed, NO_CALL
            self._engine = choose_engine(self._engine_name, run)  # the old engine holds random numbers of the old seed
        run.k, run.sound = state.k, True

    def reset(self, seed: int | None = None) -> None:
        """Return to the beginning, with new instances of the FMUs, whose binaries stay loaded.

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
        raise ModelError("A live session cannot be pickled; pickle the diagram and the state from save_state().")

    def _not_free(self, name: object) -> str:
        source = self._fed.get(name if isinstance(name, str) else "")
        if source:
            return f"{name} is fed by {source} and cannot be set; leave that connection out, or set an input of its source."
        return f"There is no unconnected input {name!r}; {did_you_mean(name, self._free)}"

    def _open(self, seed: int) -> None:
        self._run, self._pacer = None, None
        try:
            run = open_run(self._schedule, self._stack, seed, self._selection, 0, self._decimation)
            self._engine = choose_engine(self._engine_name, run)
        except BaseException:
            self._stack.close()
            raise
        self._run, self._last = run, NO_CALL
        self._metadata = {
            "step": str(self._schedule.step),
            "engine": self.engine,
            "blocks": {node.name: type(node.block).__name__ for node in self._schedule.nodes},
        }
        if plants := _plants(self._schedule):
            self._metadata["plants"] = plants

    def _opened(self) -> Run:
        if self._run is None:
            raise ModelError("The session is closed; start a new one with diagram.start().")
        if self._is_running:
            raise ModelError(
                "The session is running, in another thread or in a function that makes this call; wait until advance() returns."
            )
        return self._run

    def _sound_run(self) -> Run:
        run = self._opened()
        if not run.sound:
            raise ModelError(
                f"The session stopped in the middle of a step after step {run.k}; call restore(state) or reset() first."
            )
        return run


def _settable(schedule: Schedule) -> dict[str, tuple[slice, tuple[int, ...], bool]]:
    """Return the unconnected inputs, and their elements, by name: place in memory, shape, whether of an FMU."""
    inputs: dict[str, tuple[slice, tuple[int, ...], bool]] = {}
    for node, port in schedule.free:
        place, name, is_plant = schedule.signal(node, port), f"{node.name}.{port.name}", is_external(node)
        inputs[name] = place, port.shape, is_plant
        if port.shape:
            for i, element in enumerate(labels(name, port.shape), place.start):
                inputs[element] = slice(i, i + 1), (), is_plant
    return inputs


def _plants(schedule: Schedule) -> dict[str, dict[str, Any]]:
    """Return the model's name and the given numbers of each FMU, by the name of its block, for the picture of the plant."""
    plants: dict[str, dict[str, Any]] = {}
    for node in schedule.nodes:
        if isinstance(node.block, FMU):
            numbers = {name: v for name, v in (node.block.parameters or {}).items() if isinstance(v, int | float)}
            plants[node.name] = {"model": node.block.description.name, "parameters": numbers}
    return plants


def _check_parameters(schedule: Schedule, memory: Floats, parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse the state of a diagram of the same blocks with other parameters of blocks or FMUs."""
    for node, slots, definition in zip(schedule.nodes, schedule.slots, schedule.definitions, strict=True):
        for name, (section, _, shape) in slots.sections.items() if definition else ():
            if section == "parameters":
                place = slice(slots.offset(name), slots.offset(name) + prod(shape))
                saved, present = memory[place], schedule.initial[place]
                # Parameters that depend on the sample time may differ in their last bits on another machine.
                last = 1e-13 * float(np.max(np.abs(present[np.isfinite(present)]), initial=0.0))
                if not np.allclose(saved, present, rtol=1e-9, atol=last, equal_nan=True):
                    raise _other_parameters(node.name, name)
        if isinstance(node.block, FMU):
            before, now = parameters.get(node.name, {}), dict(node.block.parameters or {})
            defaults = {variable.name: variable.start for variable in node.block.description.variables}
            for name in sorted(before.keys() | now.keys()):
                values = before.get(name, defaults.get(name)), now.get(name, defaults.get(name))
                if values[0] != values[1]:
                    raise _other_parameters(node.name, name, f", {values[0]!r} and not {values[1]!r}")


def _other_parameters(block: str, name: str, values: str = "") -> ModelError:
    return ModelError(
        f"In the saved state, block {block!r} has another parameter {name!r}{values}, and parameters are part of a state; "
        "restore it in a diagram with the same parameters, and use inputs for values that change (for an FMU with tunable=...)."
    )
