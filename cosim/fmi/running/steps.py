"""One step of an FMU, and the reading of its outputs: the functions that both engines call, with the same numbers."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim.fmi.binaries.addresses import Addresses
from bayesftc.cosim.fmi.binaries.codes import (
    ANSWER,
    DISCARD,
    EARLY,
    ENDLESS,
    EVENT,
    EVENTS,
    GET,
    HAS_TERMINATED,
    LAST,
    LAST_TIME,
    MOST,
    NEXT_DEFINED,
    NEXT_TIME,
    NO_RETURN,
    ODD,
    REACHED,
    RETURNED_EARLY,
    SCRATCH_WORDS,
    SET,
    SMALLEST,
    STEP,
    TERMINATE,
    TERMINATED,
    TOLERANCE,
    TRIES,
    UNFIT,
    UNFIT_INPUT,
    UNFIT_OUTPUT,
    UPDATE,
    UPDATE_TERMINATE,
)
from bayesftc.cosim.fmi.binaries.groups import Group
from bayesftc.cosim.types import Floats

_STEP2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
_STEP3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)
_ASK2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)
_MODE3 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_UPDATE3 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *[ctypes.c_void_p] * 6)


@cache
def _compiled(major: int, role: str, plain: bool) -> Any:
    from bayesftc.cosim.stepping.compiler import compile_raw

    if plain:
        from bayesftc.cosim.fmi.running.kernels import FUNCTIONS
    else:
        from bayesftc.cosim.fmi.running.typed_kernels import FUNCTIONS
    function: Any = FUNCTIONS[max(major, 2), role]  # those of FMI 1 are called as those of FMI 2
    return compile_raw(function)


class StepFunctions:
    """The FMI functions of one instance with reused buffers, for both engines.

    Parameters
    ----------
    major : int
        1, 2 or 3: the version of FMI, which says how the functions are called.
    addresses : Addresses
        Of the functions of a step.
    component : int
        The instance's address.
    inputs, outputs : sequence of Group
        What is set and read.
    h : float
        Step size in seconds.
    timing : {"plant", "sampled"}
        Whether the outputs are read before the step, or after it.
    grid : float
        Of FMI 3, into parts of which size a step may be cut: 0 for any, infinity for none, else multiples of this.
    """

    def __init__(
        self,
        major: int,
        addresses: Addresses,
        component: int,
        inputs: Sequence[Group],
        outputs: Sequence[Group],
        h: float,
        timing: Literal["plant", "sampled"],
        grid: float = math.inf,
    ):
        self._major, self._timing, self._h, self._grid = major, timing, h, grid
        self._component, self._addresses = component, addresses
        self._groups = tuple(inputs), tuple(outputs)
        self._scratch = np.zeros(SCRATCH_WORDS, dtype=np.int64)
        self._scratch[NO_RETURN] = 1
        sides = (inputs, outputs)
        self._plain = not addresses.enter_event_mode and all(
            len(s) <= 1 and all(g.kind.plain for g in s) for s in sides
        )
        into = out = 0, 0, 0, 0
        if self._plain:
            into, out = (side[0].place() if side else (0, 0, 0, 0) for side in sides)
            counts = 0, 0, 0, 0
        else:
            self._rows = [np.array([g.words() for g in side], dtype=np.int64) for side in sides]
            counts = self._rows[0].ctypes.data, len(inputs), self._rows[1].ctypes.data, len(outputs)
        a = addresses
        size, parts = np.array([h, grid]).view(np.int64)
        self.table = np.array(
            [
                component, out[0], into[0], a.do_step, into[1], into[2], out[1], out[2], size, self._scratch.ctypes.data,
                into[3], out[3], a.real_status, a.boolean_status, a.enter_event_mode, a.update_discrete, a.enter_step_mode,
                *counts, parts,
            ],
            dtype=np.int64,
        )  # fmt: skip

    def expect_return(self) -> None:
        """Promise no more, with each step, that no state before it will be restored (noSetFMUStatePriorToCurrentPoint)."""
        if self._major != 1:  # there the word says that the step is a new one
            self._scratch[NO_RETURN] = 0

    @property
    def _no_return(self) -> int:
        return int(self._scratch[NO_RETURN])

    #: The word of the table that holds the step size, of which compiled code finds a copy in memory.
    step_word = 8

    def resize(self, h: float) -> None:
        """Make steps of `h` seconds from now on, in interpreted runs."""
        self._h = h

    # What follows is for interpreted runs alone; compiled ones, of which there may be thousands, need not wait for it.
    @cached_property
    def _do_step(self) -> Any:
        return (_STEP3 if self._major == 3 else _STEP2)(self._addresses.do_step)

    @cached_property
    def _places(self) -> list[int]:
        return [self._scratch.ctypes.data + 8 * i for i in range(SCRATCH_WORDS)]

    @cached_property
    def _asks(self) -> tuple[Any, Any]:
        return _ASK2(self._addresses.boolean_status), _ASK2(self._addresses.real_status)

    @cached_property
    def _modes(self) -> tuple[Any, Any, Any]:
        a = self._addresses
        return _MODE3(a.enter_event_mode), _UPDATE3(a.update_discrete), _MODE3(a.enter_step_mode)

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return int(_compiled(self._major, "get" if self._timing == "plant" else "sampled", self._plain).address)

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 where all is done in the output function."""
        return int(_compiled(self._major, "advance", self._plain).address) if self._timing == "plant" else 0

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        if self._timing == "sampled":
            status = self._advance(inputs, t)
            if status:
                return status
        return self._read(outputs)

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        return self._advance(inputs, t) if self._timing == "plant" else 0

    def _read(self, outputs: Floats) -> int:
        for group in self._groups[1]:
            status = self._take(group, outputs)
            if status:
                return status
        return 0

    def _take(self, group: Group, outputs: Floats) -> int:
        status, unfit = group.take(self._component, outputs)
        if unfit >= 0:
            self._scratch[UNFIT] = unfit
            return UNFIT_OUTPUT
        status = failed(GET, status)
        if status:
            self._scratch[UNFIT] = group.begin
        return status

    def _advance(self, inputs: Floats, t: float) -> int:
        status = self._set(inputs, t)
        if status:
            return status
        h = self._h
        if self._major != 3:
            status = self._do_step(self._component, t, h, self._no_return)
            if status == DISCARD and self._addresses.real_status:
                return self._in_parts(t, h)
            return failed(STEP, status)
        size = self._part(t, h, TOLERANCE * h)
        return self._go_on(t, h, size, self._do_step(self._component, t, size, self._no_return, *self._places[:4]))

    def _set(self, inputs: Floats, t: float) -> int:
        """Set the inputs, all of them in event mode if one has changed that may only change at events.

        What the instance has is asked before anything is set: afterwards FMI allows no reading before the step.
        """
        events, changed = self._addresses.enter_event_mode != 0, self._has_event(t)
        for group in self._groups[0]:
            if events and group.discrete and not changed:
                status, changed = group.changed(self._component, inputs)
                if failed(EVENTS, status):
                    return failed(EVENTS, status)
        status = failed(EVENTS, self._modes[0](self._component)) if changed else 0
        for group in self._groups[0]:
            if not status and (changed or not events or not group.discrete):
                status = self._put(group, inputs)
        return status or (self._settle(t) if changed else 0)

    def _has_event(self, t: float) -> bool:
        """Whether event mode is needed before the step from `t`, whatever the inputs are."""
        return False

    def _put(self, group: Group, inputs: Floats) -> int:
        status, unfit = group.put(self._component, inputs)
        if unfit >= 0:
            self._scratch[UNFIT] = unfit
            return UNFIT_INPUT
        status = failed(SET, status)
        if status:
            self._scratch[UNFIT] = group.begin
        return status

    def _in_parts(self, t: float, h: float) -> int:
        """Go on after a step of FMI 2 that was discarded: from where it came to, in smaller parts."""
        answer, place = self._scratch[ANSWER : ANSWER + 1], self._places[ANSWER]
        terminated, last_time = self._asks
        now, end, part, status = t, t + h, h, DISCARD
        for _ in range(TRIES):
            if status == DISCARD:
                answer[0] = 0
                if terminated(self._component, HAS_TERMINATED, place) <= 1 and answer[0]:
                    return STEP + DISCARD
                answer.view(np.float64)[0] = now
                if last_time(self._component, LAST_TIME, place) > 1:
                    return STEP + DISCARD
                reached = float(answer.view(np.float64)[0])
                if not now <= reached <= now + part:
                    return STEP + DISCARD
                now = reached
                part = 0.5 * part
                if part < SMALLEST * h:
                    return STEP + DISCARD
            elif failed(STEP, status):
                return failed(STEP, status)
            else:
                now = now + part
            left = end - now
            if left <= TOLERANCE * h:
                return 0
            if part > left - TOLERANCE * h:
                part = left
            status = self._do_step(self._component, now, part, self._no_return)
        return ENDLESS

    def _go_on(self, t: float, h: float, size: float, status: int) -> int:
        """Bring a step of FMI 3 to its end, of which the first part, of this size, has returned this status."""
        scratch, events = self._scratch, self._addresses.enter_event_mode
        now, end, most, slack = t, t + h, h, TOLERANCE * h
        for _ in range(TRIES):
            if status == DISCARD and self._grid == 0.0:
                most = 0.5 * size  # the FMU has stayed where it was
                if most < SMALLEST * h:
                    return STEP + DISCARD
            elif failed(STEP, status):
                return failed(STEP, status)
            elif scratch[TERMINATE]:
                return TERMINATED
            else:
                reached = float(scratch.view(np.float64)[REACHED]) if scratch[RETURNED_EARLY] else now + size
                event = events and (scratch[EVENT] or self._next_event <= reached + slack)
                if not (reached > now or (event and reached == now)):
                    return EARLY
                now = reached
                if event:
                    status = failed(EVENTS, self._modes[0](self._component)) or self._settle(now)
                    if status:
                        return status
            left = end - now
            if left <= slack:
                return 0
            size = self._part(now, most if most < left - slack else left, slack)
            status = self._do_step(self._component, now, size, self._no_return, *self._places[:4])
        return ENDLESS

    @property
    def _next_event(self) -> float:
        """When the instance is to go through event mode next."""
        return self._announced

    @property
    def _announced(self) -> float:
        """When the instance wants the next time event: what fmi3UpdateDiscreteStates said last."""
        return float(self._scratch.view(np.float64)[NEXT_TIME]) if self._scratch[NEXT_DEFINED] else math.inf

    def _part(self, now: float, size: float, slack: float) -> float:
        """Return the size of the next part of a step: no more than to the next time event, where it may be cut there."""
        event = self._next_event
        if not (now + slack < event < now + size - slack):
            return size
        part = event - now
        if self._grid > 0.0:
            part = math.ceil(part / self._grid - TOLERANCE) * self._grid
        return part if part < size - slack else size

    def _settle(self, now: float) -> int:
        """Update the discrete states in event mode until they stay, and go back to step mode."""
        _, update, leave = self._modes
        for _ in range(TRIES):
            status = failed(EVENTS, update(self._component, *self._places[UPDATE:]))
            if status:
                return status
            if self._scratch[UPDATE_TERMINATE]:
                return TERMINATED
            if not self._scratch[UPDATE]:
                return failed(EVENTS, leave(self._component))
        return ENDLESS


def failed(where: int, status: int) -> int:
    """Return 0 for FMI's OK and Warning, else the status of a step, see `decoded`."""
    if status in (0, 1):
        return 0
    return where + status if 1 < status <= LAST else ODD * where + min(max(status, -MOST), MOST) + MOST


def decoded(status: int) -> tuple[int, int]:
    """Return what has failed (`GET`, `SET`, `STEP`, `EVENTS`, or another code), and the status that FMI's function returned."""
    if status >= ODD * GET:
        where, code = divmod(status, ODD * GET)
        return where * GET, code - MOST
    where = status // GET * GET
    return (where, status - where) if where in {GET, SET, STEP, EVENTS} else (where, 0)
