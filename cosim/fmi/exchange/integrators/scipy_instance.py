"""Running model exchange FMUs with an integrator of scipy, which is Python: compiled code calls back."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from bayesftc.cosim.base.timebase import step_at
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.integrators.instance import ENTRY, ExchangeInstance, Timing
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.port_values import EndError, StopError
from bayesftc.cosim.fmi.exchange.reasons import endless_events, too_many_events
from bayesftc.cosim.types import Floats

INTERRUPTED = 902  # as in bayesftc.cosim.isolation.protocol
"""Status: Python raised something, which the instance keeps until it is asked."""


class ScipyInstance(ExchangeInstance):
    """One with an integrator of scipy, which is Python: compiled code calls back.

    Parameters
    ----------
    model, step, timing
        See `ExchangeInstance`.
    solver : ScipySolver
        The integrator.
    """

    def __init__(self, model: ExchangeModel, step: Fraction, timing: Timing, solver: Any):
        super().__init__(model, step, timing)
        self._solver, self._reason, self._has_ended = solver, "", False
        self._raised: BaseException | None = None
        self._views: dict[tuple[int, int], Floats] = {}

    @property
    def output_address(self) -> int:
        """Address of a callback of `output`."""
        return ctypes.cast(self._entries[0], ctypes.c_void_p).value or 0

    @property
    def update_address(self) -> int:
        """Address of a callback of `update`; 0 where all is done in the output function."""
        return 0 if self._timing == "sampled" else ctypes.cast(self._entries[1], ctypes.c_void_p).value or 0

    @cached_property
    def _entries(self) -> tuple[Any, Any]:
        return ENTRY(self._entry(self.output)), ENTRY(self._entry(self.update))

    def _entry(self, function: Callable[[Floats, Floats, float], int]) -> Callable[..., int]:
        sizes, view = self._model.sizes, self._view

        def entry(state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
            try:
                self.resize(ctypes.c_double.from_address(parameters + 8 * words.STEP_WORD).value)
                return function(view(inputs, sizes[0]), view(outputs, sizes[1]), t)
            except BaseException as error:  # noqa: BLE001 - C code has no way for it; `explain` raises it
                self._raised = error
                return INTERRUPTED

        return entry

    def _view(self, address: int, size: int) -> Floats:
        key = address, size
        if key not in self._views:
            self._views[key] = np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))
        return self._views[key]

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        try:
            if self._timing == "direct":
                self._take(inputs)
            elif self._timing == "sampled":
                self._advance(inputs, t)
            self._model.read_outputs(outputs)
        except (StopError, CallError) as error:
            return self._stop(error)
        return 0

    def _update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        try:
            self._advance(inputs, t)
        except (StopError, CallError) as error:
            return self._stop(error)
        return 0

    def _stop(self, error: StopError | CallError) -> int:
        self._reason = error.sentence() if isinstance(error, CallError) else str(error)
        self._has_ended = isinstance(error, EndError)
        return words.STOPPED

    @property
    def has_ended(self) -> bool:
        """See `bayesftc.cosim.block.External.has_ended`."""
        return self._has_ended

    def _why(self) -> str:
        raised, self._raised = self._raised, None
        if raised is not None:
            raise raised
        return self._reason

    def _set_tolerances(self) -> None:
        self._solver.set_tolerances()

    def _take(self, inputs: Floats) -> None:
        """Let the inputs jump to what they are now, which is an event."""
        if inputs.tobytes() != self._model.inputs.tobytes():
            self._event(inputs)

    def _event(self, inputs: Floats | None = None) -> None:
        if self._model.event(inputs):
            self._set_tolerances()

    def _advance(self, inputs: Floats, t: float) -> None:
        """Take the FMU from `t` to the next communication point, from event to event, as the compiled functions do."""
        self._take(inputs)
        model, h = self._model, float(self.table.view(np.float64)[words.STEP_WORD])
        end = t + h
        point = (step_at(t, self._step) + 1) * self._step.numerator / self._step.denominator
        if abs(end - point) <= words.SAME * h:
            end = point
        near = words.NEAR * max(abs(end), h)
        quiet, before = 0, model.time
        for _ in range(words.MOST_EVENTS):
            timed = model.next_event <= end + near
            target = model.next_event if timed else end
            event = False
            if target <= model.time + near:  # too near to integrate, or in the past
                if not timed:
                    return
                if target > model.time:
                    model.set_time(target)
            else:
                event = self._solver.integrate(model.time, target)
            if not event and not timed:
                return
            self._event()
            quiet = quiet + 1 if model.time - before <= words.QUIET_STEP * h + words.QUIET * abs(end) else 0
            before = model.time
            if quiet >= words.QUIET_EVENTS:
                raise StopError(endless_events(model))
        raise StopError(too_many_events(model))
