"""Running model exchange FMUs: what the engines call, one communication step of an integrator with all its events.

The inputs are held from t_k to t_k+1. Where they change, the FMU goes through event mode, and the integrator begins anew at
each t_k and after each event: a step depends on the FMU's state and the inputs alone, so that a run which was saved and restored
gives the bits of one that was not.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np

from bayesftc.cosim._exchange import words
from bayesftc.cosim._exchange.library import ModelLibrary
from bayesftc.cosim._exchange.model import ExchangeModel, SavedModel, StopError
from bayesftc.cosim._exchange.reasons import CHATTERS, reason
from bayesftc.cosim._exchange.settings import INTERNAL_STEPS, RESTARTED
from bayesftc.cosim._fmi.description import FMUVariable, Value
from bayesftc.cosim._fmi.library import CallError
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import FMUError, UnknownNameError, did_you_mean
from bayesftc.cosim.timebase import step_at

INTERRUPTED = 502
"""Status: Python raised something, which the instance keeps until it is asked."""

Timing = Literal["plant", "direct", "sampled"]

_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64)


class ExchangeInstance(ABC):
    """What all of them have in common; see `bayesftc.cosim.block.External`.

    Parameters
    ----------
    model : ExchangeModel
        The instance of the FMU.
    step : Fraction
        Seconds of a communication step.
    timing : {"plant", "direct", "sampled"}
        When outputs are read; see `bayesftc.cosim.FMU`.
    """

    #: The word of the table that holds the step size, which may be any.
    step_word = words.STEP_WORD
    can_resize = True

    def __init__(self, model: ExchangeModel, step: Fraction, timing: Timing):
        self._model, self._step, self._timing = model, step, timing
        self.table = np.array([model.table.ctypes.data, 0], dtype=np.int64)
        self.resize(float(step))

    def resize(self, h: float) -> None:
        """See `bayesftc.cosim.block.VariableStep.resize`."""
        self.table.view(np.float64)[words.STEP_WORD] = h

    @property
    @abstractmethod
    def output_address(self) -> int:
        """Address of the output function."""

    @property
    @abstractmethod
    def update_address(self) -> int:
        """Address of the update function; 0 where all is done in the output function."""

    @abstractmethod
    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""

    def update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.update`."""
        return 0 if self._timing == "sampled" else self._update(inputs, outputs, t)

    @abstractmethod
    def _update(self, inputs: Floats, outputs: Floats, t: float) -> int: ...

    def explain(self, status: int) -> str:
        """Return why it stopped, with the last messages of the instance."""
        self._model.healthy = False
        return f"{self._why()}. {self._model.messages.quoted()}"

    @abstractmethod
    def _why(self) -> str: ...

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
        self._set_tolerances()

    @abstractmethod
    def _set_tolerances(self) -> None: ...

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        self._model.forget(saved)

    @property
    def states(self) -> dict[str, float]:
        """The continuous states by name, as they are now."""
        return dict(zip(self._model.state_names, self._model.x.tolist(), strict=True))

    def set_states(self, values: Mapping[str, float]) -> None:
        """Set continuous states by name; events that belong to them happen at once.

        Raises
        ------
        UnknownNameError
            If there is no such state.
        FMUError
            If the FMU refuses them.
        """
        model = self._model
        names = model.state_names
        for name, value in values.items():
            if name not in names:
                raise UnknownNameError(f"{model.name!r} has no continuous state {name!r}; {did_you_mean(name, names)}")
            model.x[names.index(name)] = value
        try:
            model.write_states()
            model.event()
        except (CallError, StopError) as error:
            what = error.sentence() if isinstance(error, CallError) else str(error)
            raise FMUError(f"{model.name!r} refuses these states: {what}. {model.messages.quoted()}") from None
        self._set_tolerances()

    def close(self) -> None:
        """Free the instance; the binary stays loaded."""
        self._model.close()


@cache
def _compiled(role: str) -> tuple[Any, Any]:
    from bayesftc.cosim._compiler import compile_raw
    from bayesftc.cosim._exchange.kernels import FUNCTIONS

    function: Any = FUNCTIONS[role]
    compiled = compile_raw(function)
    return compiled, _ENTRY(int(compiled.address or 0))


