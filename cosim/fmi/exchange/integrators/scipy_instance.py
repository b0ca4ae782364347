"""Running model exchange FMUs with an integrator of scipy, which is Python: compiled code calls back."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from bayesftc.cosim.base.timebase import step_at
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.integrators.instance import ExchangeInstance, Timing
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.reasons import endless_events, too_many_events
from bayesftc.cosim.fmi.running.port_values import EndError, StopError
from bayesftc.cosim.stepping.callbacks import Callback
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
        arguments = model.sizes, self.resize, self.step_word, INTERRUPTED
        self._callbacks = [Callback(function, *arguments) for function in (self.output, self.update)]

    @property
    def output_address(self) -> int:
        """Address of a callback of `output`."""
        return self._callbacks[0].address

    @property
    def update_address(self) -> int:
        """Address of a callback of `update`; 0 where all is done in the output function."""
        return 0 if self._timing == "sampled" else self._callbacks[1].address

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

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`; of a sampled one, all is done in `output`."""
        if self._timing == "sampled":
            return 0
        try:
            self._advance(inputs, t)
        except (StopError, CallError) as error:
            return self._stop(error)
        return 0

    def _stop(self, error: StopError | CallError) -> int:
        self._reason = str(error)
        self._has_ended = isinstance(error, EndError)
        return words.STOPPED

    @property
    def has_ended(self) -> bool:
        """See `bayesftc.cosim.block.External.has_ended`."""
        return self._has_ended

    def _why(self) -> str:
        for raised in [callback.taken() for callback in self._callbacks]:
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
