"""Design a fault-tolerant controller for a plant in one call."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from os import PathLike
from typing import Any, Literal

import numpy as np

from bayesftc.controllers.bayesian.linear import UnstableLoopWarning
from bayesftc.controllers.bayesian.lqg import LQGController
from bayesftc.controllers.bayesian.stabilisability import refuse_undetectable, refuse_unstabilisable
from bayesftc.controllers.bayesian.steady import moduli
from bayesftc.controllers.diagnosis.plant_check import ModelMismatchWarning, compare_with_plant
from bayesftc.controllers.estimation.unused import warn_of_unused
from bayesftc.controllers.identification.identify import Identification
from bayesftc.controllers.linalg.riccati import predicted_covariance
from bayesftc.controllers.models.checks import SMALLEST, Matrix, as_covariance, as_number, as_vector, check_limits
from bayesftc.controllers.models.delays import extended_rows, whole_delays
from bayesftc.controllers.models.disturbances import error_variances
from bayesftc.controllers.models.fmu.ports import fmu_ports
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.controllers.models.linearization import (
    INPUT_NOISE,
    Linearization,
    check_plant,
    linearize,
    refuse_unmoved,
    refuse_unmoving,
    starts_elsewhere,
)
from bayesftc.controllers.models.names import Names, check_by_name, elements_of, names_of, places_of, sensors_of
from bayesftc.controllers.precision.base import PrecisionLearner
from bayesftc.controllers.switching.learner import SwitchingPrecision
from bayesftc.cosim.base.announcing import reported
from bayesftc.cosim.base.arguments import with_named_arguments
from bayesftc.cosim.base.numbers import counted
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.blocks.linear_system import LinearSystem, is_system
from bayesftc.cosim.blocks.state_space import StateSpace
from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats

LOAD_STEP = 0.01
"""How far the load of ``disturbance=True`` moves in a sample: this share of each control's scale (a standard deviation)."""

NEARLY_UNSTABLE = 0.1
"""Distance of a loop from instability below which `design` warns."""

CONSTANT = 1e8
"""Number of samples after which an offset of ``sensor_bias`` may be another one: far more than a run has."""