class CompiledInstance(ExchangeInstance):
    """One whose integrator is compiled, as is all else of a step; the interpreted engine calls the same functions.

    Parameters
    ----------
    model, step, timing
        See `ExchangeInstance`.
    solver : {"cvode", "rk45"}
        The integrator.
    rtol : float
        Relative tolerance.
    atol : float or None
        Absolute tolerance; None for rtol times nominal values.
    """

    def __init__(
        self, model: ExchangeModel, step: Fraction, timing: Timing, solver: str, rtol: float, atol: float | None
    ):
        super().__init__(model, step, timing)
        table, reals = model.table, model.reals
        table[words.NUMERATOR], table[words.DENOMINATOR] = step.numerator, step.denominator
        table[words.LIMIT] = INTERNAL_STEPS
        self._name, self._cvode = {"cvode": "CVODE", "rk45": "Runge-Kutta"}[solver], None
        self._tolerances, self._work = np.ones(len(model.places)), np.zeros(0)
        table[words.TOLERANCES] = self._tolerances.ctypes.data
        part = RESTARTED if solver == "cvode" else 1.0
        reals[words.RTOL] = max(part * rtol, words.PRECISION)
        reals[words.ATOL] = -1.0 if atol is None else part * atol
        if model.nx == model.nz == 0:
            table[words.INTEGRATOR] = words.NONE
        elif solver == "cvode":
            from bayesftc.cosim._exchange.cvode import CVode

            self._cvode = CVode(model, self._tolerances)
        else:
            from bayesftc.cosim._exchange.runge_kutta import VECTORS

            self._work = np.zeros(VECTORS * max(model.nx, 1) + 2 * model.nz)
            table[words.INTEGRATOR], table[words.WORK] = words.RUNGE_KUTTA, self._work.ctypes.data
        try:
            self._set_tolerances()
        except StopError:
            self.close()
            raise

    @property
    def output_address(self) -> int:
        """Address of the compiled output function."""
        return int(_compiled(self._timing)[0].address)

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 where all is done in the output function."""
        return 0 if self._timing == "sampled" else int(_compiled("update")[0].address)

    def output(self, inputs: Floats, outputs: Floats, t: float) -> int:
        """See `bayesftc.cosim.block.External.output`."""
        return self._call(self._timing, inputs, outputs, t)

    def _update(self, inputs: Floats, outputs: Floats, t: float) -> int:
        return self._call("update", inputs, outputs, t)

    def _call(self, role: str, inputs: Floats, outputs: Floats, t: float) -> int:
        entry = _compiled(role)[1]
        addresses = self.table.ctypes.data, inputs.ctypes.data, outputs.ctypes.data
        return int(entry(0, *addresses, t, step_at(t, self._step)))

    def _set_tolerances(self) -> None:
        if self._model.nx or self._model.nz:
            nothing = np.zeros(0)
            if self._call("tolerances", nothing, nothing, 0.0):
                raise StopError(self._why())

    def _why(self) -> str:
        return reason(self._model, self._name, self._cvode.said if self._cvode else "")

    def close(self) -> None:
        """Free the instance and its integrator; the binary stays loaded."""
        if self._cvode is not None:
            self._cvode.close()
        super().close()


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
        self._solver, self._reason = solver, ""
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
        return _ENTRY(self._entry(self.output)), _ENTRY(self._entry(self.update))

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
        return words.STOPPED

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
        while True:
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
                raise StopError(f"Its events do not end at t = {model.time:.9g} s: {CHATTERS}")


def exchange_instance(
    library: ModelLibrary,
    name: str,
    step: Fraction,
    timing: Timing,
    start: dict[FMUVariable, Value],
    inputs: dict[FMUVariable, Value],
    outputs: Sequence[FMUVariable],
    solver: tuple[str, float, float | None],
) -> ExchangeInstance:
    """Return an initialized model exchange FMU with its integrator.

    Parameters
    ----------
    library : ModelLibrary2 or ModelLibrary3
        The binary.
    name : str
        The instance's name.
    step, timing
        See `ExchangeInstance`.
    start, inputs, outputs
        Start values, inputs with theirs, and outputs, by variable.
    solver : tuple
        Name, relative and absolute tolerance.

    Raises
    ------
    FMUError
        If the FMU refuses to be instantiated or initialized, or the integrator cannot be had.
    """
    model = ExchangeModel(library, name, start, inputs, outputs)
    which, rtol, atol = solver
    try:
        if which.startswith("scipy:") and (model.nx or model.nz):
            from bayesftc.cosim._exchange.scipy_methods import ScipySolver

            return ScipyInstance(model, step, timing, ScipySolver(model, which.removeprefix("scipy:"), rtol, atol))
        return CompiledInstance(model, step, timing, "rk45" if which.startswith("scipy:") else which, rtol, atol)
    except BaseException as error:
        model.healthy = False
        model.close()
        if isinstance(error, StopError | CallError):
            what = error.sentence() if isinstance(error, CallError) else str(error)
            raise FMUError(
                f"The FMU {library.description.name!r} could not be initialized as {name!r}: {what}. {model.messages.quoted()}"
            ) from None
        raise
