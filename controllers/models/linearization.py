"""Linearise a plant, given as equations or as a black box, about a steady state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import LARGEST, Matrix, as_number, as_vector
from bayesftc.controllers.models.differences import derivative
from bayesftc.controllers.models.disturbances import lag_of
from bayesftc.controllers.models.fmu.ports import fmu_ports
from bayesftc.controllers.models.integrators import without_integrators
from bayesftc.controllers.models.linear import LinearModel, SignalNames
from bayesftc.controllers.models.names import (
    Names,
    check_by_name,
    chosen,
    names_of,
    operating,
    places_of,
    sensors_of,
    spread,
)
from bayesftc.controllers.models.pulse_responses import SUBSTEPS, realise
from bayesftc.controllers.models.steady_state import steady_state
from bayesftc.cosim.base.timebase import rational_step, show
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.block import Block
from bayesftc.cosim.blocks.linear_system import LinearSystem, held, is_system
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.control.differences import equations, parted
from bayesftc.cosim.errors import ModelError, StepSizeError, brief
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats

INPUT_NOISE = 0.05
"""Default process noise: this share of each actuated input's scale, in every sample."""

_STEADY = 1e-3
"""Distance of an output at the start from its steady value, relative to its size or 1, up to which nobody need know of it."""

_NEGLIGIBLE = 1e-12
"""An effect of a control below this, relative to the states' size or 1, counts as rounding."""

_EXPLODING = 10.0
"""Growth of a mode in a step from which on a plant's integration probably diverges."""

_QUANTITIES = {
    "A": "The matrix A",
    "B": "The matrix B",
    "C": "The matrix C",
    "x": "The steady state",
    "u": "The steady input",
    "y": "The steady output",
    "start": "The start",
}
"""Names of a linearisation's numbers in messages."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """A plant about an operating point: ``x+ - x = A (x_t - x) + B (u - u0)``, ``y - y0 = C (x_t - x)``, sampled.

    Attributes
    ----------
    A, B, C : ndarray
        Transition in one step, effect of the inputs, and map from the state to the outputs.
    x, u, y : ndarray
        The operating point: a steady state, or one of steady motion.
    start : ndarray
        The state in which the plant starts.
    inputs, outputs : tuple of str
        Names of the columns of B and the rows of C; elements of vectors and matrices as ``"y[1]"``, ``"T[0,1]"``.
    step : Fraction
        Sample time in seconds.
    following : ndarray or None
        The state one step after x in a steady motion, where integrators (a position) change; None if it is x.
    states : tuple of str
        Names of the states; empty if they have none.
    held : tuple of (str, float)
        Inputs whose value at the operating point was given, with that value.
    D : ndarray or None
        Direct effect of the inputs on the outputs; None if there is none.
    loads : ndarray
        Variances of the changes of loads in one sample; the loads are the last states.
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
    following: Floats | None = None
    states: tuple[str, ...] = ()
    held: tuple[tuple[str, float], ...] = ()
    D: Floats | None = None
    loads: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        # Algorithms of linear algebra fail on such numbers with errors that do not name the plant.
        for name in ("A", "B", "C", "x", "u", "y", "start"):
            _refuse_huge(name, getattr(self, name), self.step)

    def seen(self) -> Linearization:
        """Return the linearisation without integrators that no output sees, such as the position behind a speed."""
        quotient = without_integrators(self.A, self.C)
        if quotient is None:
            return self
        x, start = quotient.rows @ self.x, quotient.rows @ self.start
        following = None if self.following is None else quotient.rows @ self.following
        if following is not None and np.allclose(following, x, rtol=1e-9, atol=1e-12):
            following = None
        return replace(
            self,
            A=quotient.of(self.A),
            B=quotient.rows @ self.B,
            C=self.C @ quotient.back,
            x=x,
            start=start,
            following=following,
            states=_kept(self.states, quotient.rows),
        )

    def with_loads(self, loads: Mapping[str, Sequence[float]]) -> Linearization:
        """Return the linearisation with loads at inputs as further states: lags that noise drives, each (std, time constant)."""
        lags = {j: lag_of(name, pair, self.step) for name, pair in loads.items() for j in self.columns([name])}
        columns, n, k = list(lags), len(self.A), len(lags)
        keep, changes = np.array(list(lags.values())).T
        names = [self.inputs[j] for j in columns]
        states = self.states or tuple(f"x[{i}]" for i in range(n))
        return replace(
            self,
            A=np.block([[self.A, self.B[:, columns]], [np.zeros((k, n)), np.diag(keep)]]),
            B=np.vstack([self.B, np.zeros((k, len(self.inputs)))]),
            C=np.hstack([self.C, np.zeros((len(self.C), k)) if self.D is None else self.D[:, columns]]),
            x=np.append(self.x, np.zeros(k)),
            start=np.append(self.start, np.zeros(k)),
            following=None if self.following is None else np.append(self.following, np.zeros(k)),
            states=(*states, *(f"load {name}" if name in states else name for name in names)),
            loads=tuple(changes),
        )

    def rows(self, names: Sequence[str]) -> list[int]:
        """Return the indices of outputs; a vector's name stands for all its elements."""
        return places_of(names, self.outputs, "output")

    def columns(self, names: Sequence[str]) -> list[int]:
        """Return the indices of inputs; a vector's name stands for all its elements."""
        return places_of(names, self.inputs, "input")

    def model(
        self,
        measured: Sequence[str],
        actuated: Sequence[str],
        *,
        noise: Mapping[str, float | Sequence[float]] | None = None,
        sensors: int | Sequence[int] | None = None,
        sensor_std: float | Sequence[float] = 0.01,
        disturbance: Matrix | None = None,
    ) -> LinearModel:
        """Return the model for a controller, in the plant's values; see `LinearModel.from_fmu`."""
        rows, columns = self.rows(measured), self.columns(actuated)
        order, variances = sensors_of(rows, sensors, sensor_std)
        names = SignalNames(
            tuple(self.inputs[j] for j in columns),
            tuple(self.outputs[i] for i in order),
            self.states or tuple(f"x[{i}]" for i in range(len(self.A))),
        )
        covariances = self._noise(columns, noise), variances
        noisy = [] if noise is None else list(spread("The noise", noise, self.inputs))
        effects = tuple((self.inputs[j], tuple(self.B[:, j].tolist())) for j in noisy)
        model = LinearModel(
            self.A, self.B[:, columns], self.C[order], *covariances, self.step, names=names, noise_effects=effects
        )
        if disturbance is not None and disturbance is not False:
            model = model.with_disturbance(disturbance)
        if not (self.x.any() or self.u.any() or self.y.any()):
            return model
        # Inputs that are not actuated keep their values at the operating point, and belong to the steady state.
        model = model.about(self.x, self.u[columns], self.y[order], following=self.following)
        actuated_names = {self.inputs[j] for j in columns}
        return replace(model, held_inputs=tuple(pair for pair in self.held if pair[0] not in actuated_names))

    def _noise(self, actuated: Sequence[int], noise: Mapping[str, float | Sequence[float]] | None) -> Floats:
        first = len(self.A) - len(self.loads)
        of_loads = np.diag([*np.zeros(first), *self.loads])
        return covariance_by_inputs(self.B, self.u, self.inputs, actuated, noise) + of_loads