@with_named_arguments
def design(
    plant: Any,
    *,
    goal: Names | Sequence[int] | Matrix | None = None,
    measured: Names | None = None,
    actuated: Names | None = None,
    dt: float | str | Fraction | None = None,
    at: Mapping[str, float | Sequence[float]] | None = None,
    order: int | None = None,
    sensors: int | Sequence[int] | None = None,
    sensor_std: float | Sequence[float] = 0.01,
    sensor_bias: float | Sequence[float] = 0.0,
    noise: Mapping[str, float | Sequence[float]] | None = None,
    loads: Mapping[str, Sequence[float]] | None = None,
    disturbance: Matrix | bool | None = None,
    acceptable_error: float | Sequence[float] = 0.1,
    acceptable_control: float | Sequence[float] | None = None,
    goal_covariance: Matrix | None = None,
    control_covariance: Matrix | None = None,
    precision: PrecisionLearner | None = None,
    belief: Literal["filtered", "joint"] = "filtered",
    u_min: float | Sequence[float] = float("-inf"),
    u_max: float | Sequence[float] = float("inf"),
    u_rate: float | Sequence[float] = float("inf"),
    preview: int = 0,
    input_delays: int | Sequence[int] = 0,
    sensor_delays: int | Sequence[int] = 0,
    initial_mean: float | Sequence[float] | None = None,
    initial_spread: float = 10.0,
    initial_control: float | Sequence[float] | None = None,
) -> LQGController:
    """Return a fault-tolerant controller for a plant, a block for `bayesftc.cosim.closed_loop`.

    The plant is linearised about a steady state (see `LinearModel.from_fmu`). The result is an `LQGController` for that model:
    it brings the goal outputs to the goal with redundant sensors that may fail (`precision`).
    ``print(controller.describe())`` shows the closed-loop poles.

    Parameters
    ----------
    plant : FMU, path, system of python-control, StateSpace, LinearModel or Identification
        The plant to control. Nonlinear systems are linearised at a steady state.
    goal : str or sequence of str
        Names of the plant's outputs that have a goal, measured or not; by default the measured ones. The name of a vector stands
        for all its elements, ``"y[1]"`` for one; this holds for `measured` and `actuated` as well. For a `LinearModel`: names
        of its sensors, if it has any, their numbers, or a matrix as in `LQGController`; by default each distinct output. For an
        `Identification` also columns, or the quantities that it was given.
    measured, actuated : str or sequence of str
        Names of the outputs that sensors measure, and of the inputs that the controller drives. By default, of a system of
        python-control, all outputs, and all inputs that are not in `noise` or `loads`, or the only input. Of an FMU there is
        a default only if it has a single output, or a single such input. Leave them out for a `LinearModel` or an
        `Identification`, which contains them.
    dt : float, str or Fraction, optional
        Sample time in seconds; by default the one of the model or the FMU.
    at : mapping of input to number or vector, optional
        Inputs at the operating point; by default the start values of an FMU. A nonlinear system of python-control has no
        start values of inputs. Its inputs are then 0. Its controls may also get the values that hold a steady state nearer to
        the plant's start, as the thrust of a drone that hovers. The search for them begins at 0, and in the middle of the limits
        if it does not find the start itself. Where possible, the controls are within their limits.
    order : int, optional
        Number of states of a model by pulse responses.
    sensors : int or sequence of int, optional
        Number of sensors, or of each measured output: ``(3, 1)`` is three sensors of the first output, then one of the second. A
        single number takes the outputs in turn: ``4`` of position and speed is position, speed, position, speed.
    sensor_std : number or vector
        Standard deviation of the sensors' errors, noise and rounding together (`Sensors.error_std`): one for all, for each
        output, or for each sensor in the order of `sensors`.
    sensor_bias : number or vector
        Standard deviation of a constant offset of each sensor, in the unit of the sensor; 0 for a sensor without offset. The
        controller estimates the offsets. Of several sensors of a quantity, at least one must have no offset, unless a sensor of
        another quantity shows their common offset (a compass that of gyros). See `LinearModel.with_sensor_errors`.
    noise : mapping of input to number or vector, optional
        Inputs at which process noise acts, and its standard deviations. By default each control has 5 % of a size: half the
        range between its limits; without limits `acceptable_control`; without this, too, its value at the operating point,
        at least 1. The noise is white: a new value in each sample. A disturbance that lasts, as a gust, is one of the
        `loads`. Noise that is given replaces the default: name a control as well if it has some (in `closed_loop`, noise at
        a control needs a sum before the plant). Give the noise if you know it. If the plant moves far less at random than
        the default assumes, the belief follows the noise of the sensors: it is less accurate than its variance says, and
        equal sensors seem unequal. `describe()` prints the noise.
    loads : mapping of input to (number, number), optional
        Inputs at which unknown loads act that last, such as a gust, a draught or the temperature outside: the standard deviation
        of the load, as a deviation from the operating point, and the time constant with which it changes, in seconds. Each
        load becomes a state of the model, the output of a lag that noise drives. If it is slower than the loop, the control that
        counteracts it has no cost (see `LQGController`), and it leaves no steady error. A load may act on outputs
        directly (D), as on one that a sensor measures. For a load at a control that lasts for any time, give `disturbance`.
    disturbance : bool, number, vector or matrix, optional
        Covariance per sample of an unknown load on each control. It removes the steady error that is due to a load, or to a plant
        unlike the model; healthy sensors are then blamed far less. True: the standard deviation of the load's change in each
        sample is 1 % of `acceptable_control`, or else of half the range of the limits (chosen at sample times of 5 to 20 ms).
        With three or more sensors of a quantity this costs hardly anything. With two, it is then less certain which one drifts.
        What the model lacks elsewhere than at the control, such as behind a shaft, needs `noise` at an input of the plant that
        acts there, or `loads` if it lasts; without these, the sensors there are blamed.

        `LinearModel.from_fmu` says more about `at`, `order`, `sensors`, `sensor_std`, `noise` and `disturbance`; only the default
        of `noise` differs. A `LinearModel` contains all of these but `disturbance`: leave them out if you give one.
    acceptable_error : number or vector
        For Bryson's rule: the largest acceptable error of each goal output, in its unit.
    acceptable_control : number or vector, optional
        Deviation of each control from its steady value that costs as much. By default half the range of its limits, or else 1.
    goal_covariance, control_covariance : number, vector or matrix, optional
        The squares of the acceptable values, or other inverses of the costs, in place of those values.
    precision : PrecisionLearner, optional
        Learns the sensors' precisions; by default `SwitchingPrecision`. Its ``loss`` is the share of steps without a sample;
        `closed_loop` computes it from ``every`` of slow `Sensors`. In your own loop, give it: ``SwitchingPrecision(loss=(0.01,
        0.9))``.
    belief : {"filtered", "joint"}
        How the state is inferred.
    u_min, u_max, u_rate : number or vector
        Limits of the controls and of their rates of change, in their units and units per second. See `BayesianController`.
    preview : int
        Number of samples by which goals are known ahead: see `LQGController`.
    input_delays, sensor_delays : int or sequence of int
        Samples by which each control acts late, and by which the values of each sensor are old, in addition to what `plant`
        itself contains: see `LinearModel.with_delays`.
    initial_mean : number or vector, optional
        Mean of the model's states (``controller.model.names.states``) before the first sample, as in `LQGController`. By default
        the plant's start, as in ``StateSpace(initial=...)``. For a `LinearModel`, it is the operating point
        (`LinearModel.about`), or 0 if it has none. For an FMU without accessible states, it is 0.
    initial_spread : number
        Variances of the state at the first sample, as multiples of those of the steady filter's predictions. Give a
        larger number, such as 1e4, if the plant may move at the start. With another learner than the default one, give it also if
        the plant may start elsewhere than at its start values. (The default one expects that: ``start_doubt`` of
        `SwitchingPrecision`.) Errors of sensors that are states of the model begin with their own variance.
    initial_control : number or vector, optional
        The control before the first step, from which `u_rate` limits the first change; by default that of the operating point.

    Returns
    -------
    LQGController
        The controller, with the model in ``controller.model``.

    Raises
    ------
    ModelError
        If no steady state is found, the goals cannot be held, or a mode that does not decay is moved by no control or seen by no
        sensor. The message gives the mode's eigenvalue.
    UnknownNameError
        If the plant has no variable of a given name.

    Warns
    -----
    ModelMismatchWarning
        If an FMU's response to a short step of a control differs from the model's; see `compare_with_plant`. Also if no steady
        state of a nonlinear plant was found within the limits of the controls.
    UnstableLoopWarning
        If the loop is unstable or nearly so.

    Examples
    --------
    >>> from bayesftc import controllers, cosim, fmus
    >>> servo = cosim.FMU(fmus.path("PositionServo"))
    >>> controller = controllers.design(servo, measured="angle", actuated="voltage", sensors=2)
    >>> loop = cosim.closed_loop(
    ...     servo, controller, control="voltage", measured="angle", sensors=cosim.Sensors(2, 0.01), reference=1.0
    ... )
    """
    if isinstance(plant, Identification):
        if goal is not None and (isinstance(goal, str) or all(isinstance(name, str) for name in np.atleast_1d(goal))):
            goal = [place for name in names_of(goal, "goal") for place in _named(plant, name)]  # type: ignore[arg-type]
        plant = plant.model
    if isinstance(plant, LinearModel):
        determined: dict[str, object] = {
            "measured": measured,
            "actuated": actuated,
            "dt": dt,
            "at": at,
            "order": order,
            "sensors": sensors,
            "noise": noise,
            "loads": loads,
        }
        for name, value in determined.items():
            if value is not None:
                raise ModelError(f"A LinearModel already determines {name}; leave {name}= out.")
        model, H, names = plant, _goal_rows(plant, goal), tuple[str, ...]()
        at_rest = plant.operating_state
        mean = np.zeros(plant.states - plant.disturbances) if at_rest is None else np.asarray(at_rest, float)
        load = _load(disturbance, acceptable_control, _half_range(u_min, u_max, plant.controls))
        if load is not None:
            model = plant.with_disturbance(load)
            H = np.insert(H, [len(mean)] * (model.states - plant.states), 0.0, axis=1)
    else:
        check_plant(plant)
        check_by_name(noise=noise, at=at, loads=loads)
        plant = FMU(plant) if isinstance(plant, str | PathLike) else StateSpace(plant) if is_system(plant) else plant
        sensed = _without_choice(plant, "outputs") if measured is None else names_of(measured, "measured")
        driven = (
            _without_choice(plant, "inputs", {**(noise or {}), **(loads or {})})
            if actuated is None
            else names_of(actuated, "actuated")
        )
        goals = sensed if goal is None else names_of(goal, "goal")  # type: ignore[arg-type]
        # Here and not below, because the linearisation may take seconds.
        into, out = _ports(plant, driven, list(dict.fromkeys([*sensed, *goals])), dt, at)
        p, g = len(places_of(driven, into, "input")), len(places_of(goals, out, "output"))
        load = _load(disturbance, acceptable_control, _half_range(u_min, u_max, p))
        _squares("acceptable_error", acceptable_error, g)
        _squares("acceptable_control", 1.0 if acceptable_control is None else acceptable_control, p)
        as_number("initial_spread", initial_spread, least=0)
        sensors_of(places_of(sensed, out, "output"), sensors, sensor_std)
        with reported("Linearizing the plant, for some seconds."):

            def about(at: Mapping[str, Any]) -> Linearization:
                signals = {"measured": sensed, "actuated": driven, "others": goals, "noise": noise, "loads": loads}
                limits = u_min, u_max
                return linearize(plant, **signals, dt=dt, at=at, order=order, limits=limits)  # type: ignore[arg-type]

            everywhere = isinstance(plant, StateSpace) and isinstance(plant.system, LinearSystem)
            linear = about(at or {}) if everywhere else _within_limits(about, at or {}, driven, (u_min, u_max))
        refuse_unmoved(linear, driven)
        refuse_unmoving(linear, sensed)
        if noise is None:
            columns = linear.columns(driven)
            scale = _half_range(u_min, u_max, len(columns))
            if acceptable_control is not None:
                scale = np.where(
                    np.isnan(scale), _positive("acceptable_control", acceptable_control, len(scale)), scale
                )
            steady_size = np.maximum(np.abs(linear.u[columns]), 1.0)
            usual = INPUT_NOISE * np.where(np.isnan(scale), steady_size, scale)
            noise = {linear.inputs[j]: float(std) for j, std in zip(columns, usual, strict=True)}
        model = linear.model(sensed, driven, noise=noise, sensors=sensors, sensor_std=sensor_std, disturbance=load)
        rows, mean = linear.rows(goals), linear.start
        names = tuple(linear.outputs[i] for i in rows)
        H = np.zeros((len(rows), model.states))
        H[:, : len(mean)] = linear.C[rows]
        if model.constant:
            H[:, -1] = linear.y[rows] - linear.C[rows] @ linear.x
    if goal is None and len(H) > model.controls:
        raise ModelError(_too_many_goals(names or range(len(H)), model.controls))
    refuse_unstabilisable(model)
    refuse_undetectable(model)
    p = model.controls
    # A model by responses may be about a steady state far from the start, where the plant responds otherwise: it has its warning.
    elsewhere = isinstance(plant, FMU) and plant.description.exchange is None and starts_elsewhere(linear)
    if isinstance(plant, FMU) and at is None and not elsewhere:
        with reported("Comparing the linear model with the plant, for some seconds."):
            compare_with_plant(model, plant, control=driven, measured=sensed, at=mean, u_min=u_min, u_max=u_max)
    model, H = _with_biases(model, H, as_vector("sensor_bias", sensor_bias, model.sensors))
    low, high = as_vector("u_min", u_min, p, finite=False), as_vector("u_max", u_max, p, finite=False)
    if goal_covariance is None:
        goal_covariance = _squares("acceptable_error", acceptable_error, len(H))
    if control_covariance is None:
        span = np.nan_to_num(_half_range(u_min, u_max, p), nan=1.0)
        control_covariance = _squares(
            "acceptable_control", span if acceptable_control is None else acceptable_control, p
        )
    start = _initial(model, as_number("initial_spread", initial_spread, least=0))
    late = model.with_delays(
        whole_delays("design() has input_delays", input_delays, p, "control", model.dt),
        whole_delays("design() has sensor_delays", sensor_delays, model.sensors, "sensor", model.dt),
    )
    warn_of_unused(
        model,
        "Give disturbance=, for an unknown load on the control. Or, if another input moves what they measure, name it in noise= "
        "or loads=. State true sizes: with sizes that are far too large, healthy sensors are blamed.",
    )
    if late is not model:
        model, H = late, extended_rows(late, H)
    controller = LQGController(
        model,
        precision=SwitchingPrecision() if precision is None else precision,
        goal_on=H,
        goal_covariance=goal_covariance,
        control_covariance=control_covariance,
        belief=belief,
        u_min=low,  # type: ignore[arg-type]
        u_max=high,  # type: ignore[arg-type]
        u_rate=u_rate,  # type: ignore[arg-type]
        initial_mean=mean if initial_mean is None else initial_mean,  # type: ignore[arg-type]
        initial_covariance=start,
        initial_control=initial_control,  # type: ignore[arg-type]
        preview=preview,
        goal_names=names,
    )
    _warn_if_nearly_unstable(controller)
    return controller


