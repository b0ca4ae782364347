"""The text of `BayesianController.describe`: model, precisions, gains, poles, expected accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.controllers.bayesian.stabilisability import shown
from bayesftc.controllers.linalg.lyapunov import stationary_covariance
from bayesftc.controllers.models.disturbances import error_variances, lagged_loads
from bayesftc.cosim.base.timebase import show
from bayesftc.cosim.errors import brief
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.controllers.bayesian.linear import BayesianController
    from bayesftc.controllers.models.linear import LinearModel

LASTING = 1e-9
"""A mode whose pole is nearer to the unit circle than this counts as undamped: its noise accumulates."""

NOTHING = 1e-20
"""Largest gain, relative to the largest one, that is printed as 0."""

FAST, MANY = 0.05, 4
"""Poles below this magnitude are counted and not listed if there are so many: delays in the plant have poles at 0, which rounding
moves the farther the more there are."""

ROUNDING = 1e-9
"""Largest magnitude of a pole that is printed as 0."""

AWAY, MOST_NAMED = 1e-9, 6
"""States below this share of the largest one, or of 1, count as 0 at an operating point; so many others at most are named."""

DAMPINGS, SAME = (1e-6, 1e-7), 0.01
"""Two dampings of undamped modes, and the relative difference up to which a standard deviation does not depend on them."""


def _of_sensors(controller: BayesianController, std: Floats) -> str:
    """Return a number for each sensor; of several quantities with its own behind it, because they may alternate."""
    names = controller.model.names.sensors if controller.model.names else ()
    return _each(std, names)


def _about(model: LinearModel) -> str:
    if not model.constant:
        return ""
    u = model.operating_control
    at = "" if u is None else f" at which the control is {_numbers(np.atleast_1d(np.asarray(u, dtype=np.float64)))}"
    x = np.asarray(model.operating_state if model.operating_state is not None else (), dtype=np.float64)
    names = model.names.states if model.names else ()
    away = [
        f"{n} = {value:.4g}"
        for n, value in zip(names, x, strict=False)
        if abs(value) > AWAY * max(1.0, np.abs(x).max())
    ]
    away[MOST_NAMED:] = ["..."] * (len(away) > MOST_NAMED)
    where = f" and {', '.join(away)}" if away else ""
    return f", about an operating point{at}{where}"


def model_lines(controller: BayesianController) -> list[str]:
    """Return lines about the model, the sensors' noise, goals and limits."""
    model = controller.model
    loads, errors = _further_states(model)
    counts = [
        _count(model.plant_states, "state"),
        *([_count(loads, "disturbance")] if loads else []),
        *([_count(errors, "error of a sensor", "errors of sensors")] if errors else []),
    ]
    states = " and ".join(counts)
    named = f" ({', '.join(model.names.controls)})" if model.names else ""
    std = np.sqrt(np.diag(model.matrix("sensor_covariance")))
    lines = [
        f"Model: {states}, {_count(model.controls, 'control')}{named}, {_sensors(model)}, every {show(model.step)} s"
        f"{_about(model)}.",
        f"Expected standard deviations of the sensors: {_of_sensors(controller, std)}.",
        f"Expected process noise in each step, as standard deviations: {_process_noise(model)}.",
        f"Goals: {controller.goals}; limits of the control: {_limits(controller)}.",
    ]
    if not loads:
        lines.append("No load on the control is estimated (disturbance=True in design).")
    if lasting := ", ".join(model.state_names[i] for i in lagged_loads(model, measured=True)):
        lines.append(f"Loads that are estimated, as deviations from the operating point: {lasting}.")
    if model.delays is not None:
        late = (
            f"{what} by {', '.join(map(str, steps))}"
            for what, steps in (("controls", model.delays.inputs), ("sensors", model.delays.sensors))
        )
        lines.insert(
            1, f"Delays in samples: {'; '.join(late)}; {_count(model.delays.states, 'state')} of past signals."
        )
    return lines


