"""Integrators of scipy for one model exchange FMU: a Python callback, with restarts at events and roots by bisection."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.reasons import REMEDY, nan_derivative
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS
from bayesftc.cosim.fmi.exchange.words import PRECISION
from bayesftc.cosim.fmi.reading.messages import ENDS
from bayesftc.cosim.fmi.running.port_values import EndError, StopError
from bayesftc.cosim.types import ENTRY, Floats


class ScipySolver:
    """One of the methods of ``scipy.integrate.solve_ivp``.

    Parameters
    ----------
    model : ExchangeModel
        The instance; `integrate` begins at its states ``model.x``.
    method : str
        Name of the method.
    tolerances : ndarray
        The absolute tolerances.

    Attributes
    ----------
    error : BaseException or None
        The last exception.
    """

    def __init__(self, model: ExchangeModel, method: str, tolerances: Floats):
        from scipy import integrate

        self._method: Any = getattr(integrate, method)
        self._model, self._absolute = model, tolerances if model.nx else np.ones(1)
        self._slope, self._roots = np.zeros(model.nx), np.zeros(model.nz)
        self._enter, self._terminate = ctypes.c_int(0), ctypes.c_int(0)
        self.error: BaseException | None = None
        self._entry = ENTRY(lambda state, parameters, inputs, outputs, end, k: self._called(end))
        model.table[words.INTEGRATOR] = words.PYTHON
        model.table[words.INTEGRATE] = ctypes.cast(self._entry, ctypes.c_void_p).value or 0

    def _called(self, end: float) -> int:
        model = self._model
        try:
            event = self.integrate(model.time, end)
        except BaseException as error:  # noqa: BLE001 - it cannot pass through C code; `explain` raises it
            self.error = error
            model.table[words.REASON] = words.ENDS_AFTER_STEP if isinstance(error, EndError) else words.RAISED
            return -1 if isinstance(error, StopError | CallError) else -2
        model.reals[words.REACHED] = model.time
        return int(event)

    def integrate(self, t: float, end: float) -> bool:
        """Integrate from time `t` to `end`, or to an event before it, and set the FMU to that point; return if it is an event.

        Raises
        ------
        StopError
            If the method or the FMU gives up.
        CallError
            If a call fails.
        """
        model = self._model
        start = model.x.copy() if model.nx else np.ones(1)
        signs = self._signs(t, start)
        solver = self._method(
            self._derivatives, t, start, end, rtol=float(model.reals[words.RTOL]), atol=self._absolute
        )
        for _ in range(INTERNAL_STEPS):
            message = solver.step()
            if solver.status == "failed":
                raise StopError(f"{self._method.__name__} of scipy gives up at t = {solver.t:g} s: {message}; {REMEDY}")
            now, x = float(solver.t), solver.y
            root = model.nz > 0 and not np.array_equal(self._signs(now, x), signs)
            if root:
                now, x = self._locate(solver, signs)
            self._place(now, x)
            if model.nx:
                model.x[:] = x
            event_requested = self._completed_step() if model.info.needs_completed_step else False
            if root or event_requested or solver.status == "finished":
                return bool(root or event_requested)
        raise StopError(
            f"{self._method.__name__} of scipy gives up at t = {solver.t:g} s: it needed more than {INTERNAL_STEPS} internal "
            f"steps; {REMEDY}"
        )

    def _locate(self, solver: Any, signs: Floats) -> tuple[float, Floats]:
        """Return the time and the states just after the first crossing in the last step."""
        between = solver.dense_output()
        low, high = float(solver.t_old), float(solver.t)
        x = solver.y
        while high - low > PRECISION * (abs(high) + (solver.t - solver.t_old)):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            x_middle = between(middle)
            if np.array_equal(self._signs(middle, x_middle), signs):
                low = middle
            else:
                high, x = middle, x_middle
        return high, x

    def _place(self, t: float, x: Floats) -> None:
        model = self._model
        model.set_time(t)
        if model.nx:
            x = np.ascontiguousarray(x)
            model.call("set_states", x.ctypes.data, model.nx)

    def _derivatives(self, t: float, x: Floats) -> Floats:
        model = self._model
        if not model.nx:
            return np.zeros(1)
        self._place(float(t), x)
        model.read("get_derivatives", self._slope)
        if not np.isfinite(self._slope).all():
            raise StopError(f"{nan_derivative(model)} at t = {t:g} s")
        return self._slope.copy()

    def _signs(self, t: float, x: Floats) -> Any:
        model = self._model
        if not model.nz:
            return self._roots
        self._place(t, x)
        model.read("get_indicators", self._roots)
        if not np.isfinite(self._roots).all():
            raise StopError(f"An event indicator came out NaN or infinite at t = {t:g} s")
        return self._roots > 0.0

    def _completed_step(self) -> bool:
        model = self._model
        self._enter.value = self._terminate.value = 0
        status = model.library.completed_step(model.component, not model.info.can_save, self._enter, self._terminate)
        model.check("completed_step", status)
        if self._terminate.value:
            raise EndError(f"{ENDS} (terminateSimulation, after a step of the integrator)")
        return bool(self._enter.value)
