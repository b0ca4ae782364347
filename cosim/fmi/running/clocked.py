"""Running FMUs of FMI 3 with clocks: they tick in event mode, at the instants that the FMU requests.

A clock that is due at t_k ticks with the inputs at t_k, before the step from there. A clock that is due within a step cuts the
step. Clocked outputs keep their values between ticks. Ticks are handled in Python, called back from compiled code. The steps
between them are compiled and read the time of the next tick.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.errors import StepSizeError
from bayesftc.cosim.fmi.binaries.codes import DUE, TOLERANCE, failed
from bayesftc.cosim.fmi.binaries.groups import Group
from bayesftc.cosim.fmi.binaries.library import Beginning, CallError, Library
from bayesftc.cosim.fmi.reading.clocks import CHANGED, Ticks
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable
from bayesftc.cosim.fmi.running.instance import Instance
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.stepping.callbacks import Callback
from bayesftc.cosim.types import ENTRY, Floats

CLOCK, RAISED = 603, 604
"""Statuses: a function of clocks has failed; a Python callback has raised an exception."""


def has_clocks(description: FMUDescription, ports: Sequence[FMUVariable]) -> bool:
    """Whether an FMU has time-based clocks, or clocked ports."""
    return any(v.clocked for v in ports) or (description.uses_event_mode and bool(_timed(description)))


def _timed(description: FMUDescription) -> list[FMUVariable]:
    return [v for v in description.variables if v.causality == "input" and v.clock and v.clock.is_timed]


class ClockedInstance(Instance):
    """An initialized FMU instance with clocks; see `bayesftc.cosim.block.External`.

    Raises
    ------
    FMUError
        If the FMU's instantiation or initialization fails, or it does not give the intervals of its clocks.
    StepSizeError
        If a clock ticks within steps that the FMU does not allow to be cut.
    """

    def __init__(
        self,
        library: Library,
        name: str,
        step: Fraction,
        timing: Literal["plant", "sampled"],
        beginning: Beginning,
        outputs: Sequence[FMUVariable],
    ):
        self._clocks = [Ticks(v.name, v.reference, v.clock) for v in _timed(library.description) if v.clock]
        self._reason, self._last, self._slack = "", -math.inf, 0.0
        self._ticking: list[Ticks] = []
        self._sizes = sum(math.prod(v.shape) for v in beginning.inputs), sum(math.prod(v.shape) for v in outputs)
        self._inputs, self._held = np.zeros(self._sizes[0]), np.zeros(self._sizes[1])
        self._callbacks_of_engine: list[Callback] = []  # `explain` needs them, also where the initialization fails
        super().__init__(library, name, step, timing, beginning, outputs)
        arguments = self.resize, self.step_word, RAISED
        self._callbacks_of_engine = [
            *(Callback(function, self._sizes, *arguments) for function in (self.output, self.update)),
            Callback(lambda inputs, outputs, now: self._settle(now), (0, 0), *arguments),
        ]
        self.table[-1] = self._callbacks_of_engine[2].address
        try:
            self._check_periods(step)
        except StepSizeError:
            self.close()
            raise

    def _arranged(self, sides: tuple[list[Group], list[Group]]) -> tuple[list[Group], list[Group]]:
        self._clocked = tuple([g for g in side if g.clocks] for side in sides)
        timed = {clock.reference for clock in self._clocks}
        self._output_clocks = sorted({c for group in self._clocked[1] for c in group.clocks} - timed)
        return [g for g in sides[0] if not g.clocks], [g for g in sides[1] if not g.clocks]

    def _initializing(self) -> None:
        """See `Instance._initializing`: get clock intervals, and the clocked outputs before the first tick."""
        for clock in self._clocks:
            declaration = clock.clock
            if declaration.kind in {"fixed", "tunable"} and declaration.interval is not None:
                self._set_interval(clock, declaration.interval)
            elif declaration.interval is None:
                qualifier, interval = self._interval(clock)
                shift = self._shift(clock) if declaration.is_periodic else Fraction(0)
                if declaration.is_periodic or qualifier == CHANGED:
                    clock.start(shift, interval)
        for group in self._clocked[1]:
            status, _ = group.take(self._component, self._held)
            if failed(0, status):
                raise CallError(group.name, status)

    def _check_periods(self, step: Fraction) -> None:
        if self._grid == 0.0:
            return
        grid = step if math.isinf(self._grid) else Fraction(self._grid)
        for clock in self._clocks:
            for part in (clock.begin, clock.interval) if clock.clock.is_periodic else ():
                ratio = float((part or Fraction(0)) / grid)
                if abs(ratio - round(ratio)) > TOLERANCE * max(ratio, 1.0):
                    raise StepSizeError(
                        f"The clock {clock.name!r} of the FMU {self._library.description.name!r} ticks every "
                        f"{float(clock.interval or 0):g} s from {float(clock.begin):g} s on, within the steps of {self._name!r} "
                        f"({show(step)} s). The FMU does not allow to cut its steps there. Choose dt, or every=, so that both "
                        "are whole multiples of the step."
                    )

    # Functions of clocks

    def _call_clock(self, verb: str, clock: Ticks, *more: Any) -> None:
        self._library.call(f"fmi3{verb}", self._component, (ctypes.c_uint * 1)(clock.reference), 1, *more)

    def _set_interval(self, clock: Ticks, interval: Fraction) -> None:
        resolution = clock.clock.resolution
        if resolution:
            counter = int(interval * resolution)
            self._call_clock(
                "SetIntervalFraction", clock, (ctypes.c_uint64 * 1)(counter), (ctypes.c_uint64 * 1)(resolution)
            )
        else:
            self._call_clock("SetIntervalDecimal", clock, (ctypes.c_double * 1)(float(interval)))

    def _interval(self, clock: Ticks) -> tuple[int, Fraction]:
        """Return the qualifier of a clock's interval, and the interval (0 if not known)."""
        qualifier = (ctypes.c_int * 1)()
        value = self._get_seconds(clock, "Interval", qualifier)
        if clock.clock.is_periodic or qualifier[0] == CHANGED:
            interval = self._checked(clock, "interval", value, least=clock.clock.is_periodic)
        else:
            interval = Fraction(0)
        return qualifier[0], interval

    def _shift(self, clock: Ticks) -> Fraction:
        return self._checked(clock, "shift", self._get_seconds(clock, "Shift"), least=False)

    def _get_seconds(self, clock: Ticks, what: str, *more: Any) -> tuple[float, int]:
        if clock.clock.fractions:
            counter, resolution = (ctypes.c_uint64 * 1)(), (ctypes.c_uint64 * 1)()
            self._call_clock(f"Get{what}Fraction", clock, counter, resolution, *more)
            return counter[0], resolution[0]
        value = (ctypes.c_double * 1)(math.nan)
        self._call_clock(f"Get{what}Decimal", clock, value, *more)
        return value[0], 1

    def _checked(self, clock: Ticks, what: str, value: tuple[float, int], *, least: bool) -> Fraction:
        number, parts = value
        if not (math.isfinite(number) and parts and (number > 0 or (number == 0 and not least))):
            shown = number if parts == 1 else f"{number}/{parts}"
            raise StopError(f"its clock {clock.name!r} has the {what} {shown} s, which is not valid")
        return Fraction(number) / parts

    # Steps

    @property
    def output_address(self) -> int:
        """Address of a callback of `output`."""
        return self._callbacks_of_engine[0].address

    @property
    def update_address(self) -> int:
        """Address of a callback of `update`; 0 if the output function does everything."""
        return self._callbacks_of_engine[1].address if self._timing == "plant" else 0

    @cached_property
    def _entries(self) -> tuple[Any, Any]:
        return ENTRY(super().output_address), ENTRY(super().update_address)

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        self._begin(inputs, t)
        status = super().output(inputs, outputs, t)
        self._give_held(outputs)
        return status

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        self._begin(inputs, t)
        return super().update(inputs, outputs, t)

    def _begin(self, inputs: Floats, t: float) -> None:
        h = float(self.table.view(np.float64)[self.step_word])
        self._inputs, self._slack = inputs, TOLERANCE * h
        self._last = t + h - self._slack

    def _read(self, outputs: Floats) -> None:
        self._give_held(outputs)
        super()._read(outputs)

    def _give_held(self, outputs: Floats) -> None:
        for group in self._clocked[1]:
            outputs[group.span] = self._held[group.span]

    def _due(self, now: float) -> list[Ticks]:
        """Return the clocks to tick. Those that are due at the end of the step wait for the inputs of that instant."""
        return [c for c in self._clocks if c.due <= now + self._slack and c.due < self._last]

    def _settle(self, now: float) -> int:
        try:
            return super()._settle(now)
        except (CallError, StopError) as error:
            message = str(error)
            if not isinstance(error, CallError):  # which begins with the name of a function
                message = f"{message[0].upper()}{message[1:]}"
            self._reason = f"{message}."
            return CLOCK
        finally:
            self._note_due()

    def _note_due(self) -> None:
        """Store the time of the next tick for compiled code."""
        self._scratch.view(np.float64)[DUE] = min((c.due for c in self._clocks), default=math.inf)

    def _tick(self, now: float) -> None:
        """Activate clocks, set clocked inputs, and read clocked outputs while their clocks are active."""
        self._ticking = self._due(now)
        active = self._activate(self._ticking)
        for group in self._clocked[0]:
            if active.intersection(group.clocks):
                self._ports.put(self._component, group, self._inputs)
        if self._output_clocks:
            count = len(self._output_clocks)
            values = (ctypes.c_bool * count)()
            self._library.call(
                "fmi3GetClock", self._component, (ctypes.c_uint * count)(*self._output_clocks), count, values
            )
            active.update(r for r, value in zip(self._output_clocks, values, strict=True) if value)
        for group in self._clocked[1]:
            if active.intersection(group.clocks):
                self._ports.take(self._component, group, self._held)

    def _activate(self, ticking: list[Ticks]) -> set[int]:
        count = len(ticking)
        if count:
            references = (ctypes.c_uint * count)(*(c.reference for c in ticking))
            values = (ctypes.c_bool * count)(*[True] * count)
            self._library.call("fmi3SetClock", self._component, references, count, values)
        for clock in ticking:
            clock.tick()
        return {clock.reference for clock in ticking}

    def _still_ticks(self, now: float) -> bool:
        for clock in self._clocks:
            kind = clock.clock.kind
            tunes = kind == "tunable" and clock.clock.interval is None
            if tunes or kind == "countdown" or (kind == "changing" and clock in self._ticking):
                qualifier, interval = self._interval(clock)
                if qualifier == CHANGED:
                    clock.change(now, interval)
                elif kind == "changing" and clock.interval is not None:
                    clock.change(now, clock.interval)
        return bool(self._due(now))

    # Saved states, end and errors

    def _beside(self) -> tuple[Any, ...]:
        return (*super()._beside(), tuple(c.state for c in self._clocks), tuple(self._held.tolist()))

    def _put_beside(self, values: tuple[Any, ...]) -> None:
        super()._put_beside(values)
        for clock, state in zip(self._clocks, values[1], strict=True):
            clock.state = state
        self._note_due()
        self._held[:] = values[2]

    def close(self) -> None:
        """See `Instance.close`."""
        super().close()
        self._callbacks_of_engine = []  # they hold a reference to the instance

    def explain(self, status: int) -> str:
        """See `Instance.explain`."""
        self.has_ended = False
        raised = [callback.taken() for callback in self._callbacks_of_engine]
        if status == RAISED:
            raise next(error for error in raised if error is not None)
        if status == CLOCK:
            self._healthy = False
            return f"{self._reason} {self._messages.quoted()}"
        return super().explain(status)
