"""A running instance of an FMU: made, initialized, explained and freed."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Literal

import numpy as np

from bayesftc.cosim._fmi_description import FMUVariable, Value
from bayesftc.cosim._fmi_library import CallError, Library
from bayesftc.cosim._fmi_messages import STATUS, Messages
from bayesftc.cosim._fmi_states import SavedState, States
from bayesftc.cosim._fmi_steps import DISCARD, EARLY, FATAL, GET, SET, STEP, TERMINATED, StepFunctions
from bayesftc.cosim.errors import FMUError


class Instance(StepFunctions):
    """An initialized FMU instance; see `bayesftc.cosim.block.External`.

    Raises
    ------
    FMUError
        If the FMU refuses to be instantiated or initialized.
    """

    def __init__(
        self,
        library: Library,
        name: str,
        step: Fraction,
        timing: Literal["plant", "sampled"],
        start: dict[FMUVariable, Value],
        inputs: dict[FMUVariable, Value],
        outputs: Sequence[FMUVariable],
    ):
        self._library, self._name = library, name
        self._messages = Messages(name)
        self._component, self._healthy, self._fatal = 0, True, False
        try:
            self._start(start, inputs)
        except BaseException:
            self._healthy = False
            self.close()
            raise
        super().__init__(
            library.description.fmi_major,
            library.addresses,
            self._component,
            [v.reference for v in inputs],
            [v.reference for v in outputs],
            float(step),
            timing,
        )

    def _start(self, start: dict[FMUVariable, Value], inputs: dict[FMUVariable, Value]) -> None:
        library, name = self._library, self._name
        model = library.description.name
        if library.alive and library.description.capabilities.get("canBeInstantiatedOnlyOncePerProcess"):
            raise FMUError(
                f"{name!r} cannot be a second instance of the FMU {model!r}, which allows only one in a process; run one "
                "after the other, or in separate processes."
            )
        component, self._callbacks = library.create(name, self._messages)
        if not component:
            raise FMUError(
                f"The FMU {model!r} refused to be instantiated as {name!r}. {self._messages.quoted()} If it needs a tool or "
                "a licence, check that it is there."
            )
        self._component = component
        library.alive += 1
        self._states = States(library, component, name)
        try:
            library.initialize(component, start, inputs)
        except CallError as error:
            self._fatal = error.status == FATAL
            raise FMUError(
                f"The FMU {model!r} could not be initialized as {name!r}: {error.sentence()}. {self._messages.quoted()} Check "
                "its parameters and start values."
            ) from None

    @property
    def can_save(self) -> bool:
        """See `bayesftc.cosim.block.External.can_save`."""
        return self._states.can_save

    def save(self) -> SavedState:
        """See `bayesftc.cosim.block.External.save`."""
        return self._states.save()

    def restore(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.restore`."""
        self._states.restore(saved)
        self._healthy = not self._fatal  # an FMU that has failed may be put back to where it had not

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        self._states.forget(saved)

    def explain(self, status: int) -> str:
        """Return what a status means in FMI's words, with the instance's last messages."""
        self._healthy = False
        if status == TERMINATED:
            return f"The FMU asks to end the simulation (terminateSimulation). {self._messages.quoted()}"
        if status == EARLY:
            reached = self._scratch.view(np.float64)[3]
            return (
                f"The FMU returned early from fmi3DoStep, at t = {reached:g} s, before the end of the step, which was "
                f"not allowed; a smaller step may do. {self._messages.quoted()}"
            )
        where, code = status // 100 * 100, status % 100
        get, set_, step = self._library.step_functions
        function = {GET: get, SET: set_, STEP: step}.get(where, "An FMI function")
        word = STATUS[code] if code < len(STATUS) else str(code)
        self._fatal = code == FATAL
        more = self._library.last_words(self._component) if where == STEP and code == DISCARD else ""
        return " ".join(s for s in (f"{function} returned {word}.", more, self._messages.quoted()) if s)

    def close(self) -> None:
        """Free the instance; the binary stays loaded."""
        component, self._component = self._component, 0
        if component:
            self._library.alive -= 1
            try:
                self._states.close(free=not self._fatal)
                if self._healthy:
                    self._library.terminate(component)
                if not self._fatal:  # after Fatal the standard allows no call at all
                    self._library.free(component)
            except (CallError, FMUError):
                pass  # it is over either way, and the results stand
        self._messages.close()
