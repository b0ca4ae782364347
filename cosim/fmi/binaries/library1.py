"""The binary of an FMU of FMI 1 for co-simulation: its functions are called as those of FMI 2, but have other names."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bayesftc.cosim.fmi.binaries.addresses import Addresses
from bayesftc.cosim.fmi.binaries.library import C_TYPES, Beginning, CallError, Library
from bayesftc.cosim.fmi.reading.description import FMUDescription
from bayesftc.cosim.fmi.reading.messages import Messages, callbacks1

TRUE, FALSE = b"\1", b"\0"

_MIME = b"application/x-fmu-sharedlibrary"


class Library1(Library):
    """A binary of FMI 1.

    The names of its functions begin with the model's name, as ``car_fmiDoStep``. It has other functions where FMI 2 has modes,
    and none for saved states.
    """

    state_functions = ("", "", "")
    serial_functions = ("", "", "")
    byte = ctypes.c_char

    def __init__(self, description: FMUDescription, slave: Any, keep: Any):
        super().__init__(description, slave, keep)
        # fmpy binds some functions as if they returned a string: a status of 3 would be used as its address.
        for name, function in slave._functions.items():
            if function.restype is ctypes.c_char_p and not name.endswith(("GetVersion", "TypesPlatform")):
                function.restype = ctypes.c_int

    def function_address(self, name: str) -> int:
        """See `Library.function_address`."""
        return super().function_address(f"{self.description.identifier}_{name}")

    def call(self, function: str, *arguments: Any) -> Any:
        """See `Library.call`."""
        try:
            return super().call(function.replace("fmi", "fmi1", 1), *arguments)
        except CallError as error:
            raise CallError(function, error.status) from None

    def create(self, name: str, messages: Messages) -> tuple[int, Any]:
        """See `Library.create`."""
        callbacks = callbacks1(messages, name)
        component = self._instantiate(name.encode(), callbacks)
        if component:
            messages.add_key(component)
            self.call("fmiSetDebugLogging", component, FALSE)  # as in `_narrow_log`, but FMI 1 has no categories
        return component or 0, callbacks

    def _instantiate(self, name: bytes, callbacks: Any) -> Any:
        where = Path(self._slave.unzipDirectory).as_uri().encode()
        token = self.description.token.encode()
        return self.call("fmiInstantiateSlave", name, token, where, _MIME, 0.0, FALSE, FALSE, callbacks, TRUE)

    def initialize(
        self, component: int, beginning: Beginning, time: float = 0.0, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """See `Library.initialize`."""
        self.set_values(component, {**beginning.start, **beginning.known})
        meanwhile()
        self._initialize(component, beginning.tolerance, time)

    def _initialize(self, component: int, tolerance: float, time: float) -> None:
        self.call("fmiInitializeSlave", component, time, FALSE, 0.0)

    def step_addresses(self) -> Addresses:
        """See `Library.step_addresses`."""
        return Addresses(self.function_address("fmiDoStep"))

    def terminate(self, component: int) -> None:
        """See `Library.terminate`."""
        self.call("fmiTerminateSlave", component)

    def free(self, component: int) -> None:
        """See `Library.free`."""
        self.call("fmiFreeSlaveInstance", component)

    def discard_details(self, component: int) -> tuple[str, bool]:
        """See `Library.discard_details`."""
        return self._how_far("fmiGetRealStatus", component)

    def _setter(self, kind: str) -> tuple[str, Any]:
        name = "Integer" if kind == "Enumeration" else kind
        return f"fmiSet{name}", ctypes.c_char if kind == "Boolean" else C_TYPES[name]

    def _set(self, function: str, component: int, reference: Any, array: Any) -> None:
        self.call(function, component, reference, 1, array)
