"""CVODE, as fmpy ships it, for one model exchange FMU: set up here, used in compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.exchange import words
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.settings import INTERNAL_STEPS

_BDF = 2
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
_OTHERWISE = "update fmpy, or give the FMU another solver, as 'rk45'"


@cache
def _sundials() -> Callable[..., Any]:
    """Return a function that calls functions of SUNDIALS by name; arguments are plain numbers and addresses.

    Raises
    ------
    FMUError
        If fmpy contains another version.
    """
    try:
        from fmpy.sundials import libraries

        shared = [
            getattr(libraries, f"sundials_{n}")
            for n in ("cvode", "nvecserial", "sunmatrixdense", "sunlinsoldense", "core")
        ]
    except Exception:  # noqa: BLE001 - fmpy raises plain Exception for another version
        raise FMUError(
            f"CVODE cannot be loaded: fmpy must contain SUNDIALS 7 for this platform; {_OTHERWISE}."
        ) from None

    @cache
    def function(name: str, result: Any) -> Any:
        for library in shared:
            if hasattr(library, name):
                bound = library[name]  # a separate object: fmpy sets other types on the attribute
                bound.restype = result
                return bound
        raise FMUError(f"The SUNDIALS in fmpy has no {name}; {_OTHERWISE}.")

    def call(name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        return function(name, result)(*arguments)

    major, more, label = ctypes.c_int(), ctypes.c_int(), ctypes.create_string_buffer(8)
    call("SUNDIALSGetVersionNumber", *(ctypes.byref(n) for n in (major, more, more)), label, ctypes.c_int(len(label)))
    if major.value != 7:
        raise FMUError(f"fmpy contains SUNDIALS {major.value}, but version 7 is needed; {_OTHERWISE}.")
    return call


@cache
def _callbacks() -> tuple[Any, Any]:
    from bayesftc.cosim.fmi.exchange.integrators import cvode_kernels
    from bayesftc.cosim.stepping.compiler import compile_callback

    functions: tuple[Any, Any] = cvode_kernels.cvode_slope, cvode_kernels.cvode_roots
    slope, roots = (compile_callback(f, "int32(float64, int64, int64, int64)") for f in functions)
    return slope, roots


class CVode:
    """CVODE (variable-order BDF) with the root functions of one FMU; it fills its words in the FMU's table.

    Parameters
    ----------
    model : ExchangeModel
        The instance.
    tolerances : ndarray
        Array of the absolute tolerances, which are set later.

    Raises
    ------
    FMUError
        If CVODE is not available.
    """

    def __init__(self, model: ExchangeModel, tolerances: np.ndarray[Any, np.dtype[np.float64]]):
        self._call = _sundials()
        self.message = ""
        self._things: list[tuple[str, Any]] = []  # function that frees each object, and its address
        try:
            self._build(model, tolerances)
        except BaseException:
            self.close()
            raise

    def _build(self, model: ExchangeModel, tolerances: np.ndarray[Any, np.dtype[np.float64]]) -> None:
        call, place, size = self._call, ctypes.c_void_p, ctypes.c_int64(len(model.places))
        context = place()
        self._check("SUNContext_Create", ctypes.c_int(0), ctypes.byref(context))
        self._things.append(("SUNContext_Free", context))
        call("SUNContext_ClearErrHandlers", context)  # the default handler prints to the terminal
        self._handler = _HANDLER(self._receive)
        call("SUNContext_PushErrHandler", context, self._handler, None)

        def make(name: str, free: str, *arguments: Any) -> Any:
            thing = place(call(name, *arguments, context, result=place))
            if not thing.value:
                raise FMUError(f"CVODE cannot allocate memory for {size.value} states ({name}).")
            self._things.append((free, thing))
            return thing

        y, absolute = (
            make("N_VMake_Serial", "N_VDestroy_Serial", size, place(array.ctypes.data))
            for array in (model.places, tolerances)
        )
        slope, roots = _callbacks()
        memory = make("CVodeCreate", "CVodeFree", ctypes.c_int(_BDF))
        self._check("CVodeInit", memory, place(slope.address), ctypes.c_double(0.0), y)
        if model.nz:
            self._check("CVodeRootInit", memory, ctypes.c_int(model.nz), place(roots.address))
            self._check("CVodeSetNoInactiveRootWarn", memory)
        tolerances[:] = 1.0
        self._check("CVodeSVtolerances", memory, ctypes.c_double(1.0), absolute)  # replaced by `_set_tolerances`
        matrix = make("SUNDenseMatrix", "SUNMatDestroy", size, size)
        solver = make("SUNLinSol_Dense", "SUNLinSolFree", y, matrix)
        self._check("CVodeSetLinearSolver", memory, solver, matrix)
        self._check("CVodeSetMaxNumSteps", memory, ctypes.c_long(INTERNAL_STEPS))
        self._check("CVodeSetMaxHnilWarns", memory, ctypes.c_int(-1))
        self._check("CVodeSetUserData", memory, place(model.table.ctypes.data))
        table = model.table
        table[words.INTEGRATOR] = words.CVODE
        for word, thing in ((words.MEMORY, memory), (words.VECTOR, y), (words.TOLERANCE_VECTOR, absolute)):
            table[word] = thing.value
        for word, name in (
            (words.INTEGRATE, "CVode"),
            (words.RESTART, "CVodeReInit"),
            (words.SET_STOP, "CVodeSetStopTime"),
            (words.SET_TOLERANCES, "CVodeSVtolerances"),
        ):
            table[word] = self._address(name)

    def _address(self, name: str) -> int:
        from fmpy.sundials.libraries import sundials_cvode

        return ctypes.cast(sundials_cvode[name], ctypes.c_void_p).value or 0

    def _check(self, name: str, *arguments: Any) -> None:
        flag = self._call(name, *arguments)
        if flag != 0:
            raise FMUError(f"CVODE cannot be set up: {name} returned {flag} ({self.message or 'no message'}).")

    def _receive(
        self, line: int, where: bytes, file: bytes, text: bytes | None, code: int, data: Any, context: Any
    ) -> None:
        self.message = " ".join((text or b"").decode("utf-8", errors="replace").split())

    def close(self) -> None:
        """Free everything."""
        while self._things:
            free, thing = self._things.pop()
            by_reference = free in {"CVodeFree", "SUNContext_Free"}
            self._call(free, ctypes.byref(thing) if by_reference else thing)