def _warn_if_nearly_unstable(controller: LQGController) -> None:
    slowest = np.abs(controller.closed_loop_poles()).max(initial=0.0)
    if slowest > 1.0 + 1e-9:
        return  # an unstable loop has its own warning
    distances = moduli(controller)
    j = int(distances.argmin())
    if (distance := float(distances[j])) >= NEARLY_UNSTABLE:
        return
    names = controller.model.names.controls if controller.model.names else ()
    example = f'noise={{"{names[j]}": ...}}' if names else "process_covariance"
    at = f'at="{names[j]}"' if len(names) > 1 else ""
    warn_user(
        f"The loop is nearly unstable: its transfer function comes as near as {distance:.2g} to -1 (the modulus of "
        f"loop.margins({at})). An error of about {100 * distance:.2g} % in what the control does may lose it. Expect noise at "
        f"the control, or more of it ({example}), estimate a load (disturbance=True), or accept larger errors "
        "(acceptable_error).",
        UnstableLoopWarning,
    )


def _too_many_goals(goals: Sequence[str | int], controls: int) -> str:
    """Return the message about a design without goal= where more outputs are measured than there are controls."""
    example = ", ".join(f'"{goal}"' if isinstance(goal, str) else str(goal) for goal in goals[:controls])
    return (
        f"There are {len(goals)} goals but only {counted(controls, 'control')}. Without goal= each measured output has a goal, "
        f"and each goal needs a control. Name the outputs that have a goal, such as goal=[{example}], or actuate further inputs."
    )


