"""Crash isolation: an FMU runs in a separate process, and a crash ends that process, not yours.

The process (`worker`) creates the same instance as this process would, and steps it with the same functions. It is started for
each instance, as a program: a fork would copy the locks of this process's threads. It ends with the instance, and with this
process, however that ends.
"""

from __future__ import annotations

import contextlib
import copy
import ctypes
import logging
import pickle
import sys
import time
import weakref
from collections import deque
from collections.abc import Collection
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bayesftc.cosim import errors
from bayesftc.cosim.block import ExternalBlock
from bayesftc.cosim.errors import FMUCrashed, FMUError
from bayesftc.cosim.fmi.reading.archive import DESCRIPTION, Archive, extract
from bayesftc.cosim.fmi.reading.messages import KEPT, quoted
from bayesftc.cosim.fmi.running.by_address import ByAddress
from bayesftc.cosim.isolation import protocol
from bayesftc.cosim.isolation.compiled import address
from bayesftc.cosim.isolation.process import Patience, WorkerProcess
from bayesftc.cosim.isolation.settings import DEFAULT_LIMIT
from bayesftc.cosim.isolation.spares import give, take
from bayesftc.cosim.isolation.states import IsolatedState
from bayesftc.cosim.types import ENTRY, Floats

STARTING = 60.0
"""Seconds for starting Python in the new process, or loading compiled code; they do not count for the FMU's time limit."""

_WHERE = {
    protocol.STARTING: " while it was instantiated or initialized",
    protocol.STEPPING: " in its step",
    protocol.READING: " while its outputs were computed",
}
_WHAT = {
    protocol.STARTING: "its instantiation or initialization",
    protocol.STEPPING: "its step",
    protocol.READING: "the computation of its outputs",
}


def isolated(block: ExternalBlock, archive: Archive, step: Fraction, name: str, time_limit: float | None) -> Isolated:
    """Return a running instance of an FMU in a separate process; see `Isolated`."""
    extract(archive, DESCRIPTION)  # in this process, where neither a time limit nor a crash interrupts it
    return Isolated(block, step, name, DEFAULT_LIMIT if time_limit is None else float(time_limit))


