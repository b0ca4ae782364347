"""Running model exchange FMUs: what the engines call, one communication step of an integrator with all its events.

The inputs are held from t_k to t_k+1. Where they change, the FMU goes through event mode, and the integrator begins anew at
each t_k and after each event: a step depends on the FMU's state and the inputs alone, so that a run which was saved and restored
gives the bits of one that was not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Literal

import numpy as np

from bayesftc.cosim.errors import FMUError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.binaries.library import Beginning, CallError
from bayesftc.cosim.fmi.binaries.model_library import ModelLibrary
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel, SavedModel
from bayesftc.cosim.fmi.reading.description import FMUVariable
from bayesftc.cosim.fmi.running.by_address import ByAddress
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.types import Floats

Timing = Literal["plant", "direct", "sampled"]


class ExchangeInstance(ByAddress, ABC):
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
        self.rounding = model.ports.rounding
        self.table = np.array([model.table.ctypes.data, 0], dtype=np.int64)
        self.resize(float(step))

    def explain(self, status: int) -> str:
        """Return why it stopped, with the last messages of the instance."""
        return f"{self._why()}. {self._model.messages.quoted()}"

    @abstractmethod
    def _why(self) -> str: ...

    @property
    @abstractmethod
    def has_ended(self) -> bool:
        """See `bayesftc.cosim.block.External.has_ended`."""

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

    @abstractmethod
    def _set_tolerances(self) -> None: ...

    def _retune(self, what: str) -> None:
        """Set the tolerances as the nominal values are now; raise FMUError where it does not give them."""
        try:
            self._set_tolerances()
        except (CallError, StopError) as error:
            why = str(error)
            raise FMUError(f"{self._model.name!r} {what}: {why}. {self._model.messages.quoted()}") from None

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
            what = str(error)
            raise FMUError(f"{model.name!r} refuses these states: {what}. {model.messages.quoted()}") from None
        self._retune("refuses these states")

    def close(self) -> None:
        """Free the instance; the binary stays loaded."""
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
        Name of the integrator, whose relative tolerance `beginning` has.
    atol : float or None
        Its absolute tolerance; None for the relative one times nominal values.

    Raises
    ------
    FMUError
        If the FMU refuses to be instantiated or initialized, or the integrator cannot be had.
    """
    model, rtol = ExchangeModel(library, name, beginning, outputs), beginning.tolerance
    try:
        if solver.startswith("scipy:") and (model.nx or model.nz):
            from bayesftc.cosim.fmi.exchange.integrators.scipy_instance import ScipyInstance
            from bayesftc.cosim.fmi.exchange.integrators.scipy_methods import ScipySolver

            return ScipyInstance(model, step, timing, ScipySolver(model, solver.removeprefix("scipy:"), rtol, atol))
        from bayesftc.cosim.fmi.exchange.integrators.compiled_instance import CompiledInstance

        return CompiledInstance(model, step, timing, "rk45" if solver.startswith("scipy:") else solver, rtol, atol)
    except BaseException as error:
        model.healthy = False
        model.close()
        if isinstance(error, StopError | CallError):
            raise FMUError(
                f"The FMU {library.description.name!r} could not be initialized as {name!r}: {error}. {model.messages.quoted()}"
            ) from None
        raise