def _without_choice(
    plant: FMU | StateSpace, side: Literal["inputs", "outputs"], others: Iterable[str] = ()
) -> list[str]:
    """Return all inputs or outputs of a plant but the `others`, or the only one; refuse several of an FMU.

    An FMU has them for many purposes.
    """
    names = [port.name for port in getattr(plant, side) if port.draw is None]
    taken = [element for other in others for element in elements_of(other, names)]
    left = [name for name in names if name not in taken] or (names if len(names) == 1 else [])
    if not left or (isinstance(plant, FMU) and len(left) > 1):
        known = f"{', '.join(names[:8])}{', ...' if len(names) > 8 else ''}" if names else "none"
        setting = "actuated" if side == "inputs" else "measured"
        raise ModelError(f"design() needs {setting}=, names of {side} of the plant (known: {known}).")
    return left


def _ports(
    plant: FMU | StateSpace,
    inputs: Sequence[str],
    outputs: Sequence[str],
    dt: float | str | Fraction | None,
    at: Mapping[str, float | Sequence[float]] | None,
) -> tuple[Sequence[str], Sequence[str]]:
    """Return the names of the elements of a plant's inputs and outputs; of an FMU those of the given ones."""
    if isinstance(plant, FMU):
        ports = fmu_ports(plant, inputs, outputs, dt, at or {})
        return ports.driven[1], ports.seen[1]
    return [port.name for port in plant.inputs if port.draw is None], [port.name for port in plant.outputs]