class Isolated(ByAddress):
    """A running instance of an FMU in a separate process; see `bayesftc.cosim.block.External`.

    Parameters
    ----------
    block : ExternalBlock
        The block to instantiate there; it is pickled.
    step : Fraction
        Seconds of a step.
    name : str
        The instance's name.
    time_limit : float
        Seconds that a call of the FMU may take.

    Attributes
    ----------
    crash : FMUCrashed or None
        Why the process has ended, if it has.
    shared : Shared
        The memory that both processes share.

    Raises
    ------
    FMUCrashed
        If the process crashes or exceeds the time limit before the instance is ready.
    FMUError
        If the FMU's instantiation or initialization fails, or this system does not support isolation.
    """

    def __init__(self, block: ExternalBlock, step: Fraction, name: str, time_limit: float):
        self.crash: FMUCrashed | None = None
        self._name, self._step, self._limit = name, step, time_limit
        path = getattr(block, "path", None)
        self._file = f" ({Path(path).name})" if path else ""
        self._lines: deque[str] = deque(maxlen=KEPT)
        self._interrupt: BaseException | None = None
        self._states: weakref.WeakSet[IsolatedState] = weakref.WeakSet()
        self._left: list[int] = []  # saved states that are no longer used
        self._tokens = 0
        self._is_ready, self._is_compiled, self._updates = False, False, block.timing != "sampled"
        inputs, outputs = (sum(port.size for port in ports) for ports in (block.inputs, block.outputs))
        plain = copy.copy(block)
        object.__setattr__(plain, "isolate", False)
        self.has_ended = False
        self._kind, self._is_closed = pickle.dumps((plain, time_limit)), False
        spare = take(self._kind)
        self._process = spare or WorkerProcess(inputs, outputs, min(protocol.ATTENTION, time_limit))
        shared = self.shared = self._process.shared
        shared.words[:] = 0
        # Compiled code calls this for all but plain answers. A weak reference avoids a cycle that would keep the process.
        weak_self = weakref.ref(self)
        self._attend = ENTRY(lambda a, b, c, answered, t, k: _attend(weak_self, answered))
        self.table = np.array(
            [
                *protocol.system_functions(),
                self._process.steps.fileno(),
                shared.words.ctypes.data,
                inputs,
                outputs,
                ctypes.cast(self._attend, ctypes.c_void_p).value,
                int(np.float64(float(step)).view(np.int64)),
            ],
            dtype=np.int64,
        )
        try:
            if spare is None:
                self._reply(STARTING)
            abilities = self._ask(plain, step, name)
            self.can_save, self.can_resize = bool(abilities["can_save"]), bool(abilities["can_resize"])
            self.own_inputs: dict[str, Floats] = abilities["own_inputs"]
            self._wide: tuple[str, ...] = abilities["wide"]
            self._is_ready = True
        except BaseException:
            self._process.end()
            raise

    # --- steps ----------------------------------------------------------------------------------------------------------------

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return self._address("output")

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 if the output function does everything."""
        return self._address("update") if self._updates else 0

    def _address(self, role: str) -> int:
        if not self._is_compiled and self.crash is None:
            with contextlib.suppress(FMUCrashed):  # the run will report it
                self._ask("compile", limit=STARTING)
            self._is_compiled = True
        return address(role)

    @property
    def rounding(self) -> Isolated:
        """See `bayesftc.cosim.fmi.running.rounding.Roundable`: this object, which calls the FMU's process."""
        return self

    @property
    def wide_outputs(self) -> tuple[str, ...]:
        """See `bayesftc.cosim.fmi.running.rounding.Roundable.wide_outputs`."""
        return self._wide

    def let_round(self, names: Collection[str]) -> None:
        """See `bayesftc.cosim.fmi.running.rounding.Roundable.let_round`."""
        self._ask("let_round", tuple(names))

    def rounded_outputs(self) -> tuple[str, ...]:
        """See `bayesftc.cosim.fmi.running.rounding.Roundable.rounded_outputs`; empty after a crash."""
        is_over = self.crash is not None or self._is_closed or self._process.is_over
        names: tuple[str, ...] = () if is_over else self._ask("rounded")
        return names

    #: See `bayesftc.cosim.block.VariableStep`.
    step_word = 8

    def expect_return(self) -> None:
        """See `bayesftc.cosim.block.External.expect_return`."""
        self._ask("expect_return")

    def _order(self, command: int) -> None:
        self.shared.words[protocol.COMMAND] = command
        with contextlib.suppress(OSError):  # the process has died; waiting for the answer detects it
            self._process.steps.send(command.to_bytes(protocol.MESSAGE, sys.byteorder))

    def attend(self, answered: int) -> int:
        """Wait for the answer to a command unless it has come, watch the process and its log, and return the status."""
        words = self.shared.words
        try:
            if answered != protocol.MESSAGE:
                self._await_answer()
            if words[protocol.PHASE] != protocol.IDLE:
                self._process.kill()
                self._note_crash("was ended because it has written into the connections between the processes.")
                self._die()
            if words[protocol.LOGGED]:
                words[protocol.LOGGED] = 0
                while self._process.talk.poll(0):
                    self._note()
        except FMUCrashed:
            if words[protocol.COMMAND] == protocol.STEP and words[protocol.PHASE] == protocol.READING:
                # The step itself was completed; the error belongs to reading the outputs at its end.
                words[protocol.AHEAD], words[protocol.READ_STATUS] = 1, protocol.CRASHED
                return 0
            return protocol.CRASHED
        except BaseException as error:  # noqa: BLE001 - compiled code cannot pass it on: `explain` raises it
            self._interrupt = error
            return protocol.INTERRUPTED
        return int(words[protocol.STATUS])

    def _await_answer(self) -> None:
        if self.crash is not None:
            self._die()
        process, patience = self._process, Patience(self._process, self._limit)
        while True:
            ready = patience.wait()
            if process.steps in ready:
                with contextlib.suppress(OSError):
                    if process.steps.recv(protocol.MESSAGE):
                        if not self._is_answered:  # it was sent for an earlier answer, see `protocol`
                            self.shared.words[protocol.HOST] = protocol.ASLEEP
                            process.wait(time.monotonic() + protocol.ATTENTION)  # it may not have seen this
                        if self._is_answered:
                            self.shared.words[protocol.HOST] = protocol.AWAKE
                            return
                        continue
                self._bury()
            if process.talk in ready:
                self._note()
            elif not ready:
                self._overdue(self._limit)

    @property
    def _is_answered(self) -> bool:
        """Whether the last step or read is done. A faulty FMU may have written into the counts."""
        words = self.shared.words
        return bool(words[protocol.DONE] == words[protocol.ASKED] or words[protocol.PHASE] == protocol.IDLE)

    # --- errors, states and end -----------------------------------------------------------------------------------------------

    def explain(self, status: int) -> str:
        """Return the meaning of a status, with the instance's last messages."""
        if status == protocol.INTERRUPTED and self._interrupt is None:
            self._interrupt = KeyboardInterrupt()
        self._raise_interrupt()
        self.has_ended = False
        try:
            text, self.has_ended = self._ask("explain", status)
        except FMUCrashed as crash:
            return str(crash)
        return str(text)

    def save(self) -> IsolatedState:
        """See `bayesftc.cosim.block.External.save`."""
        self._sweep()
        self._tokens += 1
        self._ask("save", self._tokens)
        state = IsolatedState(self, self._tokens)
        self._states.add(state)
        return state

    def restore(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.restore`."""
        self._sweep()
        if isinstance(saved, IsolatedState) and saved.owner is self:
            self._ask("restore", saved.token)
        else:
            self._ask("restore", pickle.dumps(saved))

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        if isinstance(saved, IsolatedState) and saved.owner is self:
            self._states.discard(saved)
            saved.owner = None
            self._left.append(saved.token)
            self._sweep()

    def pickled(self, token: int) -> bytes:
        """Return a saved state, pickled in the FMU's process."""
        return bytes(self._ask("pickle", token))

    def leave(self, token: int) -> None:
        """Mark a saved state as unused; it is freed with the next call of the FMU."""
        self._left.append(token)

    def _sweep(self) -> None:
        while self._left:
            self._ask("forget", self._left.pop())

    def close(self) -> None:
        """Free the instance and end its process, or leave the process to the next instance."""
        if self._is_closed or self._process.is_over:
            return
        is_sound = False
        try:
            if self.crash is None and self._is_ready:
                for state in tuple(self._states):
                    state.detach()
                self._ask("close")
                is_sound = self.crash is None
        except FMUCrashed as crash:
            logging.getLogger("bayesftc.fmu").warning("%s: while it was freed: %s", self._name, str(crash))
        except FMUError:
            pass  # the instance ends either way, and the results are complete
        finally:
            self._is_closed = True
            if not (is_sound and give(self._kind, self._process)):
                self._process.end()

    def _ask(self, *request: Any, limit: float | None = None) -> Any:
        """Send a request to the other process, and return its result."""
        if self.crash is not None:
            self._die()
        if self._is_closed or self._process.is_over:
            raise FMUError(f"The instance {self._name!r} is closed.")
        try:
            if self._is_ready:  # before, the process waits for requests only
                self._order(protocol.TALK)
            with contextlib.suppress(OSError):  # the process has died; `_reply` detects it
                self._process.talk.send(request)
            return self._reply(self._limit if limit is None else limit)
        except errors.BayesFTCError:
            raise
        except BaseException:  # the next request would receive the answer to this one
            self._process.kill()
            self._note_crash("was ended because Ctrl-C interrupted a request to it.")
            raise

    def _reply(self, limit: float) -> Any:
        process, patience = self._process, Patience(self._process, limit)
        while True:
            ready = patience.wait()
            if process.talk in ready:
                message = self._note()
                if message is None:
                    continue
                if message[0] == "refused":
                    raise getattr(errors, message[1])(message[2])
                return message[1]
            if not ready:
                self._overdue(limit)
            self._bury()  # the other socket now reports only the end of the process

    def _note(self) -> tuple[Any, ...] | None:
        """Receive one message from the other process; log it here if it is a log record, else return it."""
        try:
            message: tuple[Any, ...] = self._process.talk.recv()
            if message[0] != "log":
                return message
            _, logger, level, text, line = message
        except Exception:  # noqa: BLE001 - the connection is closed, or contains anything that the FMU has written
            self._bury()
        if line is not None:
            self._lines.append(line)
        logging.getLogger(logger).log(level, "%s", text)
        return None

    def _bury(self) -> NoReturn:
        """Raise the error for a process that has ended."""
        if self._process.is_anothers:
            self._note_crash("belongs to the process from which this one was forked; start a new run here.")
            self._die()
        with contextlib.suppress(Exception):
            while self._process.talk.poll(0):  # its last messages
                message = self._process.talk.recv()
                if message[0] == "log" and message[4] is not None:
                    self._lines.append(message[4])
        self._note_crash(f"crashed{_WHERE.get(self._phase, '')}: {self._process.obituary()}.")
        self._die()

    def _overdue(self, limit: float) -> NoReturn:
        self._process.kill()
        what = _WHAT.get(self._phase, "a call")
        self._note_crash(
            f"was ended because {what} took more than {limit:g} s; if it needs longer, give a larger time_limit."
        )
        self._die()

    def _note_crash(self, what: str) -> None:
        lines = tuple(self._lines)
        self.crash = FMUCrashed(f"The FMU of {self._name!r}{self._file} {what} {quoted(lines)}", log=lines)

    def _die(self) -> NoReturn:
        # Raise a new exception each time: the traceback of a stored one would keep this instance alive.
        assert self.crash is not None
        raise FMUCrashed(str(self.crash), log=self.crash.log)

    @property
    def _phase(self) -> int:
        return int(self.shared.words[protocol.PHASE])

    def _raise_interrupt(self) -> None:
        error, self._interrupt = self._interrupt, None
        if error is not None:
            self._process.kill()  # the pending answer is no longer needed
            self._note_crash("was ended because Ctrl-C interrupted its step.")
            raise error


def _attend(instance: weakref.ref[Isolated], answered: int) -> int:
    running = instance()
    if running is not None:
        running.shared.words[protocol.RESULT] = running.attend(answered)
    return 0
