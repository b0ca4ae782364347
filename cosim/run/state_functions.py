"""How compiled code saves blocks that are saved in Python: an FMU in another process, or with an integrator around it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesftc.cosim.block import External

ERROR = 3
"""FMI's word for what went wrong in Python."""

_STATE = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p)


class StateFunctions:
    """The functions by which compiled code saves an external block that has none in C: they call its Python methods.

    The signatures are those of FMI; a state is a number under which the saved object is kept.
    """

    def __init__(self, instance: External):
        self._instance, self._next = instance, 0
        self._kept: dict[int, object] = {}
        self._raised: BaseException | None = None

    def take(self) -> BaseException | None:
        """Return what the methods have raised, if they have; the next failure has reasons of its own."""
        raised, self._raised = self._raised, None
        return raised

    @cached_property
    def addresses(self) -> tuple[int, int, int, int]:
        """Address of the instance, which is not needed, and of the functions that save, restore and free."""
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
        except BaseException as error:  # noqa: BLE001 - it cannot pass compiled code: `GroupRun.explain` says it
            self._raised = self._raised or error  # what comes after follows from the first
            return ERROR
        return 0