def _named(plant: Identification, name: str) -> list[int]:
    column = plant.quantities.get(name, (name,))[0]  # its sensors measure the same
    matches = elements_of(column, plant.outputs)
    if not matches:
        known = did_you_mean(name, (*plant.quantities, *plant.outputs))
        raise UnknownNameError(f"The identified model has no output {name!r}; {known}")
    return [plant.outputs.index(element) for element in matches]


def _half_range(u_min: object, u_max: object, size: int) -> Floats:
    """Return half the range between the limits of each control; NaN where a limit is infinite."""
    low, high = as_vector("u_min", u_min, size, finite=False), as_vector("u_max", u_max, size, finite=False)
    check_limits(low, high)
    if (low == high).any():
        raise ModelError(
            f"u_min {low.tolist()} and u_max {high.tolist()} leave a control no range. Leave out a control that cannot move."
        )
    span = (high - low) / 2
    return np.where(np.isfinite(span), span, np.nan)


def _load(disturbance: Matrix | bool | None, acceptable: float | Sequence[float] | None, half: Floats) -> Matrix | None:
    """Return the covariance per sample of the load; of True from the scale of each control. None: there is no load."""
    if disturbance is None:
        return None
    if not isinstance(disturbance, bool | np.bool_):
        return disturbance
    if not disturbance:
        return None
    scale = half if acceptable is None else _positive("acceptable_control", acceptable, len(half))
    if np.isnan(scale).any():
        raise ModelError(
            "disturbance=True takes the size of the load from acceptable_control, or from u_min and u_max. Give one of them, or "
            "the load's covariance per sample."
        )
    return (LOAD_STEP * scale) ** 2  # type: ignore[no-any-return]


