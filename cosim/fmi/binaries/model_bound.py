"""The functions of a model exchange FMU that an integrator calls, in all versions of FMI."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import Any

from bayesftc.cosim.fmi.binaries.groups import element_names
from bayesftc.cosim.fmi.reading.description import FMUDescription

Function = Callable[..., int]

_STATUS, _PLACE, _COUNT, _REAL = ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
_PLAIN = ctypes.CFUNCTYPE(_STATUS, _PLACE)
_TIME = ctypes.CFUNCTYPE(_STATUS, _PLACE, _REAL)
_VECTOR = ctypes.CFUNCTYPE(_STATUS, _PLACE, _PLACE, _COUNT)
_COMPLETED = ctypes.CFUNCTYPE(_STATUS, _PLACE, _STATUS, _PLACE, _PLACE)

PLAIN = ("enter_event_mode", "enter_continuous_mode")
VECTOR = ("set_states", "get_states", "get_derivatives", "get_indicators", "get_nominals")


class Bound:
    """Functions of the binary as plain ctypes calls of addresses, which are much faster than fmpy's."""

    #: The standard's names of the functions that differ between versions only in their names.
    names: dict[str, str]
    description: FMUDescription
    function_address: Callable[[str], int]

    def address(self, role: str) -> int:
        """Return the address of one of the functions in `names`."""
        return self.function_address(self.names[role])

    @cached_property
    def bound(self) -> dict[str, Function]:
        """The functions in `names` that take the instance, a time, or a vector."""
        kinds = {"set_time": _TIME} | dict.fromkeys(PLAIN, _PLAIN) | dict.fromkeys(VECTOR, _VECTOR)
        return {role: kind(address) for role, kind in kinds.items() if (address := self.address(role))}

    def completed_step(self, component: int, no_return: int, enter: Any, terminate: Any) -> int:
        """Call completedIntegratorStep; `enter` and `terminate` receive its results."""
        places = ctypes.addressof(enter), ctypes.addressof(terminate)
        return int(_COMPLETED(self.address("completed_step"))(component, no_return, *places))

    def state_names(self, component: int, count: int) -> list[str]:
        """Return the names of an instance's continuous states, element by element."""
        exchange = self.description.exchange
        names = [name for name, _ in element_names(exchange.states if exchange else ())]
        # Structural parameters may have changed sizes.
        return names if len(names) == count else [f"x[{i}]" for i in range(count)]
