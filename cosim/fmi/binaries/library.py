"""The binary of an FMU: its functions, bound by fmpy."""

from __future__ import annotations

import ctypes
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.addresses import Addresses
from bayesftc.cosim.fmi.binaries.codes import HAS_TERMINATED, LAST_TIME
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable, Value, flattened
from bayesftc.cosim.fmi.reading.embedded import in_this_python
from bayesftc.cosim.fmi.reading.messages import ENDS, Messages, callback3, callbacks2, status_word

_STATUS_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")

C_TYPES: dict[str, Any] = {
    "Real": ctypes.c_double,
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "Integer": ctypes.c_int,
    "Int8": ctypes.c_int8,
    "UInt8": ctypes.c_uint8,
    "Int16": ctypes.c_int16,
    "UInt16": ctypes.c_uint16,
    "Int32": ctypes.c_int32,
    "UInt32": ctypes.c_uint32,
    "Int64": ctypes.c_int64,
    "UInt64": ctypes.c_uint64,
    "String": ctypes.c_char_p,
}


class CallError(Exception):
    """A call of an FMI function that did not return OK or Warning."""

    def __init__(self, function: str, status: int):
        super().__init__(function, status)
        self.function, self.status = function, status

    def __str__(self) -> str:
        """Return the function and its status in FMI's terms."""
        return f"{self.function} returned {status_word(self.status)}"


@dataclass(frozen=True)
class Beginning:
    """The values for the initialization of an instance.

    Attributes
    ----------
    start : mapping
        Start values.
    inputs : mapping
        The variables that are set during the run (inputs and tunable parameters), with their start values; None for values
        that only the FMU has.
    tolerance : float
        Tolerance that is passed to the FMU; 0 for none.
    """

    start: Mapping[FMUVariable, Value]
    inputs: Mapping[FMUVariable, Value | None]
    tolerance: float = 0.0

    @property
    def before(self) -> dict[FMUVariable, Value]:
        """The values to set before initialization mode."""
        return {v: value for v, value in self.start.items() if v.causality != "input"}

    @property
    def known(self) -> dict[FMUVariable, Value]:
        """The inputs whose values are known."""
        return {v: value for v, value in self.inputs.items() if value is not None}

    @property
    def during(self) -> dict[FMUVariable, Value]:
        """The values to set in initialization mode: inputs, also those that are no ports."""
        return {v: value for v, value in self.start.items() if v.causality == "input"} | self.known


