"""The instances of a prediction: as many as threads use it at the same time, from the first use until the process ends."""

from __future__ import annotations

import atexit
import ctypes
import logging
import threading
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from bayesftc.cosim.fmi.prediction import words
from bayesftc.cosim.fmi.running.by_address import ENTRY

WAIT = 1e-4
"""Seconds that a thread waits for an instance before it looks again."""


class Placed(Protocol):
    """An instance of an FMU with its table."""

    table: np.ndarray[tuple[int], np.dtype[np.int64]]

    def messages(self) -> str:
        """Return the last messages of the FMU, as a sentence."""

    def close(self, *, healthy: bool) -> None:
        """Free the instance."""


class Pool:
    """The instances of one prediction.

    Compiled code takes a free instance and calls back only if there is none, or if the FMU fails.

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
        self._placed: list[Placed] = []
        self._changing = threading.Lock()
        self.trouble: BaseException | None = None
        self.failures = 0
        self._callbacks = ENTRY(self._add), ENTRY(self._replace)
        self.words = np.zeros(words.HEAD + words.PLACE * most, dtype=np.int64)
        addresses = [ctypes.cast(callback, ctypes.c_void_p).value or 0 for callback in self._callbacks]
        self.words[: words.COUNT] = [*addresses, *sizes]
        atexit.register(self.close)

    def first(self) -> None:
        """Open the first instance, so that errors are raised here.

        Raises
        ------
        FMUError
            If the FMU cannot be instantiated or initialized.
        """
        if not self._placed and self._add(0, 0, 0, 0, 0.0, 0):
            assert self.trouble is not None
            raise self.trouble

    def _add(self, state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
        """Open one more instance, or wait for one; return 1 if there is none and none can be opened."""
        with self._changing:
            count = len(self._placed)
            if count < self._most:
                try:
                    placed = self._open()
                except BaseException as error:  # noqa: BLE001 - it cannot pass through compiled code
                    self.trouble = error
                    if count == 0:
                        return 1
                else:
                    self._placed.append(placed)
                    self.words[words.HEAD + words.PLACE * count + words.TABLE] = placed.table.ctypes.data
                    self.words[words.COUNT] = count + 1
                    return 0
        time.sleep(WAIT)
        return 0

    def _replace(self, state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
        """Replace an instance after an error, which FMI does not let continue."""
        with self._changing:
            failed = self._placed[k]
            self.failures += 1
            if self.failures == 1:
                logging.getLogger("bayesftc").warning(
                    "%s has failed as a model. Where it fails, the model counts as not finite. %s",
                    self._title[0].upper() + self._title[1:],
                    failed.messages(),
                )
            failed.close(healthy=False)
            try:
                self._placed[k] = self._open()
            except BaseException as error:  # noqa: BLE001 - as above
                self.trouble = error
                return 1
            self.words[words.HEAD + words.PLACE * k + words.TABLE] = self._placed[k].table.ctypes.data
        return 0

    def close(self) -> None:
        """Free all instances; further use opens new ones."""
        with self._changing:
            self.words[words.COUNT] = 0
            for placed in self._placed:
                placed.close(healthy=True)
            self._placed.clear()


__all__ = ["Placed", "Pool"]
