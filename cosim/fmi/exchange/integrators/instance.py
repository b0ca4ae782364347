"""Running model exchange FMUs: one communication step of an integrator with all its events, for the engines.

The inputs are held from t_k to t_k+1; a change of inputs is an event. The integrator restarts at each t_k and after each event.
So a step depends only on the FMU's state and the inputs, and a restored run gives the same bits as an uninterrupted one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from typing import Any, Literal

import numpy as np

from bayesftc._interrupt import import_whole
from bayesftc.cosim.errors import FMUError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.binaries.library import Beginning, CallError
from bayesftc.cosim.fmi.binaries.model_library import ModelLibrary
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel, SavedModel
from bayesftc.cosim.fmi.exchange.reasons import reason
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS, RESTARTED
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.running.by_address import ByAddress
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.types import ENTRY, Floats

Timing = Literal["plant", "direct", "sampled"]


@cache
def _compiled(role: str) -> Any:
    import_whole("bayesftc.cosim.stepping.compiler")

    from bayesftc.cosim.fmi.exchange.integrators.kernels import FUNCTIONS
    from bayesftc.cosim.stepping.compiler import compile_raw

    function: Any = FUNCTIONS[role]
    return compile_raw(function)


class ExchangeInstance(ByAddress):
    """A running instance with its integrator; see `bayesftc.cosim.block.External`.

    Parameters
    ----------
    model : ExchangeModel
        The instance of the FMU.
    step : Fraction
        Seconds of a communication step.
    timing : {"plant", "direct", "sampled"}
        When outputs are read; see `bayesftc.cosim.FMU`.
    solver : str
        The integrator.
    rtol : float
        Relative tolerance.
    atol : float or None
        Absolute tolerance; None for rtol times nominal values.
    """

    #: The word of the table that holds the step size.
    step_word = words.STEP_WORD
    can_resize = True

    def __init__(
        self, model: ExchangeModel, step: Fraction, timing: Timing, solver: str, rtol: float, atol: float | None
    ):
        self._model, self._step, self._timing = model, step, timing
        self.rounding = model.ports.rounding
        self.table = np.array([model.table.ctypes.data, 0], dtype=np.int64)
        self.resize(float(step))
        table, reals = model.table, model.reals
        table[words.NUMERATOR], table[words.DENOMINATOR] = step.numerator, step.denominator
        table[words.LIMIT] = INTERNAL_STEPS
        self._name = {"cvode": "CVODE"}.get(solver, "Runge-Kutta")
        self._cvode, self._scipy = None, None
        self._tolerances, self._work = np.ones(len(model.places)), np.zeros(0)
        table[words.TOLERANCES] = self._tolerances.ctypes.data
        part = RESTARTED if solver == "cvode" else 1.0
        reals[words.RTOL] = max(part * rtol, words.PRECISION)
        reals[words.ATOL] = -1.0 if atol is None else part * atol
        if model.nx == model.nz == 0:
            table[words.INTEGRATOR] = words.NONE
        elif solver == "cvode":
            from bayesftc.cosim.fmi.exchange.integrators.cvode import CVode

            self._cvode = CVode(model, self._tolerances)
            self._work = np.zeros(model.nx)  # the states after the last successful step
            table[words.WORK] = self._work.ctypes.data
        elif solver.startswith("scipy:"):
            from bayesftc.cosim.fmi.exchange.integrators.scipy_methods import ScipySolver

            self._scipy = ScipySolver(model, solver.removeprefix("scipy:"), self._tolerances)
        else:
            from bayesftc.cosim.fmi.exchange.integrators.runge_kutta import VECTORS

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
        return int(_compiled(self._timing).address)

    @property
    def update_address(self) -> int:
        """Address of the compiled update function; 0 if the output function does everything."""
        return 0 if self._timing == "sampled" else int(_compiled("update").address)

    def explain(self, status: int) -> str:
        """Return why the instance stopped, with its last messages."""
        return f"{self._why()}. {self._model.messages.quoted()}"

    def _why(self) -> str:
        error = self._scipy.error if self._scipy else None
        if error is None or self._model.table[words.REASON] != words.RAISED:
            return reason(self._model, self._name, self._cvode.message if self._cvode else "")
        if isinstance(error, StopError | CallError):
            return str(error)
        raise error

    @property
    def has_ended(self) -> bool:
        """See `bayesftc.cosim.block.External.has_ended`."""
        return int(self._model.table[words.REASON]) in {words.ENDS, words.ENDS_AFTER_STEP}

    @property
    def can_save(self) -> bool:
        """See `bayesftc.cosim.block.External.can_save`."""
        return self._model.can_save

    @property
    def own_inputs(self) -> dict[str, Floats]:
        """See `bayesftc.cosim.fmi.running.instance.own_inputs`."""
        return self._model.own_inputs

    def expect_return(self) -> None:
        """See `bayesftc.cosim.block.External.expect_return`."""
        self._model.expect_return()

    def save(self) -> SavedModel:
        """See `bayesftc.cosim.block.External.save`."""
        return self._model.save()

    def restore(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.restore`."""
        self._model.restore(saved)
        self._retune("could not be restored")

    def _set_tolerances(self) -> None:
        if self._model.nx or self._model.nz:
            nothing = np.zeros(0)
            if self._entered(ENTRY(_compiled("tolerances").address), nothing, nothing, 0.0):
                raise StopError(self._why())

    def _retune(self, what: str) -> None:
        """Set the tolerances from the present nominal values; raise FMUError if that fails."""
        try:
            self._set_tolerances()
        except (CallError, StopError) as error:
            raise FMUError(f"{self._model.name!r} {what}: {error}. {self._model.messages.quoted()}") from None

    def forget(self, saved: object) -> None:
        """See `bayesftc.cosim.block.External.forget`."""
        self._model.forget(saved)

    @property
    def states(self) -> dict[str, float]:
        """The present continuous states by name."""
        return dict(zip(self._model.state_names, self._model.x.tolist(), strict=True))

    def set_states(self, values: Mapping[str, float]) -> None:
        """Set continuous states by name, and handle the events that this triggers.

        Raises
        ------
        UnknownNameError
            If there is no such state.
        FMUError
            If the FMU does not accept them.
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
            raise FMUError(f"{model.name!r} does not accept these states: {error}. {model.messages.quoted()}") from None
        self._retune("does not accept these states")

    def close(self) -> None:
        """Free the instance and its integrator; the binary stays loaded."""
        if self._cvode is not None:
            self._cvode.close()
        self._model.close()


def exchange_instance(
    library: ModelLibrary,
    name: str,
    step: Fraction,
    timing: Timing,
    beginning: Beginning,
    outputs: Sequence[FMUVariable],
    solver: str,
    atol: float | None,
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
    beginning, outputs
        See `ExchangeModel`.
    solver : str
        Name of the integrator; its relative tolerance is in `beginning`.
    atol : float or None
        Its absolute tolerance; None for the relative one times nominal values.

    Raises
    ------
    FMUError
        If the FMU's instantiation or initialization fails, or the integrator is not available.
    """
    model = ExchangeModel(library, name, beginning, outputs)
    try:
        return ExchangeInstance(model, step, timing, solver, beginning.tolerance, atol)
    except BaseException as error:
        model.healthy = False
        model.close()
        if isinstance(error, StopError | CallError):
            raise FMUError(
                f"The FMU {library.description.name!r} could not be initialized as {name!r}: {error}. {model.messages.quoted()}"
            ) from None
        raise
