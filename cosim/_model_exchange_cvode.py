"""CVODE, as fmpy ships it, for one model exchange FMU: restarted at each stretch, called and calling in compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bayesftc.cosim import _model_exchange_kernels as kernels
from bayesftc.cosim._fmi_messages import STATUS
from bayesftc.cosim._model_exchange_model import ExchangeModel, StopError
from bayesftc.cosim._model_exchange_settings import INTERNAL_STEPS
from bayesftc.cosim.errors import FMUError

_BDF = 2
_FAILURES = {
    -1: f"it needed more than {INTERNAL_STEPS} steps of its own",
    -2: "more accuracy is asked for than numbers of 64 bits have",
    -3: "its error test fails again and again, or its step became as small as can be",
    -4: "its equations for a step do not converge, again and again or with the smallest step",
    -27: "the time to go is too short to begin",
}
"""What CVODE's flags mean, of those that a model can bring about."""

_REMEDY = "Give larger tolerances or a shorter step, or look at what the model does there"
_HANDLER = ctypes.CFUNCTYPE(
    None,
    ctypes.c_int,
    ctypes.c_char_p,
    ctypes.c_char_p,
    ctypes.c_char_p,
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_void_p,
)
_ENTRY = ctypes.CFUNCTYPE(
    ctypes.c_int32, *[ctypes.c_int64] * 4, ctypes.c_double, ctypes.c_int64
)  # the engine's signature


