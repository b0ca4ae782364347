"""A model exchange FMU as equations: dx/dt = f(x, u, t), y = g(x, u, t), and their Jacobians, for any x, u and t."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.errors import FMUError, ModelError
from bayesftc.cosim.fmi.binaries.groups import element_names
from bayesftc.cosim.fmi.binaries.library import CallError
from bayesftc.cosim.fmi.binaries.model_library import load_model
from bayesftc.cosim.fmi.exchange.model import ExchangeModel
from bayesftc.cosim.fmi.exchange.settings import DEFAULT_TOLERANCE
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.fmi.running.port_values import StopError
from bayesftc.cosim.fmi.running.values import resolved
from bayesftc.cosim.types import Floats

_STEP = 6.055454452393343e-06
"""The cube root of the difference of 1 and the next double."""


class Jacobians(NamedTuple):
    """The linearization of a model at one point: ``d(dx/dt) = A dx + B du``, ``dy = C dx + D du``.

    Attributes
    ----------
    A : ndarray of shape (nx, nx)
        Derivatives of dx/dt with respect to the states x.
    B : ndarray of shape (nx, nu)
        Derivatives of dx/dt with respect to the inputs u.
    C : ndarray of shape (ny, nx)
        Derivatives of the outputs y with respect to the states.
    D : ndarray of shape (ny, nu)
        Derivatives of the outputs with respect to the inputs.

    Examples
    --------
    >>> import control
    >>> from bayesftc import cosim
    >>> linear = cosim.Jacobians(A=[[-0.05]], B=[[0.01]], C=[[1.0]], D=[[0.0]])  # as ModelEquations.jacobians returns it
    >>> control.ss(*linear).poles().real.tolist(), float(control.dcgain(control.ss(*linear)))
    ([-0.05], 0.2)
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats


