"""One step of an FMU, and the reading of its outputs: the functions that both engines call, with the same numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim._fmi.groups import Group
from bayesftc.cosim.block import Floats

# The codes of bayesftc.cosim._fmi.kernels, repeated so that the interpreted engine does without numba; a test compares.
GET, SET, STEP, EVENTS = 100, 200, 300, 500
EARLY, TERMINATED, ENDLESS = 401, 402, 403
UNFIT_INPUT, UNFIT_OUTPUT = 601, 602
EVENT, TERMINATE, RETURNED_EARLY, REACHED, ANSWER, UNFIT, UPDATE = range(7)
SCRATCH_WORDS = 12
TOLERANCE, SMALLEST, TRIES = 1e-9, 1e-6, 10_000
DISCARD, FATAL = 2, 4
_LAST_TIME, _TERMINATED = 2, 3

_STEP2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
_STEP3 = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool, *[ctypes.c_void_p] * 4
)
_ASK2 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)
_MODE3 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_UPDATE3 = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *[ctypes.c_void_p] * 6)


@dataclass(frozen=True)
class Addresses:
    """Addresses of the FMI functions that a step may call; 0 where the instance does not have them or is not to use them.

    Attributes
    ----------
    do_step : int
        Makes the step.
    real_status, boolean_status : int
        FMI 2, where steps of any size can be made: say how far a discarded step came, and whether the FMU wants to end.
    enter_event_mode, update_discrete, enter_step_mode : int
        FMI 3, where event mode is used.
    """

    do_step: int
    real_status: int = 0
    boolean_status: int = 0
    enter_event_mode: int = 0
    update_discrete: int = 0
    enter_step_mode: int = 0


@cache
def _compiled(major: int, role: str, plain: bool) -> Any:
    from bayesftc.cosim._compiler import compile_raw

    if plain:
        from bayesftc.cosim._fmi.kernels import FUNCTIONS
    else:
        from bayesftc.cosim._fmi.typed_kernels import FUNCTIONS
    function: Any = FUNCTIONS[major, role]
    return compile_raw(function)


class StepFunctions:
    """The FMI functions of one instance with reused buffers, for both engines.

    Parameters
    ----------
    major : int
        2 or 3: the version of FMI, which says how the functions are called.
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
    ):
        self._major, self._timing, self._h = major, timing, h
        self._component, self._addresses = component, addresses
        self._groups = tuple(inputs), tuple(outputs)
        self._scratch = np.zeros(SCRATCH_WORDS, dtype=np.int64)
        sides = (inputs, outputs)
        self._plain = all(len(s) <= 1 for s in sides) and not any(g.kind.code or g.discrete for s in sides for g in s)
        into = out = 0, 0, 0, 0
        if self._plain:
            into, out = (side[0].place() if side else (0, 0, 0, 0) for side in sides)
            counts = 0, 0, 0, 0
        else:
            self._rows = [np.array([g.words() for g in side], dtype=np.int64) for side in sides]
            counts = self._rows[0].ctypes.data, len(inputs), self._rows[1].ctypes.data, len(outputs)
        size, a = int(np.float64(h).view(np.int64)), addresses
        self.table = np.array(
            [
                component, out[0], into[0], a.do_step, into[1], into[2], out[1], out[2], size, self._scratch.ctypes.data,
                into[3], out[3], a.real_status, a.boolean_status, a.enter_event_mode, a.update_discrete, a.enter_step_mode,
                *counts,
            ],
            dtype=np.int64,
        )  # fmt: skip

    #: The word of the table that holds the step size, of which compiled code finds a copy in memory.
    step_word = 8

    def resize(self, h: float) -> None:
        """Make steps of `h` seconds from now on, in interpreted runs."""
        self._h = h

    # What follows is for interpreted runs alone; compiled ones, of which there may be thousands, need not wait for it.
    @cached_property
    def _do_step(self) -> Any:
        return (_STEP2 if self._major == 2 else _STEP3)(self._addresses.do_step)

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
            status, unfit = group.take(self._component, outputs)
            if unfit >= 0:
                self._scratch[UNFIT] = unfit
                return UNFIT_OUTPUT
            status = _failed(GET, status)
            if status:
                self._scratch[UNFIT] = group.begin
                return status
        return 0

    def _advance(self, inputs: Floats, t: float) -> int:
        status = self._set(inputs)
        if status:
            return status
        h = self._h
        if self._major == 2:
            status = self._do_step(self._component, t, h, 0)
            if status == DISCARD and self._addresses.real_status:
                return self._in_parts(t, h)
            return _failed(STEP, status)
        status = _failed(STEP, self._do_step(self._component, t, h, False, *self._places[:4]))
        return status or self._go_on(t, h)

    def _set(self, inputs: Floats) -> int:
        events, changed = self._addresses.enter_event_mode, False
        for group in self._groups[0]:
            if events and group.discrete:
                status, other = group.changed(self._component, inputs)
                if _failed(EVENTS, status):
                    return EVENTS + status
                changed = changed or other
                continue
            status = self._put(group, inputs)
            if status:
                return status
        if not changed:
            return 0
        status = _failed(EVENTS, self._modes[0](self._component))
        for group in self._groups[0]:
            if not status and group.discrete:
                status = self._put(group, inputs)
        return status or self._settle()

    def _put(self, group: Group, inputs: Floats) -> int:
        status, unfit = group.put(self._component, inputs)
        if unfit >= 0:
            self._scratch[UNFIT] = unfit
            return UNFIT_INPUT
        status = _failed(SET, status)
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
                if terminated(self._component, _TERMINATED, place) <= 1 and answer[0]:
                    return STEP + DISCARD
                answer.view(np.float64)[0] = now
                if last_time(self._component, _LAST_TIME, place) > 1:
                    return STEP + DISCARD
                reached = float(answer.view(np.float64)[0])
                if not now <= reached <= now + part:
                    return STEP + DISCARD
                now = reached
                part = 0.5 * part
                if part < SMALLEST * h:
                    return STEP + DISCARD
            elif _failed(STEP, status):
                return STEP + status
            else:
                now = now + part
            left = end - now
            if left <= TOLERANCE * h:
                return 0
            if part > left - TOLERANCE * h:
                part = left
            status = self._do_step(self._component, now, part, 0)
        return ENDLESS

    def _go_on(self, t: float, h: float) -> int:
        """See what a step of FMI 3 says: to end, to handle an event, to go on after an early return."""
        scratch, now, end = self._scratch, t, t + h
        for _ in range(TRIES):
            if scratch[TERMINATE]:
                return TERMINATED
            early, reached = scratch[RETURNED_EARLY], float(scratch.view(np.float64)[REACHED])
            if scratch[EVENT] and self._addresses.enter_event_mode:
                status = _failed(EVENTS, self._modes[0](self._component)) or self._settle()
                if status:
                    return status
            if not early or reached >= end - TOLERANCE * h:
                return 0
            if not reached > now:
                return EARLY
            now = reached
            status = _failed(STEP, self._do_step(self._component, now, end - now, False, *self._places[:4]))
            if status:
                return status
        return ENDLESS

    def _settle(self) -> int:
        _, update, leave = self._modes
        for _ in range(TRIES):
            status = _failed(EVENTS, update(self._component, *self._places[UPDATE:]))
            if status:
                return status
            if self._scratch[UPDATE + 1]:
                return TERMINATED
            if not self._scratch[UPDATE]:
                return _failed(EVENTS, leave(self._component))
        return ENDLESS


def _failed(where: int, status: int) -> int:
    return where + status if status > 1 or status < 0 else 0
