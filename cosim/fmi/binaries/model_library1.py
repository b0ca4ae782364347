"""The binary of a model exchange FMU of FMI 1, which has no modes: events and integration are always possible."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import Any

from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.binaries.library1 import FALSE, TRUE, Library1
from bayesftc.cosim.fmi.binaries.model_bound import PLAIN, Bound, Function

_UPDATE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_char, ctypes.c_void_p)
_COMPLETED = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


class EventInfo1(ctypes.Structure):
    """fmiEventInfo, with the names of `EventInfo2`."""

    _fields_ = (
        ("converged", ctypes.c_int8),
        ("nominals", ctypes.c_int8),  # the states have changed, and so may their nominal values
        ("values", ctypes.c_int8),
        ("terminate", ctypes.c_int8),
        ("defined", ctypes.c_int8),
        ("time", ctypes.c_double),
    )

    @property
    def needed(self) -> bool:
        """Whether another pass of the event iteration is needed."""
        return not self.converged


class ModelLibrary1(Bound, Library1):
    """A binary of FMI 1 as a model exchange FMU."""

    names = {  # noqa: RUF012 - never changed
        "set_time": "fmiSetTime",
        "enter_event_mode": "",
        "enter_continuous_mode": "",
        "set_states": "fmiSetContinuousStates",
        "get_states": "fmiGetContinuousStates",
        "get_derivatives": "fmiGetDerivatives",
        "get_indicators": "fmiGetEventIndicators",
        "get_nominals": "fmiGetNominalContinuousStates",
        "completed_step": "fmiCompletedIntegratorStep",
        "update_discrete": "fmiEventUpdate",
    }
    event_info = EventInfo1

    def address(self, role: str) -> int:
        """See `Bound.address`; 0 if FMI 1 has no such function."""
        return super().address(role) if self.names[role] else 0

    @cached_property
    def bound(self) -> dict[str, Function]:
        """See `Bound.bound`."""
        functions = {role: function for role, function in super().bound.items() if role not in PLAIN}
        return {**functions, **dict.fromkeys(PLAIN, lambda component: 0)}

    def _instantiate(self, name: bytes, callbacks: Any) -> Any:
        return self.call("fmiInstantiateModel", name, self.description.token.encode(), callbacks, TRUE)

    def _initialize(self, component: int, tolerance: float, time: float) -> None:
        from fmpy.fmi1 import fmi1EventInfo

        info = fmi1EventInfo()
        self.call("fmiSetTime", component, time)
        self.call("fmiInitialize", component, TRUE if tolerance > 0.0 else FALSE, tolerance, ctypes.byref(info))
        self._first[component] = info

    @cached_property
    def _first(self) -> dict[int, ctypes.Structure]:
        """The event information from initialization, until it is used."""
        return {}

    @cached_property
    def update_discrete(self) -> Callable[[int, Any], int]:
        """See `ModelLibrary2.update_discrete`; initialization has made the first pass."""
        function = _UPDATE(self.address("update_discrete"))

        def update(component: int, info: EventInfo1) -> int:
            first = self._first.pop(component, None)
            if first is None:
                return int(function(component, FALSE, ctypes.addressof(info)))
            ctypes.memmove(ctypes.addressof(info), ctypes.addressof(first), ctypes.sizeof(info))
            return 0

        return update

    def completed_step(self, component: int, no_return: int, enter: Any, terminate: Any) -> int:
        """See `Bound.completed_step`; in FMI 1 it cannot end a simulation."""
        return int(_COMPLETED(self.address("completed_step"))(component, ctypes.addressof(enter)))

    def size(self, component: int, what: str, declared: int) -> int:
        """See `ModelLibrary2.size`."""
        return declared

    def state_names(self, component: int, count: int) -> list[str]:
        """Return the names of the continuous states, or ``x[i]`` if the binary does not identify them."""
        references = (ctypes.c_uint * count)()
        try:
            self.call("fmiGetStateValueReferences", component, references, count)
        except CallError:  # many binaries lack this function
            return [f"x[{i}]" for i in range(count)]
        reals = [v for v in self.description.variables if v.type == "Real" and not v.negated]
        names = {v.reference: v.name for v in reversed(reals)}
        return [names.get(reference, f"x[{i}]") for i, reference in enumerate(references)]

    def directional(self, component: int, unknowns: Any, knowns: Any, seed: Any, result: Any) -> int:
        """FMI 1 has no directional derivatives; this is never called."""
        raise NotImplementedError

    def terminate(self, component: int) -> None:
        """See `Library.terminate`."""
        self.call("fmiTerminate", component)

    def free(self, component: int) -> None:
        """See `Library.free`."""
        self._first.pop(component, None)
        self.call("fmiFreeModelInstance", component)
