"""The binary of a model exchange FMU of FMI 2 or 3: the functions that an integrator calls."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

from bayesftc.cosim.fmi.binaries.library import CallError, Library2, Library3
from bayesftc.cosim.fmi.binaries.loading import load_library
from bayesftc.cosim.fmi.binaries.model_bound import Bound
from bayesftc.cosim.fmi.binaries.model_library1 import ModelLibrary1
from bayesftc.cosim.fmi.reading.archive import Archive
from bayesftc.cosim.fmi.reading.description import FMUDescription
from bayesftc.cosim.fmi.reading.messages import Messages, callback3

_STATUS, _PLACE, _COUNT = ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t


class EventInfo2(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = (
        ("needed", ctypes.c_int),
        ("terminate", ctypes.c_int),
        ("nominals", ctypes.c_int),
        ("values", ctypes.c_int),
        ("defined", ctypes.c_int),
        ("time", ctypes.c_double),
    )


class EventInfo3(ctypes.Structure):
    """The results of fmi3UpdateDiscreteStates, with the fields of `EventInfo2`."""

    _fields_ = (
        ("needed", ctypes.c_bool),
        ("terminate", ctypes.c_bool),
        ("nominals", ctypes.c_bool),
        ("values", ctypes.c_bool),
        ("defined", ctypes.c_bool),
        ("time", ctypes.c_double),
    )


class ModelLibrary2(Bound, Library2):
    """A binary of FMI 2 as a model exchange FMU."""

    interface = 0
    names = {  # noqa: RUF012 - never changed
        "set_time": "fmi2SetTime",
        "enter_event_mode": "fmi2EnterEventMode",
        "enter_continuous_mode": "fmi2EnterContinuousTimeMode",
        "set_states": "fmi2SetContinuousStates",
        "get_states": "fmi2GetContinuousStates",
        "get_derivatives": "fmi2GetDerivatives",
        "get_indicators": "fmi2GetEventIndicators",
        "get_nominals": "fmi2GetNominalsOfContinuousStates",
        "completed_step": "fmi2CompletedIntegratorStep",
        "update_discrete": "fmi2NewDiscreteStates",
        "directional": "fmi2GetDirectionalDerivative",
    }

    @cached_property
    def update_discrete(self) -> Callable[[int, Any], int]:
        """Function ``(instance, event info)``: one pass of the event iteration."""
        kind = ctypes.CFUNCTYPE(_STATUS, _PLACE, _PLACE)
        function = kind(self.address("update_discrete"))
        return lambda component, info: function(component, ctypes.addressof(info))

    event_info = EventInfo2

    def size(self, component: int, what: str, declared: int) -> int:
        """Return the number of states or event indicators."""
        return declared

    def directional(self, component: int, unknowns: Any, knowns: Any, seed: Any, result: Any) -> int:
        """Compute a directional derivative into the NumPy array `result`; return the status."""
        kind = ctypes.CFUNCTYPE(_STATUS, _PLACE, _PLACE, _COUNT, _PLACE, _COUNT, _PLACE, _PLACE)
        status: int = kind(self.address("directional"))(
            component,
            unknowns.ctypes.data,
            len(unknowns),
            knowns.ctypes.data,
            len(knowns),
            seed.ctypes.data,
            result.ctypes.data,
        )
        return status


class ModelLibrary3(Bound, Library3):
    """A binary of FMI 3 as a model exchange FMU."""

    names = {  # noqa: RUF012 - never changed
        "set_time": "fmi3SetTime",
        "enter_event_mode": "fmi3EnterEventMode",
        "enter_continuous_mode": "fmi3EnterContinuousTimeMode",
        "set_states": "fmi3SetContinuousStates",
        "get_states": "fmi3GetContinuousStates",
        "get_derivatives": "fmi3GetContinuousStateDerivatives",
        "get_indicators": "fmi3GetEventIndicators",
        "get_nominals": "fmi3GetNominalsOfContinuousStates",
        "completed_step": "fmi3CompletedIntegratorStep",
        "update_discrete": "fmi3UpdateDiscreteStates",
        "directional": "fmi3GetDirectionalDerivative",
    }

    def create(self, name: str, messages: Messages) -> tuple[int, Any]:
        """See `bayesftc.cosim.fmi.binaries.library.Library.create`."""
        callback = callback3()
        resources = os.path.join(self._slave.unzipDirectory, "resources") + os.path.sep
        component = self.call(
            "fmi3InstantiateModelExchange",
            name.encode(),
            self.description.token.encode(),
            resources.encode(),
            False,
            True,
            messages.key,
            callback,
        )
        if component:
            self._narrow_log("fmi3SetDebugLogging", component)
        return component or 0, callback

    @cached_property
    def update_discrete(self) -> Callable[[int, Any], int]:
        """See `ModelLibrary2.update_discrete`."""
        kind = ctypes.CFUNCTYPE(_STATUS, *[_PLACE] * 7)
        function = kind(self.address("update_discrete"))
        offsets = [getattr(EventInfo3, name).offset for name, _ in EventInfo3._fields_]

        def update(component: int, info: EventInfo3) -> int:
            start = ctypes.addressof(info)
            return int(function(component, *(start + offset for offset in offsets)))

        return update

    event_info = EventInfo3

    def size(self, component: int, what: str, declared: int) -> int:
        """Return the number of states or event indicators, which structural parameters may have changed."""
        count = ctypes.c_size_t(declared)
        function = {"states": "fmi3GetNumberOfContinuousStates", "indicators": "fmi3GetNumberOfEventIndicators"}[what]
        try:
            self.call(function, component, ctypes.byref(count))
        except CallError:
            return declared
        return count.value

    def directional(self, component: int, unknowns: Any, knowns: Any, seed: Any, result: Any) -> int:
        """See `ModelLibrary2.directional`."""
        kind = ctypes.CFUNCTYPE(_STATUS, _PLACE, *[_PLACE, _COUNT] * 4)
        status: int = kind(self.address("directional"))(
            component,
            unknowns.ctypes.data,
            len(unknowns),
            knowns.ctypes.data,
            len(knowns),
            seed.ctypes.data,
            len(seed),
            result.ctypes.data,
            len(result),
        )
        return status


ModelLibrary = ModelLibrary1 | ModelLibrary2 | ModelLibrary3


def load_model(archive: Archive, description: FMUDescription) -> ModelLibrary:
    """Unpack an FMU and load its binary for model exchange, both only once.

    Raises
    ------
    FMUError
        If there is no binary for this platform, or it cannot be loaded.
    """
    exchange = description.exchange
    assert exchange is not None
    capabilities = dict(description.capabilities) | {
        "canGetAndSetFMUstate": exchange.can_save,
        "canSerializeFMUstate": exchange.can_serialise,
        "canBeInstantiatedOnlyOncePerProcess": exchange.once,
    }
    local_description = replace(description, identifier=exchange.identifier, capabilities=capabilities)
    library = load_library(archive, local_description, exchange=True)
    assert isinstance(library, ModelLibrary)
    return library
