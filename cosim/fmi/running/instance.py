"""A running instance of an FMU: instantiation, initialization, error messages, and end."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from fractions import Fraction
from math import inf, isfinite
from typing import Any, Literal, cast

import numpy as np

from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.errors import FMUError, StepSizeError
from bayesftc.cosim.fmi.binaries.codes import (
    DISCARD,
    EARLY,
    ENDLESS,
    EVENTS,
    FATAL,
    GET,
    NEXT_DEFINED,
    NEXT_TIME,
    PENDING,
    REACHED,
    SET,
    STEP,
    TERMINATED,
    TRIES,
    UNFIT,
    UNFIT_INPUT,
    UNFIT_OUTPUT,
    UPDATE,
    UPDATE_TERMINATE,
    decoded,
    failed,
)
from bayesftc.cosim.fmi.binaries.groups import Group
from bayesftc.cosim.fmi.binaries.library import Beginning, CallError, Library
from bayesftc.cosim.fmi.reading.description import FMUDescription, FMUVariable
from bayesftc.cosim.fmi.reading.messages import ENDS, Messages, status_word
from bayesftc.cosim.fmi.reading.versions import prefix
from bayesftc.cosim.fmi.running.own_inputs import own_inputs
from bayesftc.cosim.fmi.running.port_values import PortValues, StopError
from bayesftc.cosim.fmi.running.states import SavedState, States
from bayesftc.cosim.fmi.running.steps import StepFunctions
from bayesftc.cosim.fmi.running.written import check_written
from bayesftc.cosim.types import Floats

_ANY_STEP = "canHandleVariableCommunicationStepSize"

_MODE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)
_UPDATE = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 7)


class Instance(StepFunctions):
    """An initialized FMU instance; see `bayesftc.cosim.block.External`.

    Raises
    ------
    FMUError
        If the FMU's instantiation or initialization fails.
    """

    def __init__(
        self,
        library: Library,
        name: str,
        step: Fraction,
        timing: Literal["plant", "sampled"],
        beginning: Beginning,
        outputs: Sequence[FMUVariable],
    ):
        _check_step(library, name, step)
        self._library, self._name = library, name
        self._messages = Messages(name)
        self._component, self._healthy, self._fatal = 0, True, False
        self.has_ended = False
        major, addresses = library.description.fmi_major, library.step_addresses()
        inputs = list(beginning.inputs)
        self._ports = PortValues(library, inputs, outputs, events=addresses.enter_event_mode != 0)
        input_groups, output_groups = self._arranged(self._ports.groups)
        try:
            self._start(beginning)
            self.own_inputs = own_inputs(library, self._component, beginning.inputs)
        except BaseException:
            self._healthy = False
            self.close()
            raise
        super().__init__(major, addresses, self._component, input_groups, output_groups, step, timing, self._cut())
        self.rounding = self._ports.rounding
        if addresses.enter_event_mode:
            self._first_events()
        try:
            check_written(library.description.name, name, self._component, self._ports, self._read)
        except FMUError:
            self.close()
            raise

    def _start(self, beginning: Beginning) -> None:
        library, name = self._library, self._name
        model = library.description.name
        component, self._callbacks = library.begin(name, self._messages)
        self._component = component
        self._states = States(library, component, name)
        try:
            library.initialize(component, beginning, meanwhile=self._initializing)
        except (CallError, StopError) as error:
            self._fatal = isinstance(error, CallError) and error.status == FATAL
            raise FMUError(
                f"The FMU {model!r} could not be initialized as {name!r}: {error}. Check its "
                f"parameters and start values. {self._messages.quoted()}"
            ) from None

    def _arranged(self, sides: tuple[list[Group], list[Group]]) -> tuple[list[Group], list[Group]]:
        """Return the inputs and outputs that are set and read at communication points."""
        return sides

    def _initializing(self) -> None:
        """Do further work in initialization mode (for subclasses)."""

    def _cut(self) -> float:
        """Return the size of the parts into which a step may be cut; see `StepFunctions`."""
        return _fixed_size(self._library) if self.can_resize else inf

    def _first_events(self) -> None:
        """Leave the event mode in which initialization ends."""
        status = self._settle(0.0)
        if status:
            what = self.explain(status)
            self.close()
            raise FMUError(
                f"The FMU {self._library.description.name!r} could not be initialized as {self._name!r}: {what}"
            )

    def _settle(self, now: float) -> int:
        """Update the discrete states in event mode until they no longer change, then return to step mode.

        Within steps, compiled code does this (`kernels.settle3`); it calls this function for FMUs with clocks.
        """
        scratch, a = self._scratch, self._addresses
        update, leave = _UPDATE(a.update_discrete), _MODE(a.enter_step_mode)
        places = [scratch.ctypes.data + 8 * i for i in range(UPDATE, UPDATE + 6)]
        for _ in range(TRIES):
            self._tick(now)
            status = failed(EVENTS, update(self._component, *places))
            if status:
                return status
            if scratch[UPDATE_TERMINATE]:
                return TERMINATED
            if not self._still_ticks(now) and not scratch[UPDATE]:
                return failed(EVENTS, leave(self._component))
        return ENDLESS

    def _tick(self, now: float) -> None:
        """Activate the clocks that are due."""

    def _still_ticks(self, now: float) -> bool:
        """Return whether more clocks are due."""
        return False

    def _read(self, outputs: Floats) -> None:
        """Read the outputs through guarded memory."""
        for group in self._groups[1]:
            self._ports.take(self._component, group, outputs)

    @property
    def can_save(self) -> bool:
        """See `bayesftc.cosim.block.External.can_save`."""
        return self._states.can_save

    @property
    def can_resize(self) -> bool:
        """Whether steps may have any size."""
        return bool(self._library.description.capabilities.get(_ANY_STEP))

    @property
    def state_functions(self) -> tuple[int, int, int, int] | None:
        """Addresses of the instance and of FMI's functions that save, restore and free a state, for compiled code.

        None if calling these functions is not enough.
        """
        if self._addresses.enter_event_mode or not self.can_save:
            return None
        save, restore, free = self._library.state_addresses
        return self._component, save, restore, free

    def save(self) -> SavedState:
        """See `bayesftc.cosim.block.External.save`."""
        self.expect_return()
        saved = self._states.save()
        saved.beside = self._beside()
        return saved

    def restore(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.restore`."""
        if self._fatal:
            raise FMUError(
                f"The FMU {self._library.description.name!r} ({self._name!r}) has returned Fatal, or Pending. After that FMI "
                "allows no further calls. Start a new run with reset()."
            )
        self.expect_return()
        self._states.restore(saved)
        self._put_beside(cast("SavedState", saved).beside)
        self._healthy = True  # the restored state precedes the failure

    def _beside(self) -> tuple[Any, ...]:
        """Return what is saved beside the FMU's own state: the time of its next event."""
        return (float(self._scratch.view(np.float64)[NEXT_TIME]) if self._scratch[NEXT_DEFINED] else inf,)

    def _put_beside(self, values: tuple[Any, ...]) -> None:
        next_event = values[0] if values else inf
        self._scratch[NEXT_DEFINED] = next_event < inf
        self._scratch.view(np.float64)[NEXT_TIME] = next_event

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        self._states.forget(saved)

    def explain(self, status: int) -> str:
        """Return the meaning of a status in FMI's terms, with the instance's last messages."""
        where, code = decoded(status)
        self._healthy = 0 <= code <= DISCARD  # after an error FMI forbids to terminate it
        self.has_ended = status == TERMINATED
        if self.has_ended:
            return f"{ENDS} (terminateSimulation). {self._messages.quoted()}"
        log = self._messages.quoted()
        reached = self._scratch.view(np.float64)[REACHED]
        if status == EARLY:
            return (
                f"The FMU returned early from fmi3DoStep, at t = {reached:g} s, before the end of the step, and does not "
                f"continue. Try a smaller step. {log}"
            )
        if status == ENDLESS:
            return f"The FMU did not complete the step, or an event, in {TRIES} calls. {log}"
        if status in {UNFIT_INPUT, UNFIT_OUTPUT}:
            return f"{self._ports.misfit(int(self._scratch[UNFIT]), is_input=status == UNFIT_INPUT)}."
        names = {
            GET: self._called(1),
            SET: self._called(0),
            STEP: f"{prefix(self._major)}DoStep",
            EVENTS: "An FMI function of event mode",
        }
        function = names.get(where, "An FMI function")
        self._fatal = code in {FATAL, PENDING}
        more = ""
        if code == PENDING:
            more = "Asynchronous steps are not supported. Export the FMU so that a step ends before the call returns."
        if code == DISCARD:
            if where != STEP:
                more = "It does not accept this value."
            else:
                more, self.has_ended = self._library.discard_details(self._component)
            if self.has_ended:
                return f"{more} {log}"
        return " ".join(s for s in (f"{function} returned {status_word(code)}.", more, log) if s)

    def _called(self, side: int) -> str:
        """Return which function has failed, and for which variables."""
        if self._plain:
            return self._groups[side][0].name if self._groups[side] else "An FMI function"
        return self._ports.function_of(int(self._scratch[UNFIT]), is_input=side == 0)

    def close(self) -> None:
        """Free the instance; the binary stays loaded."""
        component, self._component = self._component, 0
        if component:
            self._library.release(
                component,
                lambda: self._states.close(free=not self._fatal),
                healthy=self._healthy,
                fatal=self._fatal,
            )
        self._messages.close()