def covariance_by_inputs(
    B: Floats,
    u: Floats,
    inputs: Sequence[str],
    actuated: Sequence[int],
    noise: Mapping[str, float | Sequence[float]] | None,
) -> Floats:
    """Return the process covariance of noise at inputs with the effect B; by default at the actuated ones."""
    std = {j: INPUT_NOISE * max(1.0, abs(u[j])) for j in actuated}
    if noise is not None:
        std = spread("The noise", noise, inputs)
    Q = np.zeros((len(B), len(B)))
    for j, size in std.items():
        effect = B[:, j] * as_number(f"The noise has {inputs[j]}", size, least=0)
        Q += np.outer(effect, effect)
    return Q


def linearize(
    plant: Any,
    *,
    measured: Names,
    actuated: Names,
    others: Names = (),
    noise: Mapping[str, float | Sequence[float]] | None = None,
    loads: Mapping[str, Sequence[float]] | None = None,
    dt: float | str | Fraction | None = None,
    at: Mapping[str, float | Sequence[float]] | None = None,
    order: int | None = None,
    limits: tuple[object, object] | None = None,
) -> Linearization:
    """Linearise a plant about a steady state; `others` are outputs of the model besides the measured ones.

    `limits` are those of the actuated inputs, u_min and u_max. A steady state is searched from their middle as well.
    """
    check_by_name(noise=noise, at=at, loads=loads)
    driven = names_of(actuated, "actuated")
    inputs = list(dict.fromkeys([*driven, *(noise or {}), *(loads or {})]))
    outputs = list(dict.fromkeys([*names_of(measured, "measured"), *([others] if isinstance(others, str) else others)]))
    if isinstance(plant, str | PathLike):
        plant = FMU(plant)
    if isinstance(plant, FMU):
        return _seen(_of_fmu(plant, (inputs, driven), outputs, dt, at or {}, order, limits), loads or {})
    check_plant(plant)
    block = plant if isinstance(plant, StateSpace) else StateSpace(plant)
    states = _state_names(block.system, len(np.array(block.initial)))
    if order is not None:
        raise ModelError("order= is only for an FMU whose states are not accessible; leave it out.")
    if not isinstance(block.system, LinearSystem):
        linear = _of_nonlinear(block, (inputs, driven), outputs, dt, at or {}, limits)
    else:
        linear = _of_linear(block.system, np.array(block.initial), inputs, outputs, dt, at or {})
    return _seen(replace(linear, states=states), loads or {})