def _within_limits(
    linearization: Callable[[Mapping[str, Any]], Linearization],
    at: Mapping[str, Any],
    driven: Sequence[str],
    limits: tuple[object, object],
) -> Linearization:
    """Return the linearisation about a point that the limits of the controls allow, the one found or else one at a limit.

    Raises
    ------
    ModelError
        If the limits exclude the given operating point.

    Warns
    -----
    ModelMismatchWarning
        If no steady state within the limits was found.
    """
    first = linear = linearization(at)
    columns, given, fixed, texts = first.columns(driven), dict(first.held), dict[str, float](), list[str]()
    low, high = (
        as_vector(name, of, len(columns), finite=False) for name, of in zip(("u_min", "u_max"), limits, strict=True)
    )
    while True:
        outside = {}
        for j, least, most in zip(columns, low, high, strict=True):
            name, u = linear.inputs[j], float(linear.u[j])
            if np.isclose(u, nearest := float(np.clip(u, least, most)), rtol=1e-9, atol=1e-12):
                continue
            outside[name] = nearest
            texts.append(
                f"The operating point has {name} = {u:.6g}, but u_min and u_max limit it to {least:g} ... {most:g}."
            )
            if name in given:
                raise ModelError(f"{texts[-1]} Change at= or the limits.")
        if not outside:
            return linear
        fixed |= outside  # another control may then be outside in its place
        try:
            linear = linearization({**at, **fixed})
        except ModelError as error:
            warn_user(f"{' '.join(texts)} No model within the limits was found: {error}", ModelMismatchWarning)
            return first


def _positive(name: str, value: object, size: int) -> Floats:
    vector = as_vector(name, value, size)
    if (vector <= 0).any():
        raise ModelError(f"{name} is {vector.tolist()}; it must be positive.")
    if (vector**2 < SMALLEST).any():
        raise ModelError(
            f"{name} is {vector.tolist()}; it must be at least {SMALLEST**0.5:g}. Choose a unit in which it is larger."
        )
    return vector


def _squares(name: str, value: object, size: int) -> Floats:
    return _positive(name, value, size) ** 2


def _sensor_number(model: LinearModel, name: str) -> int:
    """Return the number of the first sensor of this name."""
    if model.names is None:
        raise ModelError("This LinearModel has no names; give goal= as numbers of sensors, or as a matrix.")
    if name not in model.names.sensors:
        raise UnknownNameError(f"The model has no sensor {name!r}; {did_you_mean(name, model.names.sensors)}")
    return model.names.sensors.index(name)


