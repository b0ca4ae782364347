"""A running model exchange FMU: what the engines call, one communication step of an integrator with all its events."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim._fmi_description import FMUVariable, Value
from bayesftc.cosim._fmi_library import CallError
from bayesftc.cosim._model_exchange_library import ModelLibrary
from bayesftc.cosim._model_exchange_model import ExchangeModel, SavedModel, StopError
from bayesftc.cosim.block import Floats

STOPPED, INTERRUPTED = 501, 502
"""Statuses: the instance knows why it stopped; Python raised something that it keeps."""

QUIET_EVENTS = 100
"""Events one after the other, without time going on between them, that are taken for chattering."""

_EPS = float(np.finfo(np.float64).eps)
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64)


class ExchangeInstance:
    """An initialized model exchange FMU with its integrator; see `bayesftc.cosim.block.External`.

    The inputs are held from t_k to t_k+1. Where they change, the FMU goes through event mode, and the integrator begins anew
    at each t_k and after each event: a step depends on the FMU's state and the inputs alone, so that a run which was saved and
    restored gives the bits of one that was not.

    Parameters
    ----------
    library : ModelLibrary2 or ModelLibrary3
        The binary.
    name : str
        The instance's name.
    step : Fraction
        Seconds of a communication step.
    timing : {"plant", "direct", "sampled"}
        When outputs are read; see `bayesftc.cosim.FMU`.
    start, inputs, outputs
        Start values, inputs with theirs, and outputs, by variable.
    solver : tuple
        Name, relative and absolute tolerance.

    Raises
    ------
    FMUError
        If the FMU refuses to be instantiated or initialized.
    """

    def __init__(
        self,
        library: ModelLibrary,
        name: str,
        step: Fraction,
        timing: Literal["plant", "direct", "sampled"],
        start: dict[FMUVariable, Value],
        inputs: dict[FMUVariable, Value],
        outputs: Sequence[FMUVariable],
        solver: tuple[str, float, float | None],
    ):
        self.table = np.zeros(0, dtype=np.int64)
        self._step, self._h, self._timing = step, float(step), timing
        self._model = model = ExchangeModel(library, name, start, inputs, outputs)
        self._reason = ""
        self._raised: BaseException | None = None
        self._views: dict[tuple[int, int], Floats] = {}
        self._sizes = len(model.inputs), model.output_size
        self._taken = model.inputs.tobytes()
        try:
            self._solver = _solver(model, *solver) if model.nx or model.nz else None
        except BaseException:
            model.close()
            raise

    # --- what the engines call ----------------------------------------------------------------------------------------------

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return ctypes.cast(self._entries[0], ctypes.c_void_p).value or 0

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 where all is done in the output function."""
        return 0 if self._timing == "sampled" else ctypes.cast(self._entries[1], ctypes.c_void_p).value or 0

    @cached_property
    def _entries(self) -> tuple[Any, Any]:
        return _ENTRY(self._entry(self.output)), _ENTRY(self._entry(self.update))

    def _entry(self, function: Callable[[Floats, Floats, float], int]) -> Callable[..., int]:
        sizes, view = self._sizes, self._view

        def entry(state: int, parameters: int, inputs: int, outputs: int, t: float, k: int) -> int:
            try:
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

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        if self._timing == "sampled":
            return 0
        try:
            self._advance(inputs, t)
        except (StopError, CallError) as error:
            return self._stop(error)
        return 0

    def _stop(self, error: StopError | CallError) -> int:
        self._reason = error.sentence() if isinstance(error, CallError) else str(error)
        return STOPPED

    def explain(self, status: int) -> str:
        """Return why it stopped, with the last messages of the instance."""
        self._model.healthy = False
        raised, self._raised = self._raised, None
        if raised is not None:
            raise raised
        return f"{self._reason}. {self._model.messages.quoted()}"

    # --- a step -------------------------------------------------------------------------------------------------------------

    def _take(self, inputs: Floats) -> None:
        """Let the inputs jump to what they are now, which is an event."""
        now = inputs.tobytes()
        if now != self._taken:
            self._event(inputs)
            self._taken = now

    def _event(self, inputs: Floats | None = None) -> None:
        nominals_changed = self._model.event(inputs)
        if nominals_changed and self._solver is not None:
            self._solver.set_tolerances()

    def _advance(self, inputs: Floats, t: float) -> None:
        """Take the FMU from `t` to the next communication point, from event to event."""
        self._take(inputs)
        model, solver, h = self._model, self._solver, self._h
        end = (round(t / h) + 1) * self._step.numerator / self._step.denominator
        near = 8 * _EPS * max(abs(end), h)
        quiet, before = 0, model.time
        while True:
            has_timed = model.next_event <= end + near
            target = model.next_event if has_timed else end
            event = False
            if target <= model.time + near:  # too near to integrate, or in the past
                if not has_timed:
                    return
                if target > model.time:
                    model.set_time(target)
            elif solver is None:
                model.set_time(target)
            else:
                _, event = solver.integrate(model.time, target)
            if not event and not has_timed:
                return
            self._event()
            quiet = quiet + 1 if model.time - before <= 1e-9 * h + 1e3 * _EPS * abs(end) else 0
            before = model.time
            if quiet >= QUIET_EVENTS:
                raise StopError(
                    f"Its events do not end at t = {model.time:.9g} s: {QUIET_EVENTS} came one after the other without time "
                    "going on between them (chattering). Give the switch a hysteresis or a dead time, or export a model that "
                    "regularises it"
                )

    # --- states and end -----------------------------------------------------------------------------------------------------

    @property
    def can_save(self) -> bool:
        """See `bayesftc.cosim.block.External.can_save`."""
        return self._model.can_save

    def save(self) -> SavedModel:
        """See `bayesftc.cosim.block.External.save`."""
        return self._model.save()

    def restore(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.restore`."""
        self._model.restore(saved)
        self._taken = self._model.inputs.tobytes()
        if self._solver is not None:
            self._solver.set_tolerances()

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        self._model.forget(saved)

    def close(self) -> None:
        """Free the instance and its integrator; the binary stays loaded."""
        solver, self._solver = getattr(self, "_solver", None), None
        if solver is not None:
            solver.close()
        self._model.close()


def _solver(model: ExchangeModel, name: str, rtol: float, atol: float | None) -> Any:
    if name == "cvode":
        from bayesftc.cosim._model_exchange_cvode import CVode

        return CVode(model, rtol, atol)
    from bayesftc.cosim._model_exchange_scipy import ScipySolver

    return ScipySolver(model, name.removeprefix("scipy:"), rtol, atol)