def _seen(linear: Linearization, loads: Mapping[str, Sequence[float]]) -> Linearization:
    """Return the linearisation without what no output sees, and with loads; only these may act on an output directly."""
    if linear.D is not None and np.delete(linear.D, linear.columns(list(loads)), axis=1).any():
        raise ModelError(
            "An output depends directly on an input (D is not 0, a relative degree of 0), which the model y = C x cannot "
            "represent. Measure another output. If the input is a load, such as a gust, name it in loads=, in place of noise=. "
            "If it is the control, put a lag before it: in the plant itself, in its matrices or its FMU, because a block before "
            "the plant is not seen here."
        )
    return linear.seen().with_loads(loads) if loads else linear.seen()


def _state_names(system: Any, states: int) -> tuple[str, ...]:
    """Return the names of a system's states; nothing if it does not have one for each."""
    names = tuple(system.state_names if isinstance(system, LinearSystem) else system.state_labels or ())
    return names if len(names) == states == len(set(names)) else ()


def _kept(names: tuple[str, ...], rows: Floats) -> tuple[str, ...]:
    """Return the names of the states that the rows of a quotient select; nothing if a row mixes states."""
    places = [int(np.argmax(row)) for row in rows]
    return tuple(names[i] for i in places) if names and np.array_equal(rows, np.eye(len(names))[places]) else ()


def check_plant(plant: Any) -> None:
    """Refuse a plant of another type, in the words of the plant, not of a block.

    Raises
    ------
    ModelError
        If it is none of which a linear model can be made.
    """
    if not (isinstance(plant, str | PathLike | FMU | StateSpace) or is_system(plant)):
        of_blocks = ""
        if isinstance(plant, Block):
            of_blocks = " Export a plant of blocks as an FMU: cosim.export_fmu(plant, 'plant.fmu', dt=...)."
        raise ModelError(
            "The plant must be an FMU (cosim.FMU(path)), a system of python-control or its block cosim.StateSpace; for matrices "
            f"give control.ss(A, B, C, D, dt), or a LinearModel. It is {brief(plant)}.{of_blocks}"
        )


def refuse_unmoved(linear: Linearization, actuated: Sequence[str]) -> None:
    """Refuse controls without effect at the operating point, such as a spring's stiffness where the spring is at rest.

    Raises
    ------
    ModelError
        With the name of the control.
    """
    size = max(1.0, *(float(np.abs(v).max(initial=0.0)) for v in (linear.x, linear.y)))
    for j in linear.columns(actuated):
        if float(np.abs(linear.B[:, j]).max(initial=0.0)) * max(1.0, abs(linear.u[j])) <= _NEGLIGIBLE * size:
            grows = (
                float(np.abs(np.linalg.eigvals(linear.A)).max(initial=0.0)) if np.isfinite(linear.A).all() else np.inf
            )
            if grows > _EXPLODING:
                raise ModelError(
                    f"{linear.inputs[j]} has no effect that could be seen beside a mode of the plant that grows {grows:.3g}-fold "
                    f"in each step of {show(linear.step)} s. Probably its integration diverges: give a smaller dt; {SUBSTEPS}."
                )
            raise ModelError(
                f"{linear.inputs[j]} has no effect about the operating point, so it cannot control the plant. Use another input, "
                "or an operating point at which it has an effect (start values, or at=...)."
            )


def refuse_unmoving(linear: Linearization, measured: Sequence[str]) -> None:
    """Refuse measured outputs of which no state of the model moves any: their sensors see nothing.

    Raises
    ------
    ModelError
        With the names of the outputs.
    """
    if measured and not any(linear.C[i].any() for i in linear.rows(measured)):
        raise ModelError(
            f"{' and '.join(measured)}: no state of the model moves what is measured, so the sensors see nothing of the plant. "
            "Measure another output, or give an operating point at which it changes (start values, or at=...)."
        )


# --- systems of python-control ---------------------------------------------------------------------------------------