class ModelEquations:
    """The right-hand side and the outputs of a model exchange FMU, evaluated at any point.

    It is a separate instance, initialized with the block's parameters, and is not integrated. Discrete states (positions of
    switches, counters) keep their values after initialization until `settle` triggers events. Close it in the end, or use it
    in a ``with`` statement. It can be pickled; a copy begins after initialization.

    Parameters
    ----------
    fmu : FMU or path
        The FMU. A block's parameters, inputs and outputs are used, also if the block is for co-simulation and the file
        supports both kinds.

    Attributes
    ----------
    state_names, input_names, output_names : tuple of str
        Elements of x, u and y. Elements of arrays have an index, as ``"T[0]"`` (of a matrix ``"T[0][1]"``).
    x0, u0 : ndarray of shape (nx,), ndarray of shape (nu,)
        States after initialization, start values of the inputs.
    nominals : ndarray of shape (nx,)
        Nominal values (orders of magnitude) of the states.
    has_directional_derivatives : bool
        Whether `jacobians` uses the FMU's directional derivatives; else it uses central differences.

    Raises
    ------
    FMUError
        If the FMU is not for model exchange, or its initialization fails.

    Examples
    --------
    >>> from bayesftc import cosim
    >>> with cosim.ModelEquations(cosim.FMU("pendulum.fmu", kind="model exchange")) as model:  # doctest: +SKIP
    ...     dx = model.derivatives(model.x0, model.u0)
    ...     A, B, C, D = model.jacobians(model.x0, model.u0)
    """

    def __init__(self, fmu: FMU | str | PathLike[str]):
        self.fmu = fmu = fmu if isinstance(fmu, FMU) else FMU(fmu)
        archive, description = fmu._read()
        info = description.exchange
        if info is None:
            raise FMUError(
                f"The FMU {archive.path} is not for model exchange, so its states and derivatives cannot be evaluated. Export it "
                "for model exchange, or identify a model from its inputs and outputs."
            )
        beginning, outputs = fmu._variables()
        beginning = replace(beginning, tolerance=fmu.rtol or DEFAULT_TOLERANCE)
        inputs = list(beginning.inputs)
        self._model = ExchangeModel(load_model(archive, description), fmu.default_name, beginning, outputs)
        parameters: Any = fmu.parameters or {}
        variables = resolved(archive, description, parameters)
        states = [variables[v.name] for v in info.states]
        state_names = [name for name, _ in element_names(states)] if states else self._model.state_names
        self.state_names: tuple[str, ...] = tuple(state_names)
        self.input_names, self.output_names = (
            tuple(name for name, _ in element_names(side)) for side in (inputs, outputs)
        )
        self.has_directional_derivatives = info.directional
        self._knowns = np.array([v.reference for v in (*info.states, *inputs)], dtype=np.uint32)
        self._whole = [name for name, v in element_names(inputs) if not v.is_float]
        unknowns = [*info.derivatives, *(v for v in outputs if v.is_float)]
        self._unknowns = np.array([v.reference for v in unknowns], dtype=np.uint32)
        smooth = [v.is_float for _, v in element_names(outputs)]
        self._rows = np.flatnonzero([True] * self._model.nx + smooth)
        self.x0, self.u0 = self._model.x.copy(), self._model.inputs.copy()
        self._try(self._read_nominals)

    def _read_nominals(self) -> None:
        self.nominals = self._model.nominals()

    @property
    def next_event(self) -> float:
        """The time of the FMU's next time event in seconds; infinity if there is none."""
        return self._model.next_event

    def derivatives(self, x: ArrayLike, u: ArrayLike, t: float = 0.0) -> Floats:
        """Return dx/dt.

        Parameters
        ----------
        x : array_like, (nx,)
            Continuous states.
        u : array_like, (nu,)
            Inputs.
        t : float
            Time in seconds.

        Raises
        ------
        ModelError
            If x or u has another size.
        FMUError
            If the FMU fails at this point. The message quotes its log.
        """
        self._place(x, u, t)
        result = np.zeros(self._model.nx)
        self._try(lambda: self._model.read("get_derivatives", result))
        return result

    def outputs(self, x: ArrayLike, u: ArrayLike, t: float = 0.0) -> Floats:
        """Return y. Arguments and errors are those of `derivatives`."""
        self._place(x, u, t)
        result = np.zeros(len(self.output_names))
        self._try(lambda: self._model.read_outputs(result))
        return result

    def settle(self, x: ArrayLike, u: ArrayLike, t: float = 0.0) -> Floats:
        """Trigger events at a point, so that discrete states take their values there; return the continuous states.

        Arguments and errors are those of `derivatives`.
        """
        self._place(x, u, t)
        self._try(lambda: self._model.event(np.asarray(u, dtype=np.float64)))
        return self._model.x.copy()

    def jacobians(self, x: ArrayLike, u: ArrayLike, t: float = 0.0) -> Jacobians:
        """Return the matrices A, B, C, D of the linearization at a point.

        The FMU's directional derivatives are used if it has them and all inputs are continuous. Else central differences are
        used. Their step is 6e-6 times the state or input, or times its nominal value (1 for an input) if that is larger.
        Outputs that are whole numbers have derivatives of zero. Arguments and errors are those of `derivatives`. An input that
        is a whole number is a ModelError, too.
        """
        x, u = self._checked(x, u)
        if self._whole:
            raise ModelError(
                f"The FMU {self._model.library.description.name!r} has no derivative with respect to {self._whole[0]!r}, which "
                "is a whole number. Leave it out of inputs=, so that it keeps its start value."
            )
        nx, nu = len(x), len(u)
        columns = np.zeros((nx + len(self.output_names), nx + nu))
        if (
            self.has_directional_derivatives and not self._model.jumps
        ):  # FMI defines no derivatives by parameters or discrete inputs
            self._place(x, u, t)
            for i in range(nx + nu):
                seed, column = np.zeros(nx + nu), np.zeros(len(self._rows))
                seed[i] = 1.0
                self._try(lambda seed=seed, column=column: self._directional(seed, column))  # type: ignore[misc]
                columns[self._rows, i] = column
        else:
            scale = np.maximum(np.abs([*x, *u]), [*self.nominals, *np.ones(nu)])
            point = np.array([*x, *u])
            for i in range(nx + nu):
                sides = []
                for sign in (1.0, -1.0):
                    moved = point.copy()
                    moved[i] += sign * _STEP * scale[i]
                    at = moved[:nx], moved[nx:], t
                    sides.append((moved[i], np.concatenate([self.derivatives(*at), self.outputs(*at)])))
                (high, above), (low, below) = sides
                columns[self._rows, i] = ((above - below) / (high - low))[self._rows]
        return Jacobians(columns[:nx, :nx], columns[:nx, nx:], columns[nx:, :nx], columns[nx:, nx:])

    def close(self) -> None:
        """Free the instance."""
        self._model.close()

    def __enter__(self) -> ModelEquations:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __del__(self) -> None:
        if hasattr(self, "_model"):
            self.close()

    def __reduce__(self) -> tuple[type[ModelEquations], tuple[FMU]]:
        return ModelEquations, (self.fmu,)

    def _checked(self, x: ArrayLike, u: ArrayLike) -> tuple[Floats, Floats]:
        x, u = np.asarray(x, dtype=np.float64), np.asarray(u, dtype=np.float64)
        for array, names, what in ((x, self.state_names, "x"), (u, self.input_names, "u")):
            if array.shape != (len(names),):
                raise ModelError(
                    f"{what} has the shape {array.shape}, but the FMU {self._model.library.description.name!r} needs "
                    f"{len(names)} numbers: {', '.join(names) or 'none'}."
                )
        if not self._model.component:
            raise FMUError("These equations are closed. Create new ModelEquations from the FMU.")
        return x, u

    def _place(self, x: ArrayLike, u: ArrayLike, t: float) -> None:
        x, u = self._checked(x, u)
        model = self._model

        def place() -> None:
            model.set_time(float(t))
            if model.jumps:  # discrete inputs change in event mode only
                if not np.array_equal(u, model.inputs):
                    model.event(u)
            else:
                model.write_inputs(u)
            model.x[:] = x
            model.write_states()

        self._try(place)

    def _directional(self, seed: Floats, column: Floats) -> None:
        model = self._model
        status = model.library.directional(model.component, self._unknowns, self._knowns, seed, column)
        if status > 1 or status < 0:
            raise CallError(model.library.names["directional"], status)

    def _try(self, action: object) -> None:
        try:
            action()  # type: ignore[operator]
        except (CallError, StopError) as error:
            model = self._model
            raise FMUError(
                f"The FMU {model.library.description.name!r} fails at t = {model.time:g} s: {error}. Evaluate it where its "
                f"equations hold. {model.messages.quoted()}"
            ) from None


__all__ = ["Jacobians", "ModelEquations"]
