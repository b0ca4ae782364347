"""Running FMUs of FMI 3 with clocks: they tick in event mode, at the instants that the FMU asks for.

A clock that is due at t_k ticks with the inputs of t_k, before the step from there; one that is due within a step cuts it.
Clocked outputs keep between ticks what they had at the last one. This is done in Python, which compiled code calls back; the
steps between are compiled, and know when the next clock is due.
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
from bayesftc.cosim.fmi.running.by_address import ENTRY
from bayesftc.cosim.fmi.running.instance import Instance
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.stepping.callbacks import Callback
from bayesftc.cosim.types import Floats

CLOCK, RAISED = 603, 604
"""Status: a function of clocks has failed; Python has raised something."""


def has_clocks(description: FMUDescription, ports: Sequence[FMUVariable]) -> bool:
    """Whether an FMU has clocks that are to tick, or ports that are clocked."""
    return any(v.clocked for v in ports) or (description.uses_event_mode and bool(_timed(description)))


def _timed(description: FMUDescription) -> list[FMUVariable]:
    return [v for v in description.variables if v.causality == "input" and v.clock and v.clock.is_timed]


class ClockedInstance(Instance):
    """An initialized FMU instance with clocks; see `bayesftc.cosim.block.External`.

    Raises
    ------
    FMUError
        If the FMU refuses to be instantiated or initialized, or to say when its clocks tick.
    StepSizeError
        If its steps cannot be cut, and a clock ticks within them.
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
        ours = {clock.reference for clock in self._clocks}
        self._asked = sorted({c for group in self._clocked[1] for c in group.clocks} - ours)
        return [g for g in sides[0] if not g.clocks], [g for g in sides[1] if not g.clocks]

    def _initializing(self) -> None:
        """See `Instance._initializing`: ask when clocks tick, and what clocked outputs are before the first tick."""
        for clock in self._clocks:
            said = clock.clock
            if said.kind in {"fixed", "tunable"} and said.interval is not None:
                self._tell(clock, said.interval)
            elif said.interval is None:
                qualifier, interval = self._interval(clock)
                shift = self._shift(clock) if said.is_periodic else Fraction(0)
                if said.is_periodic or qualifier == CHANGED:
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
                        f"{float(clock.interval or 0):g} s from {float(clock.begin):g} s on, but {self._name!r} makes steps of "
                        f"{show(step)} s, which the FMU does not allow to be cut there: choose dt, or every=, so that both "
                        "are whole multiples of its step."
                    )

    # Functions of clocks

    def _call_clock(self, verb: str, clock: Ticks, *more: Any) -> None:
        self._library.call(f"fmi3{verb}", self._component, (ctypes.c_uint * 1)(clock.reference), 1, *more)

    def _tell(self, clock: Ticks, interval: Fraction) -> None:
        resolution = clock.clock.resolution
        if resolution:
            counter = int(interval * resolution)
            self._call_clock(
                "SetIntervalFraction", clock, (ctypes.c_uint64 * 1)(counter), (ctypes.c_uint64 * 1)(resolution)
            )
        else:
            self._call_clock("SetIntervalDecimal", clock, (ctypes.c_double * 1)(float(interval)))

    def _interval(self, clock: Ticks) -> tuple[int, Fraction]:
        """Return what the FMU says of a clock's interval, and the interval; 0 where it is not known."""
        qualifier = (ctypes.c_int * 1)()
        value = self._asked_for(clock, "Interval", qualifier)
        if clock.clock.is_periodic or qualifier[0] == CHANGED:
            interval = self._checked(clock, "interval", value, least=clock.clock.is_periodic)
        else:
            interval = Fraction(0)
        return qualifier[0], interval

    def _shift(self, clock: Ticks) -> Fraction:
        return self._checked(clock, "shift", self._asked_for(clock, "Shift"), least=False)

    def _asked_for(self, clock: Ticks, what: str, *more: Any) -> tuple[float, int]:
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
            raise StopError(f"its clock {clock.name!r} has the {what} {shown} s, which is none")
        return Fraction(number) / parts

    # Steps

    @property
    def output_address(self) -> int:
        """Address of a callback of `output`."""
        return self._callbacks_of_engine[0].address

    @property
    def update_address(self) -> int:
        """Address of a callback of `update`; 0 where all is done in the output function."""
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
            outputs[group.mine] = self._held[group.mine]

    def _due(self, now: float) -> list[Ticks]:
        """Return the clocks to tick; those that are due when the step ends wait for the inputs of then."""
        return [c for c in self._clocks if c.due <= now + self._slack and c.due < self._last]

    def _settle(self, now: float) -> int:
        try:
            return super()._settle(now)
        except (CallError, StopError) as error:
            said = str(error)
            self._reason = f"{said[0].upper()}{said[1:]}."
            return CLOCK
        finally:
            self._note_due()

    def _note_due(self) -> None:
        """Let compiled code know when the next clock ticks."""
        self._scratch.view(np.float64)[DUE] = min((c.due for c in self._clocks), default=math.inf)

    def _tick(self, now: float) -> None:
        """Activate clocks, set clocked inputs, and read clocked outputs while their clocks are active."""
        self._ticking = self._due(now)
        active = self._activate(self._ticking)
        for group in self._clocked[0]:
            if active.intersection(group.clocks):
                self._ports.put(self._component, group, self._inputs)
        if self._asked:
            count = len(self._asked)
            values = (ctypes.c_bool * count)()
            self._library.call("fmi3GetClock", self._component, (ctypes.c_uint * count)(*self._asked), count, values)
            active.update(r for r, value in zip(self._asked, values, strict=True) if value)
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

    # What others ask

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
        self._callbacks_of_engine = []  # which hold the instance

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
