"""The instances of a prediction: as many as threads use it at the same time, from the first use until the process ends."""

from __future__ import annotations

import _thread
import atexit
import ctypes
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np

from bayesftc.cosim.fmi.prediction import words
from bayesftc.cosim.types import ENTRY

WAIT = 1e-4
"""Seconds that a thread waits for an instance before it looks again."""


LATER = 0.02
"""Seconds after which Ctrl-C is raised again."""


class Placed(Protocol):
    """An instance of an FMU with its table."""

    table: np.ndarray[tuple[int], np.dtype[np.int64]]

    def messages(self) -> str:
        """Return the last messages of the FMU, as a sentence."""

    def close(self, *, healthy: bool) -> None:
        """Free the instance."""


class Pool:
    """The instances of one prediction.

    Compiled code takes a free instance and calls back only if there is none, or if the FMU fails. An instance that fails and
    cannot be replaced stays locked: no thread uses it again.

    Parameters
    ----------
    title : str
        The FMU, for messages.
    open_instance : callable
        Returns a new instance.
    sizes : (int, int, int)
        Numbers of states, controls and sensors.
    most : int
        Most instances.
    """

    def __init__(self, title: str, open_instance: Callable[[], Placed], sizes: tuple[int, int, int], most: int):
        self._title, self._open, self._most = title, open_instance, most
        self._placed: list[Placed | None] = []  # None: it could not be replaced
        self._changing = threading.Lock()
        self._users = 0
        self._warned = False
        self.failures = 0
        self._callbacks = ENTRY(_without_interrupts(self._add)), ENTRY(_without_interrupts(self._replace))
        self.words = np.zeros(words.HEAD + words.PLACE * most, dtype=np.int64)
        addresses = [ctypes.cast(callback, ctypes.c_void_p).value or 0 for callback in self._callbacks]
        self.words[: words.COUNT] = [*addresses, *sizes]
        atexit.register(self._free)

    def keep(self) -> None:
        """Keep the instances until the process ends, for functions that stay in use."""
        with self._changing:
            self._users += 1

    @contextmanager
    def briefly(self) -> Iterator[None]:
        """Open the first instance, so that errors are raised here; at the end free all, if no other user is left.

        Raises
        ------
        FMUError
            If the FMU cannot be instantiated or initialized.
        """
        self.keep()
        try:
            with self._changing:
                if not self._placed:
                    self._append(self._open())
            yield
        finally:
            with self._changing:
                self._users -= 1
                if not self._users:
                    self._free()

    def _opened(self) -> Placed | None:
        """Return a new instance; None if it cannot be opened, as no error passes through compiled code."""
        try:
            return self._open()
        except Exception as error:  # noqa: BLE001 - as above
            if not self._warned:
                self._warn(f"cannot be opened once more. {error}")
            self._warned = True
            return None

    def _warn(self, what: str) -> None:
        logging.getLogger("bayesftc").warning("%s%s %s", self._title[0].upper(), self._title[1:], what)

    def _add(self, state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
        """Open one more instance, or wait for one; return 1 if there is none and none can be opened."""
        with self._changing:
            placed = self._opened() if len(self._placed) < self._most else None
            if placed is not None:
                self._append(placed)
                return 0
            if not any(self._placed):
                return 1
        time.sleep(WAIT)
        return 0

    def _replace(self, state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
        """Replace an instance after an error, which FMI does not let continue; return 1 if that is impossible."""
        with self._changing:
            failed = self._placed[k]
            assert failed is not None
            self.failures += 1
            if self.failures == 1:
                self._warn(
                    f"has failed as a model. Where it fails, the model counts as not finite. {failed.messages()}"
                )
            self._placed[k] = None
            failed.close(healthy=False)  # first, as some FMUs allow one instance only
            self._placed[k] = placed = self._opened()
            if placed is None:
                return 1
            self._point(k, placed)
        return 0

    def _append(self, placed: Placed) -> None:
        self._placed.append(placed)
        self._point(len(self._placed) - 1, placed)
        self.words[words.COUNT] = len(self._placed)

    def _point(self, k: int, placed: Placed) -> None:
        self.words[words.HEAD + words.PLACE * k + words.TABLE] = placed.table.ctypes.data

    def _free(self) -> None:
        """Free all instances but those that a thread uses; further use opens new ones."""
        locks = self.words[words.HEAD + words.LOCK :: words.PLACE]
        for placed, lock in zip(self._placed, locks, strict=False):
            if placed is not None and not lock:
                placed.close(healthy=True)
        self._placed.clear()
        self.words[words.COUNT] = 0
        locks[:] = 0


def _without_interrupts(function: Callable[..., int]) -> Callable[..., int]:
    """Raise Ctrl-C after the compiled code that calls the function, because no error passes through that code."""

    def call(*arguments: Any) -> int:
        try:
            return function(*arguments)
        except KeyboardInterrupt:
            threading.Timer(LATER, _thread.interrupt_main).start()
            return 1

    return call


__all__ = ["Placed", "Pool"]