def _of_linear(
    system: LinearSystem,
    start: Floats,
    inputs: list[str],
    outputs: list[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]],
) -> Linearization:
    if at:
        raise ModelError(
            "A linear system does not depend on the operating point; leave at= out. If one of its inputs is constant, as the "
            "temperature outside, write the system in deviations from the steady state that it causes, or make the input a state "
            "with a long lag that starts at this value (docs/how-to/constant-disturbances.md). disturbance= estimates an unknown "
            "load where the control acts."
        )
    a, b, c, d = system.matrices()
    columns, into = chosen(inputs, system.input_names, "input")
    rows, out = chosen(outputs, system.output_names, "output")
    step = _step(system.dt, dt)
    if system.dt == 0:
        a, b = _sampled(a, b, step)
    zeros = np.zeros(len(a)), np.zeros(len(columns)), np.zeros(len(rows))
    return Linearization(a, b[:, columns], c[rows], *zeros, start, into, out, step, D=d[np.ix_(rows, columns)])


def _of_nonlinear(
    block: StateSpace,
    driven: tuple[list[str], list[str]],
    outputs: list[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]],
    limits: tuple[object, object] | None,
) -> Linearization:
    """Linearise a nonlinear system; `driven` are the inputs of the linearisation, and those of them that are actuated."""
    system, (inputs, actuated) = block.system, driven
    known_inputs = [port.name for port in block.inputs if port.draw is None]
    u = operating(known_inputs, np.zeros(len(known_inputs)), at)
    columns, into = chosen(inputs, known_inputs, "input")
    rows, out = chosen(outputs, [port.name for port in block.outputs], "output")
    x = np.array(block.initial, dtype=np.float64)
    n, both = len(x), equations(block)

    def residual(x: Floats, u: Floats) -> Floats:
        change = both(np.concatenate([x, u]))[:n]
        return change if system.dt == 0 else change - x

    free = _free(actuated, known_inputs, at)
    x, u, rate = steady_state(
        residual,
        x,
        u,
        free,
        stated=False,
        inside=_inside(limits, actuated, known_inputs, free, u),
        names=_state_names(system, n),
        per="second" if system.dt == 0 else "sample",
    )
    with np.errstate(over="ignore", invalid="ignore"):  # a result that is not finite is refused
        whole = derivative(both, np.concatenate([x, u]))
    a, b, c, d = parted(whole, n)
    y = both(np.concatenate([x, u]))[n:]
    step = _step(system.dt, dt)
    if system.dt == 0:
        a, b = _sampled(a, b, step)
    following = None if rate is None else x + rate * (float(step) if system.dt == 0 else 1.0)
    point = x, u[columns], y[rows], np.array(block.initial)
    held, direct = _held(known_inputs, at), d[np.ix_(rows, columns)]
    return Linearization(a, b[:, columns], c[rows], *point, into, out, step, following, held=held, D=direct)


def _step(default_step: float | None, dt: float | str | Fraction | None) -> Fraction:
    if default_step and default_step is not True:
        step = rational_step(default_step)
        if dt is not None and rational_step(dt) != step:
            raise StepSizeError(
                f"The system's sample time is {default_step:g} s, but dt={dt!r} is given; resample the system first."
            )
        return step
    if dt is None:
        raise StepSizeError(
            "The plant is a system without a sample time, so that of the controller is not known. Give it in seconds: dt=0.01, "
            "or dt = 0.01 in [simulation] (not in [plant]) of a scenario file."
        )
    return rational_step(dt)


# --- FMUs ------------------------------------------------------------------------------------------------------------


def _of_fmu(
    fmu: FMU,
    driven: tuple[list[str], list[str]],
    outputs: list[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]],
    order: int | None,
    limits: tuple[object, object] | None,
) -> Linearization:
    """Linearise an FMU; `driven` are the inputs of the linearisation, and those of them that are actuated."""
    inputs, actuated = driven
    fmu, step, u, (columns, names), (rows, measured), into = fmu_ports(fmu, inputs, outputs, dt, at)
    if fmu.description.exchange is not None and order is None:
        free = _free(actuated, into, at)
        inside = _inside(limits, actuated, into, free, u)
        linear = _of_equations(fmu, u, columns, rows, names, measured, step, free, inside)
        return replace(linear, held=_held(into, at))
    realisation = realise(fmu, step, u, {j: max(abs(float(u[j])), 1.0) for j in columns}, rows, order)
    point = np.zeros(len(realisation.A)), u[columns], realisation.y, realisation.start
    matrices = realisation.A, realisation.B, realisation.C
    linear = Linearization(*matrices, *point, names, measured, step, held=_held(into, at))
    if realisation.waited and starts_elsewhere(linear) and not at:
        warn_user(
            f"The plant {fmu.default_name!r} is not steady at its start. It ran {show(realisation.waited)} s with its "
            "inputs at their start values, and the model is about the steady state that it reached, with "
            f"{_point(measured, realisation.y)}. For another operating point give start values or inputs (at=...)."
        )
    return linear