def _sensors(model: LinearModel) -> str:
    """Return the numbers of sensors and quantities, and their names after what they name: columns name sensors."""
    sensors = _count(model.sensors, "sensor")
    quantities = _count(len(model.alike), "quantity", "quantities")
    if not model.names:
        return f"{sensors} of {quantities}"
    names = list(dict.fromkeys(map(str, model.names.sensors)))
    listed = f" ({', '.join(names)})"
    return (
        f"{sensors} of {quantities}{listed}" if len(names) == len(model.alike) else f"{sensors}{listed} of {quantities}"
    )


def _process_noise(model: LinearModel) -> str:
    """Return the standard deviations of the process noise: of the controls if it acts as they do, else of inputs or states."""
    n, (loads, errors) = model.plant_states, _further_states(model)
    whole = model.matrix("process_covariance")
    Q, B = whole[:n, :n], model.effects[:n]
    back = np.linalg.pinv(B)
    on_controls = back @ Q @ back.T
    if np.abs(B @ on_controls @ B.T - Q).max() <= 1e-9 * np.abs(Q).max():
        controls = model.names.controls if model.names else ()
        text = f"{_each(_std(on_controls), controls)} on {'each control' if model.controls > 1 else 'the control'}"
    else:
        text = _at_inputs(model, Q) or f"{_each(_std(Q), model.state_names)} of each state"
    further = _std(whole)[model.states - model.disturbances :]
    if loads:
        text += f"; {_numbers(further[:loads])} of {'each' if loads > 1 else 'the'} disturbance"
    if errors:
        text += f"; {_numbers(further[loads:][:errors])} of each error of a sensor"
    return text


def _at_inputs(model: LinearModel, Q: Floats) -> str:
    """Return the standard deviations of the noise at the inputs that have some, and of loads; empty if that is not all noise."""
    loads = lagged_loads(model, measured=True)
    names, effects = [name for name, _ in model.noise_effects], np.array([effect for _, effect in model.noise_effects])
    if not names or effects.shape[1] != len(Q):
        return ""
    others = np.delete(np.arange(len(Q)), loads)
    rest = Q[np.ix_(others, others)]
    products = np.array([np.outer(effect, effect).ravel() for effect in effects[:, others]]).T
    variances, _, rank, _ = np.linalg.lstsq(products, rest.ravel())
    if rank < len(names):
        return ""  # of inputs that move the plant alike, the sum of the variances does not tell each
    if (variances < 0.0).any() or np.abs(products @ variances - rest.ravel()).max() > 1e-9 * np.abs(rest).max():
        return ""
    text = ", ".join(f"{std:.4g} ({name})" for std, name in zip(np.sqrt(variances), names, strict=True))
    of_loads = ", ".join(f"{std:.4g} ({model.state_names[i]})" for std, i in zip(_std(Q)[loads], loads, strict=True))
    return f"{text} at {'these inputs' if len(names) > 1 else 'this input'}" + (
        f"; for the loads {of_loads}" if loads else ""
    )


def _further_states(model: LinearModel) -> tuple[int, int]:
    """Return the numbers of disturbances of the plant, and of errors of sensors, that the model estimates."""
    errors = int(np.count_nonzero(error_variances(model)))
    return model.disturbances - model.constant - errors, errors


