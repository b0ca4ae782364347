"""Running model exchange FMUs with an integrator that is compiled, as is all else of a step."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.integrators.instance import ExchangeInstance, Timing
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.reasons import reason
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS, RESTARTED
from bayesftc.cosim.fmi.running.by_address import ENTRY
from bayesftc.cosim.fmi.running.port_values import StopError


@cache
def _compiled(role: str) -> Any:
    from bayesftc.cosim.fmi.exchange.integrators.kernels import FUNCTIONS
    from bayesftc.cosim.stepping.compiler import compile_raw

    function: Any = FUNCTIONS[role]
    return compile_raw(function)


class CompiledInstance(ExchangeInstance):
    """One whose integrator is compiled, as is all else of a step.

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
            from bayesftc.cosim.fmi.exchange.integrators.cvode import CVode

            self._cvode = CVode(model, self._tolerances)
            self._work = np.zeros(model.nx)  # the states of the last step that was good
            table[words.WORK] = self._work.ctypes.data
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
        """Address of the compiled update function; 0 where all is done in the output function."""
        return 0 if self._timing == "sampled" else int(_compiled("update").address)

    def _set_tolerances(self) -> None:
        if self._model.nx or self._model.nz:
            nothing = np.zeros(0)
            if self._entered(ENTRY(_compiled("tolerances").address), nothing, nothing, 0.0):
                raise StopError(self._why())

    @property
    def has_ended(self) -> bool:
        """See `bayesftc.cosim.block.External.has_ended`."""
        return int(self._model.table[words.REASON]) in {words.ENDS, words.ENDS_AFTER_STEP}

    def _why(self) -> str:
        return reason(self._model, self._name, self._cvode.said if self._cvode else "")

    def close(self) -> None:
        """Free the instance and its integrator; the binary stays loaded."""
        if self._cvode is not None:
            self._cvode.close()
        super().close()