def starts_elsewhere(linear: Linearization) -> bool:
    """Return whether the plant starts so far from the operating point that its outputs are others."""
    off = np.abs(linear.C @ (linear.start - linear.x)) > _STEADY * np.maximum(np.abs(linear.y), 1.0)
    return bool(off.any())


def _point(names: Sequence[str], values: Floats) -> str:
    """Return the outputs at an operating point as text. What is negligible beside the largest one, or 1, is 0."""
    size = max(1.0, float(np.abs(values).max(initial=0.0)))
    shown = np.where(np.abs(values) < 1e-8 * size, 0.0, values)
    return ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, shown, strict=True))


def _of_equations(
    fmu: FMU,
    u: Floats,
    columns: list[int],
    rows: list[int],
    inputs: tuple[str, ...],
    outputs: tuple[str, ...],
    step: Fraction,
    free: Sequence[int],
    inside: Floats | None,
) -> Linearization:
    from bayesftc.cosim.fmi.equations import ModelEquations

    with ModelEquations(fmu) as model:
        if not len(model.x0):
            raise ModelError(
                f"The FMU {fmu.default_name!r} has no state. Its outputs depend directly on its inputs (a relative degree of 0), "
                "so there are no dynamics to control. Solve for the input, or put the FMU in front of a plant with states."
            )
        x, u, rate = steady_state(
            model.derivatives, model.x0, u, free, scale=model.nominals, inside=inside, names=model.state_names
        )
        a, b, c, d = model.jacobians(x, u)
        y, start, states = model.outputs(x, u), model.x0, model.state_names
    A, B = _sampled(a, b, step)
    following = None if rate is None else x + float(step) * rate
    point, direct = (x, u[columns], y[rows], start), d[np.ix_(rows, columns)]
    return Linearization(A, B[:, columns], c[rows], *point, inputs, outputs, step, following, states, D=direct)


def _free(actuated: Sequence[str], inputs: Sequence[str], at: Mapping[str, Any]) -> list[int]:
    """Return the actuated inputs that may change for a steady state: those without a given value. A noise input may not."""
    given = spread("The operating point", at, inputs)
    return [j for j in chosen(actuated, inputs, "input")[0] if j not in given]


def _held(inputs: Sequence[str], at: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
    """Return the inputs whose value at the operating point is given, with that value."""
    return tuple((inputs[j], float(value)) for j, value in spread("The operating point", at, inputs).items())


def _inside(
    limits: tuple[object, object] | None, actuated: Sequence[str], inputs: Sequence[str], free: Sequence[int], u: Floats
) -> Floats | None:
    """Return values of the free inputs within the limits of the actuated ones: the middle, or the nearest to u without one."""
    if limits is None:
        return None
    driven = chosen(actuated, inputs, "input")[0]
    low, high = (
        as_vector(name, of, len(driven), finite=False) for name, of in zip(("u_min", "u_max"), limits, strict=True)
    )
    with np.errstate(invalid="ignore"):
        middle = np.where(np.isfinite(high - low), (low + high) / 2, np.clip(u[driven], low, high))
    return middle[[driven.index(j) for j in free]]


def _sampled(a: Floats, b: Floats, step: Fraction) -> tuple[Floats, Floats]:
    """Return A and B of a sample of equations in continuous time; where they overflow, `Linearization` refuses them."""
    for name, matrix in {"A": a, "B": b}.items():
        _refuse_huge(name, matrix)
    with np.errstate(over="ignore", invalid="ignore"):
        return held(a, b, float(step))


def _refuse_huge(name: str, array: Floats, step: Fraction | None = None) -> None:
    """Refuse numbers of the plant with which matrices cannot be computed; `step` is the sample time of A and B, if sampled."""
    if array.size and not float(np.abs(array).max()) <= LARGEST:  # NaN is not
        entry = array[~(np.abs(array) <= LARGEST)][0]
        sampled = "" if step is None or name not in "AB" else f" (the change in one sample of {show(step)} s)"
        remedy = "choose another operating point (at=...), or units in which it is smaller"
        raise ModelError(
            f"{_QUANTITIES[name]} of the plant{sampled} has the entry {entry:.3g}; at most {LARGEST:g} is allowed. Check its "
            f"equations, {'give a smaller dt=..., ' if sampled else ''}{remedy}."
        )