def learner_lines(controller: BayesianController) -> list[str]:
    """Return lines about the precision learner and the faults that it distinguishes."""
    precision: Any = controller.precision
    changed = [each.name for each in fields(precision) if _differs(getattr(precision, each.name), each)]
    settings = (
        f", with {', '.join(f'{name}={brief(getattr(precision, name), 60)}' for name in changed)}" if changed else ""
    )
    lines = [f"Precision learner: {type(precision).__name__}{settings}."]
    if modes := tuple(type(mode).__name__ for mode in getattr(precision, "modes", ())):
        lines.append(f"Sensor faults that are distinguished: {', '.join(modes)}.")
        # The settings show the times for samples of up to 20 ms; these are the times in use.
        used = precision.paced(float(controller.model.step)).modes
        times = ", ".join(
            f"{name} {m.time_to_fault:.6g} / {m.time_to_recovery:.6g}" for name, m in zip(modes, used, strict=True)
        )
        lines.append(
            "Before any sample the learner assumes these mean times in seconds, until a fault begins / until it ends: "
            f"{times}. Times that you did not give are defaults for this sample time."
        )
    if controller.actuator_kinds:
        lines.append(f"Actuator faults that are distinguished: {', '.join(controller.actuator_kinds)}.")
    if precision.why_no_probability:
        lines.append(f"There is no fault probability: {precision.why_no_probability}")
    return lines


def gain_lines(controller: BayesianController) -> list[str]:
    """Return lines about the gains of filter and control in steady state."""
    gains, model = controller.steady_gains(), controller.model.moving
    late = () if model.delays is None else range(model.states)[model.delays.places]
    kept = [i for i in range(model.states) if i not in late]
    left_out = f" Those of {_count(len(late), 'past signal')} are left out; steady_gains() has all." if late else ""
    away = ", each as its deviation from the operating point" if controller.model.constant else ""
    controls = controller.model.names.controls if controller.model.names else ()
    return [
        f"Gain of the filter, a row for each state: {_rows(gains.K[kept], [model.state_names[i] for i in kept])}.{left_out}",
        f"The control is F goal - K belief{away}. K, a row for each control: {_rows(gains.L[:, kept], controls)}.{left_out}",
        f"F, a row for each control: {_rows(gains.M, controls)}.",
    ]


def accuracy_lines(controller: BayesianController) -> list[str]:
    """Return lines about the expected standard deviations of tracking and belief without faults."""
    tracking, belief = expected_accuracy(controller)
    if np.isinf(tracking).any():
        return ["Expected accuracy: none. A mode of the loop is not damped, so its variance grows without bound."]
    constant = "constant goals and disturbances" if _further_states(controller.model)[0] else "a constant goal"
    return [
        f"Expected errors without faults, at {constant}, with a sample of every sensor in each step (standard deviations): "
        f"tracking {_numbers(tracking)}; belief {_numbers(belief)}."
    ]


def expected_accuracy(controller: BayesianController) -> tuple[Floats, Floats]:
    """Return the steady standard deviations of what has a goal, and of the belief about it; infinity where they grow for ever.

    The plant is assumed to equal the model, with disturbances of 0. A mode that is not damped, such as a position that has no
    goal, gets two small dampings: what has the same variance with both does not depend on it.
    """
    slowest = np.abs(controller.closed_loop_poles()).max()
    if slowest < 1.0 - LASTING:
        return _accuracy(controller, 1.0)
    if slowest > 1.0 + LASTING:
        endless = np.full(controller.goals, np.inf)
        return endless, endless
    more, less = (np.array(_accuracy(controller, 1.0 - damping)) for damping in DAMPINGS)
    tracking, belief = np.where(np.abs(less - more) > SAME * more, np.inf, less)
    return tracking, belief


def _accuracy(controller: BayesianController, factor: float) -> tuple[Floats, Floats]:
    """Return these standard deviations of a loop whose transition matrix is multiplied by a factor."""
    model = controller.model.moving
    plant, m = model.states - model.disturbances, model.sensors
    B, C = model.matrix("B")[:plant], model.matrix("C")[:, :plant]
    Q, R = model.matrix("process_covariance")[:plant, :plant], model.matrix("sensor_covariance")
    whole = controller.closed_loop_matrix()
    _, given, _, direct = controller.feedback()
    noise = np.vstack([B @ direct[:, :m], given[:, :m]])
    spread = noise @ R @ noise.T
    spread[:plant, :plant] += Q
    covariance = stationary_covariance(factor * whole, spread)
    K = controller.steady_gains().K[:plant]
    of_plant = np.eye(plant, model.states)
    error = np.hstack([np.eye(plant) - K @ C, -(of_plant - K @ model.matrix("C"))])
    G = controller.goal_matrix[:, :plant]
    belief = error @ covariance @ error.T + K @ R @ K.T
    return _std(G @ covariance[:plant, :plant] @ G.T), _std(G @ belief @ G.T)


