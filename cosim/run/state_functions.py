"""Functions by which compiled code saves blocks that are saved in Python, such as an FMU in another process."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.block import External

ERROR = 3
"""FMI's status ``error``, for an exception in Python."""

_STATE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)


class StateFunctions:
    """C functions that call the Python methods of an external block to save, restore and free its state.

    The signatures are those of FMI. A state is a number, the key of the saved object.
    """

    def __init__(self, instance: External):
        self._instance, self._next = instance, 0
        self._kept: dict[int, object] = {}
        self._raised: BaseException | None = None

    def take(self) -> BaseException | None:
        """Return the first exception of the methods, if any, and clear it."""
        raised, self._raised = self._raised, None
        return raised

    @cached_property
    def addresses(self) -> tuple[int, int, int, int]:
        """Address of the instance (0, it is not needed), and of the functions that save, restore and free."""
        self._callbacks = [_STATE(f) for f in (self._save, self._restore, self._free)]
        save, restore, free = (ctypes.cast(f, ctypes.c_void_p).value or 0 for f in self._callbacks)
        return 0, save, restore, free

    def _save(self, component: int, place: int) -> int:
        return self._tried(lambda: self._put(place, self._instance.save()))

    def _restore(self, component: int, key: int) -> int:
        return self._tried(lambda: self._instance.restore(self._kept[key]))

    def _free(self, component: int, place: int) -> int:
        key = ctypes.c_int64.from_address(place).value
        return self._tried(lambda: self._instance.forget(self._kept.pop(key)))

    def _put(self, place: int, saved: object) -> None:
        self._next += 1
        self._kept[self._next] = saved
        ctypes.c_int64.from_address(place).value = self._next

    def _tried(self, action: Callable[[], None]) -> int:
        try:
            action()
        except BaseException as error:  # noqa: BLE001 - it cannot pass compiled code; `GroupRun.explain` raises it
            self._raised = self._raised or error  # later errors follow from the first
            return ERROR
        return 0
