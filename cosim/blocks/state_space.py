"""Systems of python-control as blocks: linear systems compiled, nonlinear systems by their own Python functions."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.array_ports import gathered
from bayesftc.cosim.base.numbers import counted, reals
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.blocks.linear_system import LinearSystem, as_rows, held, normalised, signal_names
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, brief, did_you_mean
from bayesftc.cosim.ports import Port
from bayesftc.cosim.types import Floats

logger = logging.getLogger("bayesftc.state_space")
logger.addHandler(logging.NullHandler())  # without a handler, logging prints warnings to stderr

NOISE = "process_noise"

_TRIALS = (1.0, -1.0, 1e6, -1e6, np.nan)
"""Values of an input at which the outputs are compared with those at zero."""

if TYPE_CHECKING:
    Vector = ArrayLike
    Matrix = ArrayLike
else:  # at run time: the types that scenario files are checked against
    Vector, Matrix = Sequence[float], Sequence[Sequence[float]]


# A port and a state of a block cannot share a name. The names below begin with system_, which no signal is likely to do.


def _plus_row(total, matrix, i, vector):
    """Return `total` plus the product of row `i` of the matrix with the vector."""
    for j in range(matrix.shape[1]):
        total = total + matrix[i, j] * vector[j]
    return total


def _output_state(outputs, system_x, system_c):
    for i in range(system_c.shape[0]):
        outputs[i] = _plus_row(0.0, system_c, i, system_x)


def _output_both(inputs, outputs, system_x, system_c, system_d):
    for i in range(system_c.shape[0]):
        outputs[i] = _plus_row(_plus_row(0.0, system_c, i, system_x), system_d, i, inputs)


def _output_inputs(inputs, outputs, system_d):
    for i in range(system_d.shape[0]):
        outputs[i] = _plus_row(0.0, system_d, i, inputs)


def _update(inputs, system_x, system_next, system_a, system_b):
    for i in range(system_a.shape[0]):
        system_next[i] = _plus_row(_plus_row(0.0, system_a, i, system_x), system_b, i, inputs)
    for i in range(system_a.shape[0]):
        system_x[i] = system_next[i]


@dataclass(frozen=True)
class StateSpace(Block):
    """A system of python-control as a block: each of its signals becomes a scalar port.

    A continuous linear system is discretised exactly at the block's step, with its inputs held during a step (zero-order
    hold). A continuous nonlinear system is integrated over each step by ``scipy.integrate.solve_ivp``. A discrete system runs at
    its own sample time only. Linear systems run in compiled code. Nonlinear systems call back into Python, so that the loop runs
    in Python.

    Ports have the names of the signals. Signals without names are called ``u`` and ``y``, or ``u0``, ``u1`` and so on.

    Parameters
    ----------
    system : control.StateSpace, control.TransferFunction, control.NonlinearIOSystem or LinearSystem
        The system; an ``InterconnectedSystem`` is one of these. After construction a linear system is a `LinearSystem`.
    initial : sequence of float, optional
        Initial state, n numbers; zeros by default.
    process_noise : matrix of float, optional
        Covariance, n x n, of Gaussian noise that is added to the state at every step, for any step size. The block then has
        a random input ``process_noise`` of n independent standard normal numbers.
    feedthrough : bool or sequence of str, optional
        For nonlinear systems: whether the outputs depend on the inputs at the same instant, or the names of the inputs on
        which they do. By default this is found by trials at the initial state, and checked at each step. For linear systems D
        determines it.
    params : mapping, optional
        For nonlinear systems: values that are passed to the system's functions.
    method, rtol, atol : str, float, float
        For continuous nonlinear systems: solver and tolerances of ``solve_ivp``.
    units : mapping, optional
        Units of signals, by name, for figures, tables and connections: ``{"force": "N", "v": "m/s"}``.
    arrays : bool
        Whether consecutive signals ``y[0]``, ``y[1]``, python-control's own names, become one port ``y``, as of a controller.
    goal_names : sequence of str, optional
        Of a controller: the measured signals, or states, of the plant that the elements of its goal are for.

    Raises
    ------
    UnknownNameError
        If a name is not that of a signal.
    ModelError
        If the system is none of these, or sizes do not fit; in a run, if the outputs depend on an input without feedthrough.
    StepSizeError
        If a discrete system is run at a step other than its sample time.

    Examples
    --------
    >>> import control
    >>> from bayesftc import cosim
    >>> car = cosim.StateSpace(control.tf([1], [100, 5], inputs=["force"], outputs=["v"]))
    >>> [port.name for port in (*car.inputs, *car.outputs)]
    ['force', 'v']
    """

    system: Any
    initial: Vector | None = field(default=None, kw_only=True)
    process_noise: Matrix | None = field(default=None, kw_only=True)
    feedthrough: bool | Sequence[str] | None = field(default=None, kw_only=True)
    params: Mapping[str, Any] | None = field(default=None, kw_only=True, hash=False)
    method: str = field(default="RK45", kw_only=True)
    rtol: float = field(default=1e-9, kw_only=True)
    atol: float = field(default=1e-12, kw_only=True)
    units: Mapping[str, str] | None = field(default=None, kw_only=True, hash=False)
    arrays: bool = field(default=False, kw_only=True)
    goal_names: Sequence[str] | None = field(default=None, kw_only=True)

    checks_finite: ClassVar[bool] = True

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        if not isinstance(self.system, LinearSystem):
            set_(self, "system", normalised(self.system))
        if isinstance(self.system, LinearSystem) and (self.feedthrough not in (None, True) or self.params is not None):
            raise ModelError(
                "StateSpace has feedthrough=... or params=... for a linear system; leave them out. The matrix D determines "
                "the feedthrough."
            )
        if self.params is not None and not isinstance(self.params, Mapping):
            raise ModelError(
                f"StateSpace has params={brief(self.params)}; it must be values by name, such as {{'m': 1.0}}. A factor of a "
                'campaign names one of them: "plant.params.m".'
            )
        if self.feedthrough is not None and not isinstance(self.feedthrough, bool):
            names = tuple([self.feedthrough] if isinstance(self.feedthrough, str) else self.feedthrough)
            set_(self, "feedthrough", names)
            for name in names:
                if name not in self._names[0]:
                    raise UnknownNameError(f"StateSpace has no input {name!r}; {did_you_mean(name, self._names[0])}")
        if not isinstance(self.arrays, bool):
            raise ModelError(f"StateSpace has arrays={self.arrays!r}; it must be True or False.")
        if self.goal_names is not None:
            set_(self, "goal_names", self._goals())
        self._check_units()
        n = self._states
        initial = np.zeros(n) if self.initial is None else reals(self.initial)
        if initial.shape != (n,) or not np.isfinite(initial).all():
            raise ModelError(
                f"StateSpace has initial={self.initial!r}; it must be {n} finite numbers, one for each state."
            )
        set_(self, "initial", tuple(initial.tolist()))
        if self.process_noise is not None:
            covariance = reals(self.process_noise)
            _factor(covariance, n)
            set_(self, "process_noise", as_rows(covariance))
        if not (self.rtol > 0 and self.atol > 0):
            raise ModelError(f"StateSpace has rtol={self.rtol!r}, atol={self.atol!r}; both must be positive.")

    def _goals(self) -> tuple[str, ...]:
        """Return the names of the goals as a tuple, one for each input ``goal`` or ``goal[0]``, ``goal[1]``."""
        given = [self.goal_names] if isinstance(self.goal_names, str) else self.goal_names
        goals = [name for name in self._names[0] if name.partition("[")[0] == "goal"]
        named = isinstance(given, Sequence) and all(isinstance(name, str) for name in given)
        if given is None or not named or len(given) != len(goals):
            raise ModelError(
                f"StateSpace has goal_names={brief(self.goal_names)}; it must be {counted(len(goals), 'name')}, one for each "
                "element of its goal, such as ['angle']."
            )
        return tuple(given)

    def _check_units(self) -> None:
        units = {} if self.units is None else self.units
        if not isinstance(units, Mapping) or not all(isinstance(unit, str) for unit in units.values()):
            raise ModelError(
                f"StateSpace has units={brief(units)}; they must be texts by the names of signals, such as {{'v': 'm/s'}}."
            )
        known = [name for names in self._names for name in names]
        for name in units:
            if name not in known:
                raise UnknownNameError(
                    f"StateSpace has units of {name!r}, which is no input or output; {did_you_mean(name, known)}"
                )

    @cached_property
    def _fed(self) -> tuple[str, ...]:
        """The inputs of a nonlinear system on which its outputs depend at the same instant."""
        if self.feedthrough is None:
            return _found_feedthrough(self.system, np.array(self.initial), self._names[0], self.params)
        if isinstance(self.feedthrough, bool):
            return self._names[0] if self.feedthrough else ()
        return tuple(self.feedthrough)

    @property
    def inputs(self) -> tuple[Port, ...]:
        """A scalar port for each input signal, and ``process_noise`` if it is set."""
        names = self._names[0]
        if isinstance(self.system, LinearSystem):
            feeds = [any(row[j] != 0.0 for row in self.system.D) for j in range(len(names))]
        else:
            feeds = [name in self._fed for name in names]
        text = "Input of the system"
        ports = [
            Port(name, unit=self._unit(name), feedthrough=feed, default=0.0, description=text)
            for name, feed in zip(names, feeds, strict=True)
        ]
        if self.process_noise is not None:
            ports.append(Port(NOISE, (self._states,), feedthrough=False, draw="normal"))
        return gathered(ports) if self.arrays else tuple(ports)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """A scalar port for each output signal."""
        ports = [Port(name, unit=self._unit(name), description="Output of the system") for name in self._names[1]]
        return gathered(ports) if self.arrays else tuple(ports)

    def _unit(self, name: str) -> str | None:
        return (self.units or {}).get(name)

    @property
    def sample_time(self) -> Fraction | None:
        """The sample time of a discrete system in seconds; None if the system can run at any."""
        dt = self.system.dt
        return None if dt is None or dt is True or dt == 0 else rational_step(float(dt), "The system's sample time")

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        dt = self.sample_time
        if dt is not None and dt != step:
            raise StepSizeError(
                f"The discrete system has a sample time of {show(dt)} s and cannot run every {show(step)} s; change the "
                "diagram's dt or the block's every=, or convert the system."
            )
        noise = None if self.process_noise is None else _factor(np.array(self.process_noise), self._states)
        if isinstance(self.system, LinearSystem):
            return self._define_linear(self.system, float(step), noise)
        return self._define_nonlinear(float(step), noise)

    def outputs_at_start(self) -> Floats | None:
        """Return the outputs at the initial state; None if they depend on an input at the same instant, or are not finite."""
        if any(port.feedthrough for port in self.inputs):
            return None
        x = np.array(self.initial)
        params = None if self.params is None else dict(self.params)
        with np.errstate(all="ignore"):  # the run reports what is not finite
            if isinstance(self.system, LinearSystem):
                y = self.system.matrices()[2] @ x
            else:
                y = np.ravel(self.system.output(0.0, x, np.zeros(len(self._names[0])), params)).astype(np.float64)
        return np.asarray(y) if np.isfinite(y).all() else None

    @property
    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        if isinstance(self.system, LinearSystem):
            return self.system.input_names, self.system.output_names
        return signal_names(self.system)

    @property
    def _states(self) -> int:
        return len(self.system.A) if isinstance(self.system, LinearSystem) else int(self.system.nstates or 0)

    def _define_linear(self, system: LinearSystem, h: float, noise: Floats | None) -> Definition:
        a, b, c, d = system.matrices()
        if not len(a):
            return Definition(_output_inputs, parameters={"system_d": d})
        if system.dt == 0:
            a, b = held(a, b, h)
        if noise is not None:
            b = np.hstack([b, noise])  # the noise is the last of the inputs
        parameters = {"system_a": a, "system_b": b, "system_c": c, "system_d": d}
        state = {"system_x": np.array(self.initial), "system_next": np.zeros(len(a))}
        if d.any():
            return Definition(_output_both, _update, state, parameters)
        del parameters["system_d"]
        return Definition(_output_state, _update, state, parameters)

    def _define_nonlinear(self, h: float, noise: Floats | None) -> Definition:
        system, params = self.system, None if self.params is None else dict(self.params)
        feeds = np.array([name in self._fed for name in self._names[0]], dtype=bool)
        x0, m = np.array(self.initial), len(feeds)
        _check_feedthrough(system, x0, feeds, params)
        doubtful = self.feedthrough is None and not feeds.all()  # what was found by trials at one state

        def output(t, inputs, outputs, system_x):
            # Inputs without feedthrough are not computed yet. Zeros make the result independent of the order of blocks.
            outputs[:] = system.output(t, system_x, np.where(feeds, inputs[:m], 0.0), params)

        def update(t, inputs, outputs, system_x):
            u = inputs[:m].copy()
            if doubtful and not np.array_equal(system.output(t, system_x, u, params), outputs, equal_nan=True):
                raise ModelError(_OTHERWISE)
            if system.dt == 0:
                x = self._integrate(float(t), h, system_x.copy(), u, params)
            else:
                x = np.asarray(system.dynamics(t, system_x, u, params), dtype=np.float64)
            system_x[:] = x if noise is None else x + noise @ inputs[m:]

        kernel = update if len(x0) else None
        return Definition(output, kernel, {"system_x": x0} if len(x0) else {"system_x": np.zeros(0)}, compiled=False)

    def _integrate(self, t: float, h: float, x: Floats, u: Floats, params: dict[str, Any] | None) -> Floats:
        from scipy.integrate import solve_ivp

        def rhs(time: float, state: Floats) -> Any:
            return self.system.dynamics(time, state, u, params)

        solution = solve_ivp(rhs, (t, t + h), x, method=self.method, rtol=self.rtol, atol=self.atol)
        if not solution.success:
            # NaN stops the run at the next instant, with the signals so far; the log has the reason.
            logger.warning("The solver failed between t = %g s and %g s: %s", t, t + h, solution.message)
            return np.full(len(x), np.nan)
        end: Floats = solution.y[:, -1]
        return end


def _factor(covariance: ArrayLike, n: int) -> Floats:
    """Return the lower triangular L with ``L L' = covariance``, which may be singular.

    Unlike eigenvectors, L has no arbitrary signs, so the noise is the same on every machine.
    """
    q = np.asarray(covariance, dtype=np.float64)
    if n == 0 or q.shape != (n, n) or not np.isfinite(q).all():
        raise ModelError(
            f"StateSpace has a process_noise of shape {q.shape}; for {n} states it must be {n} x {n} finite numbers."
        )
    # In units in which the variances are about 1, so that rounding does not depend on those of the states; powers of 2 are exact.
    variances = np.diag(q)
    units = np.exp2(np.round(np.log2(np.where(variances > 0.0, variances, 1.0)) / 2.0))
    q = q / np.outer(units, units)
    lower = np.zeros((n, n))
    for j in range(n):
        pivot = q[j, j] - lower[j, :j] @ lower[j, :j]
        if pivot > 1e-14:
            lower[j, j] = np.sqrt(pivot)
            lower[j + 1 :, j] = (q[j + 1 :, j] - lower[j + 1 :, :j] @ lower[j, :j]) / lower[j, j]
    if not np.allclose(lower @ lower.T, q, rtol=0.0, atol=1e-9):
        raise ModelError(
            "StateSpace has a process_noise that is not a covariance; it must be symmetric, without negative eigenvalues."
        )
    return units[:, None] * lower


_OTHERWISE = (
    "The outputs of the nonlinear system depend on its inputs at the same instant, but not at its initial state, where this was "
    "tried. Give StateSpace feedthrough=True, or the names of these inputs."
)


def _found_feedthrough(
    system: Any, x: Floats, names: tuple[str, ...], params: Mapping[str, Any] | None
) -> tuple[str, ...]:
    """Return the inputs on which the outputs of a nonlinear system depend at a state, by trials; all if it has no state."""
    if not len(x):
        return names
    found = []
    with np.errstate(all="ignore"):
        for j, name in enumerate(names):
            trials = np.zeros((1 + len(_TRIALS), len(names)))
            trials[1:, j] = _TRIALS
            try:
                rest, *others = (np.asarray(system.output(0.0, x, u, params), dtype=np.float64) for u in trials)
            except Exception:  # noqa: BLE001 - a user's function may raise anything for such numbers
                return names
            if not all(np.array_equal(rest, other, equal_nan=True) for other in others):
                found.append(name)
    return tuple(found)


def _check_feedthrough(
    system: Any, x: Floats, feeds: np.ndarray[Any, np.dtype[np.bool_]], params: dict[str, Any] | None
) -> None:
    """Refuse a system whose outputs depend directly on an input that is declared without feedthrough."""
    at_rest = np.asarray(system.output(0.0, x, np.zeros(len(feeds)), params), dtype=np.float64)
    if at_rest.shape != (system.noutputs,):
        raise ModelError(
            f"The system's output function returns an array of shape {at_rest.shape}; it must return {system.noutputs} numbers."
        )
    moved = np.asarray(system.output(0.0, x, np.where(feeds, 0.0, 1.0), params), dtype=np.float64)
    if not np.array_equal(at_rest, moved, equal_nan=True):
        raise ModelError(
            "StateSpace has a feedthrough=... that lacks inputs on which the outputs depend at the same instant; "
            "add these inputs, or use feedthrough=True."
        )


__all__ = ["LinearSystem", "StateSpace"]