def _goal_rows(model: LinearModel, goal: Any) -> Floats:
    """Return the rows that map the model's state to the goals."""
    quantities = model.quantities
    if goal is None:
        return np.asarray(quantities[sorted(np.unique(quantities, axis=0, return_index=True)[1])])
    rows = np.asarray(goal)
    if rows.dtype.kind in "US":
        rows = np.array([_sensor_number(model, str(name)) for name in np.atleast_1d(rows)])
    if rows.ndim == 2:
        return np.asarray(rows, dtype=np.float64)
    numbers = np.atleast_1d(rows)
    if numbers.dtype.kind not in "iu" or (numbers < 0).any() or (numbers >= model.sensors).any():
        raise ModelError(f"goal is {goal!r}; give numbers of sensors, from 0 to {model.sensors - 1}.")
    return np.asarray(quantities[numbers])


def _with_biases(model: LinearModel, H: Floats, std: Floats) -> tuple[LinearModel, Floats]:
    """Return the model with offsets of the sensors that have a standard deviation, and its map to the goals."""
    if (std < 0).any():
        raise ModelError(f"sensor_bias is {std.tolist()}; standard deviations must be 0 (no offset) or positive.")
    biased = np.flatnonzero(std).tolist()
    if not biased:
        return model, H
    if len(biased) == model.sensors:
        raise ModelError(
            f"sensor_bias is {std.tolist()}: all sensors have an offset, and an equal one of all looks like another state. Give "
            "0 for a sensor that counts as right."
        )
    H = np.insert(H, [model.states - model.constant] * len(biased), 0.0, axis=1)
    return model.with_sensor_errors(std[biased].tolist(), CONSTANT * float(model.step), biased), H


def _moved(A: Floats, Q: Floats) -> Floats:
    """Return the variance of each state that process noise causes in as many samples as there are states."""
    total = part = Q
    for _ in range(len(A) - 1):
        part = A @ part @ A.T
        total = total + part
    return np.asarray(np.diag(total))


def _seen(A: Floats, C: Floats, R: Floats) -> Floats:
    """Return the variance with which 1024 samples show each state if the others are known; 0 if they do not show it."""
    information = C.T @ np.linalg.solve(R, C)
    with np.errstate(all="ignore"):  # of unstable modes
        for _ in range(10):
            information, A = information + A.T @ information @ A, A @ A
        told = np.diag(information)
        return np.where((told > 0.0) & np.isfinite(told), 1.0 / told, 0.0)


def _initial(model: LinearModel, times: float) -> Floats:
    """Return the initial covariance: a multiple of that of the steady filter's predictions.

    An error of a sensor in the model has its own variance: the steady filter knows a bias, at the start nobody does.
    """
    from numpy.linalg import LinAlgError

    moving = model.moving
    A, C, Q, R = (moving.matrix(name) for name in ("A", "C", "process_covariance", "sensor_covariance"))
    # A mode without noise has no steady covariance; a little noise on all states gives it one, in units of what moves them, or of
    # what the sensors see of them.
    spread = np.maximum(1e-9 * _moved(A, Q), 1e-6 * _seen(A, C, R))
    spread = np.where(spread > 0.0, spread, 1e-9 * max(float(np.trace(Q)), 1e-12))
    start = np.zeros((model.states, model.states))
    n = moving.states
    try:
        start[:n, :n] = times * predicted_covariance(A, C, Q + np.diag(spread), R)
        own = error_variances(model)
        errors = np.flatnonzero(own)
        start[errors], start[:, errors] = 0.0, 0.0
        start[errors, errors] = own[errors]
        return as_covariance("The initial covariance", (start + start.T) / 2, model.states, singular=True)
    except (ModelError, LinAlgError, ValueError):
        raise ModelError(
            "No steady Kalman filter exists for this model in double precision: its numbers differ too much in size, or its "
            "sensors hardly see its motion. Measure an output that the control moves more, give another dt, or, for an FMU whose "
            "states are not accessible, give a smaller order=."
        ) from None
