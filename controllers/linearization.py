"""The linear model of a plant that is given as equations or as a black box, about a steady state."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np

from bayesftc.controllers._checks import Matrix, as_number, as_vector
from bayesftc.controllers._pulse_responses import realise
from bayesftc.controllers.model import LinearModel
from bayesftc.cosim.block import Floats
from bayesftc.cosim.errors import ModelError, StepSizeError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmu import FMU
from bayesftc.cosim.linear_system import LinearSystem, held
from bayesftc.cosim.state_space import StateSpace
from bayesftc.cosim.timebase import rational_step, show

Names = str | Sequence[str]

INPUT_NOISE = 0.05
"""Process noise where nothing is said: this share of each actuated input's scale, in every sample."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """A plant about an operating point: ``x+ - x = A (x_t - x) + B (u - u0)``, ``y - y0 = C (x_t - x)``, sampled.

    Attributes
    ----------
    A, B, C : ndarray
        Transition in one step, effect of the inputs, and what the outputs are of the state.
    x, u, y : ndarray
        The operating point: a steady state.
    start : ndarray
        The state in which the plant starts.
    inputs, outputs : tuple of str
        Names of the columns of B and the rows of C.
    step : Fraction
        Sample time in seconds.
    """

    A: Floats
    B: Floats
    C: Floats
    x: Floats
    u: Floats
    y: Floats
    start: Floats
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    step: Fraction

    def rows(self, names: Sequence[str]) -> list[int]:
        """Return the places of outputs."""
        return [self.outputs.index(name) for name in names]

    def model(
        self,
        measured: Sequence[str],
        actuated: Sequence[str],
        *,
        noise: Mapping[str, float] | None = None,
        sensors: int | None = None,
        sensor_std: float | Sequence[float] = 0.01,
        disturbance: Matrix | None = None,
    ) -> LinearModel:
        """Return the model of a controller, in the plant's own values; see `LinearModel.from_fmu`."""
        rows, columns = self.rows(measured), [self.inputs.index(name) for name in actuated]
        count = len(rows) if sensors is None else int(as_number("The model has sensors", sensors, least=1, whole=True))
        if count % len(rows):
            raise ModelError(
                f"{count} sensors cannot be shared evenly by {len(rows)} measured outputs; sensor i reads output i modulo their "
                "number."
            )
        order = [rows[i % len(rows)] for i in range(count)]
        std = as_vector("sensor_std", sensor_std, len(rows) if np.shape(sensor_std) == (len(rows),) else count)
        variances = np.array([std[i % len(std)] for i in range(count)]) ** 2
        model = LinearModel(
            self.A, self.B[:, columns], self.C[order], self._noise(actuated, noise), variances, self.step
        )
        if disturbance is not None and disturbance is not False:
            model = model.with_disturbance(disturbance)
        if not (self.x.any() or self.u.any() or self.y.any()):
            return model
        # Inputs that are not actuated stay as they are at the operating point, and so are part of what is steady.
        return model.about(self.x, self.u[columns], self.y[order])

    def _noise(self, actuated: Sequence[str], noise: Mapping[str, float] | None) -> Floats:
        if noise is None:
            noise = {name: INPUT_NOISE * max(1.0, abs(self.u[self.inputs.index(name)])) for name in actuated}
        Q = np.zeros_like(self.A)
        for name, std in noise.items():
            effect = self.B[:, self.inputs.index(name)] * as_number(f"The noise has {name}", std, least=0)
            Q += np.outer(effect, effect)
        return Q


def linearize(
    plant: Any,
    *,
    measured: Names,
    actuated: Names,
    others: Names = (),
    noise: Mapping[str, float] | None = None,
    dt: float | str | Fraction | None = None,
    at: Mapping[str, float] | None = None,
    order: int | None = None,
) -> Linearization:
    """Return a plant about a steady state; `others` are outputs that are to be in it beside those that are measured."""
    inputs = list(dict.fromkeys([*names_of(actuated, "actuated"), *(noise or {})]))
    outputs = list(dict.fromkeys([*names_of(measured, "measured"), *([others] if isinstance(others, str) else others)]))
    if isinstance(plant, str | PathLike):
        plant = FMU(plant)
    if isinstance(plant, FMU):
        return _of_fmu(plant, inputs, outputs, dt, at or {}, order)
    block = plant if isinstance(plant, StateSpace) else StateSpace(plant)
    if order is not None:
        raise ModelError("order= is for an FMU whose states are not seen; leave it out.")
    if not isinstance(block.system, LinearSystem):
        return _of_nonlinear(block, inputs, outputs, dt, at or {})
    return _of_linear(block.system, np.array(block.initial), inputs, outputs, dt, at or {})