def pole_lines(poles: Any, dt: float, at_zero: int) -> list[str]:
    """Return a line with the poles of plant and filter together."""
    return [f"Poles of the closed loop, the filter's included: {listed(poles, dt, at_zero)}."]


def listed(poles: Any, dt: float, at_zero: int = 0) -> str:
    """Return poles as text, the slowest first; `at_zero` is the number of further ones at 0, those of delays."""
    ordered = sorted(map(complex, poles), key=lambda pole: (-abs(pole), -pole.imag))
    slowest = abs(ordered[0]) if ordered else 0.0
    fast = sum(abs(pole) < FAST for pole in ordered)
    counted = [f"{fast} below {FAST:g} in magnitude"] if fast >= MANY else []
    texts = [shown(pole if abs(pole) > ROUNDING else 0j) for pole in ordered[: len(ordered) - fast * len(counted)]]
    counted += [f"{at_zero} at 0 for the delays"] if at_zero else []
    if texts and counted:
        counted[-1] = f"and {counted[-1]}"
    return ", ".join(texts + counted) + f"; the slowest of magnitude {_with_time(slowest, dt)}"


def _with_time(magnitude: float, dt: float) -> str:
    """Return the magnitude of a pole, with the time constant of its mode."""
    decay = 1.0 - magnitude
    if decay > LASTING:
        decimals = max(3, 1 - int(np.floor(np.log10(decay))))
        time = f" (time constant {-dt / np.log(magnitude):.3g} s)" if magnitude > 0.0 else ""
        return f"{magnitude:.{decimals}f}{time}"
    return "1 (does not decay)" if decay >= -LASTING else f"{magnitude:.3f} (grows)"


def _differs(value: Any, setting: Any) -> bool:
    """Return whether a setting of a dataclass differs from its default."""
    default = setting.default if setting.default_factory is MISSING else setting.default_factory()
    return repr(value) != repr(default)


def _std(covariance: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _count(number: int, one: str, several: str | None = None) -> str:
    return f"{number} {one if number == 1 else several or one + 's'}"


def _numbers(values: Floats) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


def _rows(matrix: Floats, names: Sequence[str]) -> str:
    """Return the rows of gains, of several each with its name; what is only rounding beside the largest one is 0."""
    exact = np.where(np.abs(matrix) > NOTHING * np.abs(matrix).max(initial=0.0), matrix, 0.0)
    rows = [_numbers(row) for row in exact]
    return "; ".join(_with_names(rows, names))


def _each(values: Floats, names: Sequence[str]) -> str:
    """Return numbers, of several each with its name."""
    return ", ".join(_with_names([_numbers(values[i : i + 1]) for i in range(len(values))], names))


def _with_names(texts: list[str], names: Sequence[str]) -> list[str]:
    """Return texts of several, each with its name behind it, as far as there are names."""
    if len(dict.fromkeys(names)) < 2:
        return texts
    return [f"{text} ({name})" for text, name in zip(texts, names[: len(texts)], strict=True)]


def _limits(controller: BayesianController) -> str:
    low, high, rate = (np.atleast_1d(limit) for limit in (controller.u_min, controller.u_max, controller.u_rate))
    between = ", ".join(f"{a:g} to {b:g}" for a, b in zip(low, high, strict=True))
    limits = [] if np.isinf([low, high]).all() else [between]
    if not np.isinf(rate).all():
        limits.append(f"a rate of at most {', '.join(f'{r:g}' for r in rate)} per second")
    return ", ".join(limits) or "none"