class Library(ABC):
    """The loaded binary of one FMU; the parts that FMI 2 and 3 have in common.

    Several instances may exist at a time. fmpy's ``freeInstance`` would unload the binary while other instances use it. So
    instances are created and freed by the bound C functions, and the binary stays loaded until the process ends.
    """

    #: Names of the functions of saved states: get, set, free.
    state_functions: tuple[str, str, str]
    #: Names of the functions that serialise them: number of bytes, to bytes, from bytes.
    serial_functions: tuple[str, str, str]
    #: fmpy's type of these bytes.
    byte: Any

    def __init__(self, description: FMUDescription, slave: Any, keep: Any):
        self.description = description
        from fmpy.fmi1 import FMICallException

        self._slave = slave
        self._refused = FMICallException  # imported here: instances that are freed as Python ends cannot import
        self._keep = keep  # a second handle: the binary stays loaded even if fmpy's handle is closed
        self.alive = 0
        self._addresses: dict[str, int] = {}

    def function_address(self, name: str) -> int:
        """Return the address of an FMI function."""
        if name not in self._addresses:
            self._addresses[name] = ctypes.cast(getattr(self._slave.dll, name), ctypes.c_void_p).value or 0
        return self._addresses[name]

    @cached_property
    def state_addresses(self) -> tuple[int, int, int]:
        """Addresses of the functions of saved states."""
        save, restore, free = (self.function_address(name) for name in self.state_functions)
        return save, restore, free

    @abstractmethod
    def step_addresses(self) -> Addresses:
        """Return the addresses of the functions that a step of co-simulation may call."""

    def begin(self, name: str, messages: Messages) -> tuple[int, Any]:
        """Return a new instance and the objects that must be kept with it; a Python model uses its own Python files.

        Raises
        ------
        FMUError
            If instantiation fails.
        """
        model, capabilities = self.description.name, self.description.capabilities
        if self.alive and capabilities.get("canBeInstantiatedOnlyOncePerProcess"):
            raise FMUError(
                f"{name!r} cannot be a second instance of the FMU {model!r}, which allows one instance per process. Run them one "
                "after the other, or each in a separate process with FMU(..., isolate=True)."
            )
        with in_this_python(Path(self._slave.unzipDirectory, "resources"), self._keep):
            component, kept = self.create(name, messages)
        if not component:
            tool = self.description.generation_tool or "the tool that exported it"
            needs = (
                f"It needs {tool} to run (needsExecutionTool): install it here, or export the FMU without that need."
                if capabilities.get("needsExecutionTool")
                else "If it needs a tool or a licence, check that it is available."
            )
            raise FMUError(f"The FMU {model!r} could not be instantiated as {name!r}. {needs} {messages.quoted()}")
        self.alive += 1
        return component, kept

    @abstractmethod
    def create(self, name: str, messages: Messages) -> tuple[int, Any]:
        """Return a new instance (0 if instantiation fails) and the objects that must be kept with it."""

    @abstractmethod
    def initialize(
        self, component: int, beginning: Beginning, time: float = 0.0, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """Set the start values and initialize an instance, up to the first step.

        `time` is the start time. `meanwhile` is called in initialization mode, after all values are set.
        """

    @abstractmethod
    def terminate(self, component: int) -> None:
        """Terminate a healthy instance."""

    @abstractmethod
    def free(self, component: int) -> None:
        """Free an instance."""

    def release(self, component: int, forget_states: Callable[[], None], *, healthy: bool, fatal: bool) -> None:
        """Terminate and free an instance; errors are ignored.

        Parameters
        ----------
        component : int
            The instance.
        forget_states : callable
            Frees its saved states.
        healthy : bool
            Whether the standard allows to terminate it.
        fatal : bool
            Whether it has returned Fatal, after which the standard allows no call.
        """
        self.alive -= 1
        with suppress(CallError, FMUError):
            forget_states()
            if healthy:
                self.terminate(component)
            if not fatal:
                self.free(component)

    def discard_details(self, component: int) -> tuple[str, bool]:
        """Return details of a discarded step, as a sentence or nothing, and whether the FMU ends the simulation."""
        return "", False

    def _how_far(self, function: str, component: int) -> tuple[str, bool]:
        """Return how far a discarded step has come, as `discard_details`, by this function of FMI 1 or 2."""
        reached = ctypes.c_double(0.0)
        try:
            self.call(function, component, LAST_TIME, ctypes.byref(reached))
        except CallError:
            return "", False
        return f"It computed the step up to t = {reached.value:g} s. Try a smaller step.", False

    def call(self, function: str, *arguments: Any) -> Any:
        """Call an FMI function through fmpy.

        Raises
        ------
        CallError
            If it returns neither OK nor Warning.
        """
        try:
            return getattr(self._slave, function)(*arguments)
        except self._refused as error:
            raise CallError(function, int(error.status)) from None

    def set_values(self, component: int, values: dict[FMUVariable, Value]) -> None:
        """Set variables of any type, one at a time, so that an error names the variable."""
        for variable, value in values.items():
            function, c_type = self._setter(variable.type)
            reference = (ctypes.c_uint * 1)(variable.reference)
            flat = [v.encode() if isinstance(v, str) else -v if variable.negated else v for v in flattened(value)]
            array = (c_type * len(flat))(*flat)
            try:
                self._set(function, component, reference, array)
            except CallError as error:
                raise CallError(f"{error.function} of {variable.name!r}", error.status) from None

    @abstractmethod
    def _setter(self, kind: str) -> tuple[str, Any]: ...

    @abstractmethod
    def _set(self, function: str, component: int, reference: Any, array: Any) -> None: ...

    def _narrow_log(self, function: str, component: int) -> None:
        # All messages are logged during instantiation, so that a failure has its reason. Afterwards only problems are logged:
        # a message costs more than a thousand steps.
        categories = [c.encode() for c in _STATUS_CATEGORIES if c in self.description.log_categories]
        if (self.description.generation_tool or "").startswith("PythonFMU"):
            categories = [b""]  # it declares categories, but its errors belong to none of them
        with suppress(CallError):  # then it logs more or less than requested, which is harmless
            self.call(
                function, component, bool(categories), len(categories), (ctypes.c_char_p * len(categories))(*categories)
            )


class Library2(Library):
    """A binary of FMI 2."""

    #: fmi2Type: co-simulation here.
    interface = 1
    state_functions = ("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate")
    serial_functions = ("fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate", "fmi2DeSerializeFMUstate")
    byte = ctypes.c_char

    @cached_property
    def _resources(self) -> bytes:
        return Path(self._slave.unzipDirectory, "resources").as_uri().encode()

    def create(self, name: str, messages: Messages) -> tuple[int, Any]:
        """See `Library.create`."""
        callbacks = callbacks2(messages)
        token = self.description.token.encode()
        component = self.call(
            "fmi2Instantiate", name.encode(), self.interface, token, self._resources, ctypes.byref(callbacks), 0, 1
        )
        if component:
            self._narrow_log("fmi2SetDebugLogging", component)
        return component or 0, callbacks

    def initialize(
        self, component: int, beginning: Beginning, time: float = 0.0, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """See `Library.initialize`."""
        tolerance = beginning.tolerance
        self.call("fmi2SetupExperiment", component, int(tolerance > 0.0), tolerance, time, 0, 0.0)
        self.set_values(component, beginning.before)
        self.call("fmi2EnterInitializationMode", component)
        self.set_values(component, beginning.during)
        meanwhile()
        self.call("fmi2ExitInitializationMode", component)

    def step_addresses(self) -> Addresses:
        """See `Library.step_addresses`."""
        status_functions: tuple[int, ...] = ()
        if self.description.capabilities.get("canHandleVariableCommunicationStepSize"):
            status_functions = self.function_address("fmi2GetRealStatus"), self.function_address("fmi2GetBooleanStatus")
        return Addresses(self.function_address("fmi2DoStep"), *status_functions)

    def terminate(self, component: int) -> None:
        """See `Library.terminate`."""
        self.call("fmi2Terminate", component)

    def free(self, component: int) -> None:
        """See `Library.free`."""
        self.call("fmi2FreeInstance", component)

    def discard_details(self, component: int) -> tuple[str, bool]:
        """See `Library.discard_details`."""
        ended = ctypes.c_int(0)
        try:
            self.call("fmi2GetBooleanStatus", component, HAS_TERMINATED, ctypes.byref(ended))
        except CallError:
            return "", False
        return (f"{ENDS} (terminated).", True) if ended.value else self._how_far("fmi2GetRealStatus", component)

    def _setter(self, kind: str) -> tuple[str, Any]:
        name = "Integer" if kind == "Enumeration" else kind
        return f"fmi2Set{name}", ctypes.c_int if kind == "Boolean" else C_TYPES[name]

    def _set(self, function: str, component: int, reference: Any, array: Any) -> None:
        self.call(function, component, reference, 1, array)


class Library3(Library):
    """A binary of FMI 3."""

    state_functions = ("fmi3GetFMUState", "fmi3SetFMUState", "fmi3FreeFMUState")
    serial_functions = ("fmi3SerializedFMUStateSize", "fmi3SerializeFMUState", "fmi3DeserializeFMUState")
    byte = ctypes.c_ubyte

    def create(self, name: str, messages: Messages) -> tuple[int, Any]:
        """See `Library.create`."""
        from fmpy.fmi3 import fmi3IntermediateUpdateCallback

        callback = callback3()
        resources = os.path.join(self._slave.unzipDirectory, "resources") + os.path.sep
        token = self.description.token.encode()
        component = self.call(
            "fmi3InstantiateCoSimulation",
            name.encode(),
            token,
            resources.encode(),
            False,
            True,
            self._events,
            self._events or self._may_return_early,
            (ctypes.c_uint * 0)(),
            0,
            messages.key,
            callback,
            fmi3IntermediateUpdateCallback(),
        )
        if component:
            self._narrow_log("fmi3SetDebugLogging", component)
        return component or 0, callback

    def initialize(
        self, component: int, beginning: Beginning, time: float = 0.0, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """See `Library.initialize`."""
        before, tolerance = beginning.before, beginning.tolerance
        structure = {v: value for v, value in before.items() if v.causality == "structuralParameter"}
        if structure:
            self.call("fmi3EnterConfigurationMode", component)
            self.set_values(component, structure)
            self.call("fmi3ExitConfigurationMode", component)
        self.set_values(component, {v: value for v, value in before.items() if v not in structure})
        self.call("fmi3EnterInitializationMode", component, tolerance > 0.0, tolerance, time, False, 0.0)
        self.set_values(component, beginning.during)
        meanwhile()
        self.call("fmi3ExitInitializationMode", component)

    @property
    def _events(self) -> bool:
        return bool(self.description.capabilities.get("hasEventMode"))

    @property
    def _may_return_early(self) -> bool:
        return bool(self.description.capabilities.get("mightReturnEarlyFromDoStep"))

    def step_addresses(self) -> Addresses:
        """See `Library.step_addresses`."""
        names = ["fmi3DoStep"]
        if self._events:
            names += ["fmi3EnterEventMode", "fmi3UpdateDiscreteStates", "fmi3EnterStepMode"]
        do_step, *events = (self.function_address(name) for name in names)
        return Addresses(do_step, 0, 0, *events)

    def terminate(self, component: int) -> None:
        """See `Library.terminate`."""
        self.call("fmi3Terminate", component)

    def free(self, component: int) -> None:
        """See `Library.free`."""
        self.call("fmi3FreeInstance", component)

    def discard_details(self, component: int) -> tuple[str, bool]:
        """See `Library.discard_details`."""
        return "It has made no progress. Try a smaller step.", False

    def _setter(self, kind: str) -> tuple[str, Any]:
        name = "Int64" if kind == "Enumeration" else kind
        return f"fmi3Set{name}", ctypes.c_bool if kind == "Boolean" else C_TYPES[name]

    def _set(self, function: str, component: int, reference: Any, array: Any) -> None:
        self.call(function, component, reference, 1, array, len(array))