def names_of(given: Names, what: str) -> list[str]:
    """Return names as a list.

    Raises
    ------
    ModelError
        If there is none, or one stands twice.
    """
    names = [given] if isinstance(given, str) else list(given)
    if not names or len(set(names)) < len(names) or not all(isinstance(name, str) for name in names):
        raise ModelError(f"{what}={given!r}; it must name at least one variable of the plant, each once.")
    return names


def _places(names: Sequence[str], known: Sequence[str], what: str) -> list[int]:
    for name in names:
        if name not in known:
            raise UnknownNameError(f"The plant has no {what} {name!r}; {did_you_mean(name, known)}")
    return [list(known).index(name) for name in names]


def _operating(inputs: Sequence[str], start: Floats, at: Mapping[str, float]) -> Floats:
    """Return the inputs at the operating point: their start values, but for those that are given."""
    u = np.array(start, dtype=np.float64)
    for place, name in zip(_places(list(at), inputs, "input"), at, strict=True):
        u[place] = as_number(f"The operating point has {name}", at[name])
    return u


# --- systems of python-control ---------------------------------------------------------------------------------------


def _of_linear(
    system: LinearSystem,
    start: Floats,
    inputs: list[str],
    outputs: list[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float],
) -> Linearization:
    if at:
        raise ModelError("A linear system is the same everywhere; leave at= out.")
    a, b, c, d = system.matrices()
    columns = _places(inputs, system.input_names, "input")
    rows = _places(outputs, system.output_names, "output")
    step = _step(system.dt, dt)
    if system.dt == 0:
        a, b = held(a, b, float(step))
    _refuse_direct(d[np.ix_(rows, columns)])
    zeros = np.zeros(len(a)), np.zeros(len(columns)), np.zeros(len(rows))
    return Linearization(a, b[:, columns], c[rows], *zeros, start, tuple(inputs), tuple(outputs), step)


def _of_nonlinear(
    block: StateSpace, inputs: list[str], outputs: list[str], dt: float | str | Fraction | None, at: Mapping[str, float]
) -> Linearization:
    import control

    system = block.system
    known_inputs = [port.name for port in block.inputs if port.draw is None]
    u = _operating(known_inputs, np.zeros(len(known_inputs)), at)
    columns = _places(inputs, known_inputs, "input")
    rows = _places(outputs, [port.name for port in block.outputs], "output")
    x = np.array(block.initial, dtype=np.float64)
    params = None if block.params is None else dict(block.params)

    def residual(x: Floats, u: Floats) -> Floats:
        change = np.asarray(system.dynamics(0.0, x, u, params or {}), dtype=np.float64)
        return change if system.dt == 0 else change - x

    x, u = _rest(residual, x, u, columns)
    linear = control.linearize(system, x, u, params=params)
    y = np.asarray(system.output(0.0, x, u, params or {}), dtype=np.float64)
    step = _step(system.dt, dt)
    a, b, c, d = (np.asarray(matrix, dtype=np.float64) for matrix in (linear.A, linear.B, linear.C, linear.D))
    if system.dt == 0:
        a, b = held(a, b, float(step))
    _refuse_direct(d[np.ix_(rows, columns)])
    return Linearization(
        a, b[:, columns], c[rows], x, u[columns], y[rows], np.array(block.initial), tuple(inputs), tuple(outputs), step
    )


def _step(own: float | None, asked: float | str | Fraction | None) -> Fraction:
    if own and own is not True:
        step = rational_step(own)
        if asked is not None and rational_step(asked) != step:
            raise StepSizeError(
                f"The system's sample time is {own:g} s, but dt={asked!r} was asked; resample it first."
            )
        return step
    if asked is None:
        raise StepSizeError("Give dt= in seconds, at which the plant is to be controlled.")
    return rational_step(asked)