def _fixed_size(library: Library) -> float:
    """Return the fixed internal step size, of which steps must be multiples; 0 if there is none."""
    try:
        size = float(library.description.capabilities.get("fixedInternalStepSize") or 0.0)
    except ValueError:  # the description is not validated
        return 0.0
    return size if isfinite(size) and size > 1e-300 else 0.0


def only_step(description: FMUDescription) -> Fraction | None:
    """Return the only step size of an FMU that this package exported from a diagram, in seconds; None of other FMUs."""
    own = description.default_experiment.get("stepSize")
    if description.generation_tool != "bayesftc" or not own or description.capabilities.get(_ANY_STEP):
        return None
    return rational_step(own)


def _check_step(library: Library, name: str, step: Fraction) -> None:
    only = only_step(library.description)
    if only is not None and abs(step - only) > 1e-9 * only:
        whole = step > only and (step / only).denominator == 1
        remedy = (
            f"Give the loop dt = {show(only)}, in a scenario below [simulation]. The controller keeps its own sample time."
            if whole
            else f"Choose dt, or every=, so that its step is {show(only)} s."
        )
        raise StepSizeError(
            f"The FMU {library.description.name!r} makes steps of {show(only)} s only, but {name!r} has steps of {show(step)} s. "
            f"{remedy}"
        )
    size = _fixed_size(library)
    if size and abs(float(step) / size - max(round(float(step) / size), 1)) > 1e-9 * float(step) / size:
        raise StepSizeError(
            f"The FMU {library.description.name!r} makes steps of {size:g} s only (fixedInternalStepSize), but {name!r} has "
            f"steps of {show(step)} s. Choose dt, or every=, so that its step is a whole multiple of {size:g} s."
        )