@cache
def _sundials() -> Callable[..., Any]:
    """Return a function that calls a function of SUNDIALS by name, its arguments plain Python numbers and addresses.

    Raises
    ------
    FMUError
        If fmpy brings another version.
    """
    try:
        from fmpy.sundials import libraries
        from fmpy.sundials.libraries import sundials_core
    except (ImportError, OSError, AttributeError):
        raise FMUError(
            "CVODE cannot be loaded: this needs an fmpy that brings SUNDIALS 7 for this platform; update fmpy, or give the FMU "
            "solver='scipy:LSODA'."
        ) from None
    shared = [
        getattr(libraries, f"sundials_{n}") for n in ("cvode", "nvecserial", "sunmatrixdense", "sunlinsoldense", "core")
    ]
    assert sundials_core is shared[-1]

    @cache
    def function(name: str, result: Any) -> Any:
        for library in shared:
            if hasattr(library, name):
                bound = library[name]  # an object of our own: fmpy sets its own types on the attribute
                bound.restype = result
                return bound
        raise FMUError(
            f"The SUNDIALS that fmpy brings has no {name}; update fmpy, or give the FMU solver='scipy:LSODA'."
        )

    def call(name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        return function(name, result)(*arguments)

    major, more, label = ctypes.c_int(), ctypes.c_int(), ctypes.create_string_buffer(8)
    call("SUNDIALSGetVersionNumber", *(ctypes.byref(n) for n in (major, more, more)), label, ctypes.c_int(len(label)))
    if major.value != 7:
        raise FMUError(
            f"fmpy brings SUNDIALS {major.value}, but version 7 is needed; update fmpy, or give the FMU solver='scipy:LSODA'."
        )
    return call


def _address(name: str) -> int:
    from fmpy.sundials.libraries import sundials_cvode

    return ctypes.cast(sundials_cvode[name], ctypes.c_void_p).value or 0


@cache
def _compiled() -> tuple[Any, Any, Any]:
    from bayesftc.cosim._compiler import compile_callback, compile_raw

    slope: Any = kernels.derivatives
    roots: Any = kernels.indicators
    run: Any = kernels.stretch
    signature = "int32(float64, int64, int64, int64)"
    return compile_callback(slope, signature), compile_callback(roots, signature), compile_raw(run)


class CVode:
    """CVODE (variable-order BDF) with the root functions of one FMU.

    Parameters
    ----------
    model : ExchangeModel
        The instance; `integrate` begins at its states ``model.x``.
    rtol : float
        Relative tolerance.
    atol : float or None
        Absolute tolerance; None for rtol times nominal values.

    Raises
    ------
    FMUError
        If CVODE is not there.
    """

    def __init__(self, model: ExchangeModel, rtol: float, atol: float | None):
        self._call, self._model, self._rtol, self._atol = _sundials(), model, rtol, atol
        self._said = ""
        self._end = np.zeros(1)
        self._things: list[tuple[str, Any]] = []  # how each is freed, and where it is
        self._slope, self._roots, entry = _compiled()
        self._run = _ENTRY(entry.address)
        self.size = max(model.nx, 1)  # without states, a constant stands for them, so that roots in time are found
        try:
            self._build()
        except BaseException:
            self.close()
            raise

    def _build(self) -> None:
        call, place, size = self._call, ctypes.c_void_p, ctypes.c_int64(self.size)
        context = place()
        self._check("SUNContext_Create", ctypes.c_int(0), ctypes.byref(context))
        self._things.append(("SUNContext_Free", context))
        call("SUNContext_ClearErrHandlers", context)  # the one that is there prints to the terminal
        self._handler = _HANDLER(self._hear)
        call("SUNContext_PushErrHandler", context, self._handler, None)

        def make(name: str, free: str, *arguments: Any) -> Any:
            thing = place(call(name, *arguments, context, result=place))
            if not thing.value:
                raise FMUError(f"CVODE has no memory for {self.size} states ({name}).")
            self._things.append((free, thing))
            return thing

        y = make("N_VNew_Serial", "N_VDestroy_Serial", size)
        tolerance = make("N_VNew_Serial", "N_VDestroy_Serial", size)
        self.y, self._tolerance = self._values(y), self._values(tolerance)
        self.y[:] = 0.0
        memory = make("CVodeCreate", "CVodeFree", ctypes.c_int(_BDF))
        self._memory, self._tolerance_vector = memory, tolerance
        self._check("CVodeInit", memory, place(self._slope.address), ctypes.c_double(0.0), y)
        self.set_tolerances()
        if self._model.nz:
            self._check("CVodeRootInit", memory, ctypes.c_int(self._model.nz), place(self._roots.address))
            self._check("CVodeSetNoInactiveRootWarn", memory)
        matrix = make("SUNDenseMatrix", "SUNMatDestroy", size, size)
        solver = make("SUNLinSol_Dense", "SUNLinSolFree", y, matrix)
        self._check("CVodeSetLinearSolver", memory, solver, matrix)
        self._check("CVodeSetMaxNumSteps", memory, ctypes.c_long(INTERNAL_STEPS))
        self._check("CVodeSetMaxHnilWarns", memory, ctypes.c_int(-1))
        self._table = self._filled_table(memory, y)
        self._check("CVodeSetUserData", memory, place(self._table.ctypes.data))

    def _check(self, name: str, *arguments: Any) -> None:
        flag = self._call(name, *arguments)
        if flag != 0:
            raise FMUError(f"CVODE cannot be set up: {name} returned {flag} ({self._said or 'it says nothing'}).")

    def _filled_table(self, memory: Any, y: Any) -> np.ndarray[Any, np.dtype[np.int64]]:
        model, table = self._model, np.zeros(kernels.WORDS, dtype=np.int64)
        library = model.library
        for word, role in (
            (kernels.SET_TIME, "set_time"),
            (kernels.SET_STATES, "set_states"),
            (kernels.GET_DERIVATIVES, "get_derivatives"),
            (kernels.GET_INDICATORS, "get_indicators"),
            (kernels.COMPLETED_STEP, "completed_step"),
        ):
            table[word] = library.address(role)
        table[kernels.COMPONENT] = model.component
        table[kernels.STATES], table[kernels.INDICATORS] = model.nx, model.nz
        table[kernels.WANTS_STEPS] = model.info.needs_completed_step
        table[kernels.NO_RETURN] = not model.info.can_save  # else someone may go back to a saved state
        table[kernels.MEMORY], table[kernels.VECTOR] = memory.value, y.value
        for word, name in (
            (kernels.INTEGRATE, "CVode"),
            (kernels.RESTART, "CVodeReInit"),
            (kernels.SET_STOP, "CVodeSetStopTime"),
        ):
            table[word] = _address(name)
        table[kernels.LIMIT] = INTERNAL_STEPS
        return table

    def _values(self, vector: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        address = self._call("N_VGetArrayPointer_Serial", vector, result=ctypes.c_void_p)
        return np.ctypeslib.as_array((ctypes.c_double * self.size).from_address(address))

    def set_tolerances(self) -> None:
        """Set the tolerances anew, as the nominal values are now."""
        nominals = np.ones(self.size)
        if self._model.nx:
            self._model.read("get_nominals", nominals)
            nominals = np.where(np.isfinite(nominals) & (nominals != 0.0), np.abs(nominals), 1.0)
        self._tolerance[:] = self._rtol * nominals if self._atol is None else self._atol
        self._check("CVodeSVtolerances", self._memory, ctypes.c_double(self._rtol), self._tolerance_vector)

    def integrate(self, t: float, end: float) -> tuple[float, bool]:
        """Integrate from time `t` and the states ``model.x`` to `end`, or to an event before it.

        Returns
        -------
        reached : float
            The time at which the FMU and ``model.x`` are.
        event : bool
            Whether event mode is wanted there.

        Raises
        ------
        StopError
            If CVODE or the FMU gives up.
        """
        model, table = self._model, self._table
        if model.nx:
            self.y[:] = model.x
        self._end[0], self._said = end, ""
        flag = self._run(0, table.ctypes.data, 0, 0, t, self._end.ctypes.data)
        if flag < 0:
            raise StopError(self._reason(flag, t))
        if model.nx:
            model.x[:] = self.y
        reached = float(table.view(np.float64)[kernels.REACHED])
        model.time = reached
        if flag == kernels.WANTS_END:
            raise StopError("The FMU asks to end the simulation (terminateSimulation, after a step of the integrator)")
        return reached, flag in {kernels.ROOT, kernels.WANTS_EVENT}

    def _reason(self, flag: int, t: float) -> str:
        table, names = self._table, self._model.library.names
        when = float(table.view(np.float64)[kernels.WHEN])
        role, status = int(table[kernels.ROLE]), int(table[kernels.STATUS])
        roles = {
            kernels.TIME_ROLE: "set_time",
            kernels.STATES_ROLE: "set_states",
            kernels.DERIVATIVES_ROLE: "get_derivatives",
            kernels.INDICATORS_ROLE: "get_indicators",
            kernels.STEP_ROLE: "completed_step",
        }
        if flag == kernels.TOO_MANY:
            flag = -1
        if role and (flag <= -8 or flag == kernels.CALL_FAILED) and flag != -27:
            self._model.fatal = self._model.fatal or status == 4
            if role == kernels.NAN_DERIVATIVE:
                return (
                    f"{self._nan('get_derivatives')} at t = {when:g} s and smaller steps of the integrator do not help"
                )
            if role == kernels.NAN_INDICATOR:
                return f"{self._nan('get_indicators')} at t = {when:g} s"
            word = STATUS[status] if 0 <= status < len(STATUS) else str(status)
            return f"{names[roles[role]]} returned {word} at t = {when:g} s"
        reached = float(table.view(np.float64)[kernels.REACHED])
        at = reached if reached > t else t
        what = _FAILURES.get(flag) or f"it returned {flag} ({self._said or 'it says nothing'})"
        return f"CVODE gives up at t = {at:g} s: {what}. {_REMEDY}"

    def _nan(self, role: str) -> str:
        model = self._model
        if role == "get_indicators":
            return "An event indicator came out NaN or infinite"
        values = np.zeros(model.nx)
        model.read(role, values)  # where it failed last is where the FMU still is
        bad = [v.name for v, x in zip(model.info.derivatives, values, strict=False) if not np.isfinite(x)]
        return f"The derivative {bad[0]!r} came out NaN or infinite" if bad else "A derivative came out NaN or infinite"

    def _hear(
        self, line: int, where: bytes, file: bytes, text: bytes | None, code: int, data: Any, context: Any
    ) -> None:
        self._said = " ".join((text or b"").decode("utf-8", errors="replace").split())

    def close(self) -> None:
        """Free everything."""
        while self._things:
            free, thing = self._things.pop()
            by_reference = free in {"CVodeFree", "SUNContext_Free"}
            self._call(free, ctypes.byref(thing) if by_reference else thing)