# --- FMUs ------------------------------------------------------------------------------------------------------------


def _of_fmu(
    fmu: FMU,
    inputs: list[str],
    outputs: list[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float],
    order: int | None,
) -> Linearization:
    step = _fmu_step(fmu, dt)
    every = list(dict.fromkeys([*inputs, *at]))
    fmu = replace(fmu, inputs=every, outputs=outputs)
    for port in (*(fmu.inputs or ()), *(fmu.outputs or ())):
        if port.shape:  # type: ignore[union-attr]
            raise ModelError(f"{port.name!r} of the FMU is an array; only scalars can be measured and actuated here.")  # type: ignore[union-attr]
    start = [port.default or 0.0 for port in fmu.inputs or ()]  # type: ignore[union-attr]
    u = _operating(every, np.array(start), at)
    if fmu.description.exchange is not None and order is None:
        return _of_equations(fmu, u, len(inputs), tuple(inputs), tuple(outputs), step)
    found = realise(fmu, step, u, np.maximum(np.abs(u[: len(inputs)]), 1.0), order)
    if found.waited and not at:
        warnings.warn(
            f"The plant {fmu.default_name!r} does not rest at its start; it was left alone for {show(found.waited)} s, and the "
            f"model is about where it came to rest, at the outputs {found.y.tolist()}. If it is to be controlled elsewhere, "
            "give other start values or inputs (at=...).",
            stacklevel=4,
        )
    point = np.zeros(len(found.A)), u[: len(inputs)], found.y, found.start
    return Linearization(found.A, found.B, found.C, *point, tuple(inputs), tuple(outputs), step)


def _of_equations(
    fmu: FMU, u: Floats, count: int, inputs: tuple[str, ...], outputs: tuple[str, ...], step: Fraction
) -> Linearization:
    from bayesftc.cosim._exchange.equations import ModelEquations

    with ModelEquations(fmu) as model:
        x, u = _rest(model.derivatives, model.x0, u, list(range(count)), model.nominals)
        a, b, c, d = model.jacobians(x, u)
        y, start = model.outputs(x, u), model.x0
    _refuse_direct(d[:, :count])
    A, B = held(a, b, float(step))
    return Linearization(A, B[:, :count], c, x, u[:count], y, start, inputs, outputs, step)


def _fmu_step(fmu: FMU, dt: float | str | Fraction | None) -> Fraction:
    if dt is None:
        own = fmu.description.default_experiment.get("stepSize")
        if own is None:
            raise StepSizeError(
                "The FMU recommends no step size; give dt= in seconds, at which it is to be controlled."
            )
        dt = own
    return rational_step(dt)


def _rest(
    residual: Any, x: Floats, u: Floats, free: Sequence[int], scale: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return a state and inputs at which nothing changes: where it starts, else near there, with other inputs if it must be.

    Raises
    ------
    ModelError
        If there is none.
    """
    from scipy.optimize import least_squares

    size = np.maximum(np.abs(x), 1.0 if scale is None else scale)
    n = len(x)

    def change(z: Floats) -> Floats:
        inputs = u.copy()
        if len(z) > n:
            inputs[list(free)] = z[n:]
        return np.asarray(residual(z[:n] * size, inputs)) / size

    z = x / size
    if np.abs(change(z)).max(initial=0.0) <= 1e-9:
        return x, u
    for start in (z, np.concatenate([z, u[list(free)]])):
        found = least_squares(change, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(found.fun).max() <= 1e-8:
            inputs = u.copy()
            if len(start) > n:
                inputs[list(free)] = found.x[n:]
            return found.x[:n] * size, inputs
    raise ModelError(
        "No steady state was found: no state near the start at which nothing changes, whatever the actuated inputs. Give other "
        "start values, or other inputs (at=...)."
    )


def _refuse_direct(D: Floats) -> None:
    if np.any(D != 0):
        raise ModelError(
            "An output depends at once on an input (D is not 0), which the model y = C x cannot express; measure another output, "
            "or delay the input."
        )
