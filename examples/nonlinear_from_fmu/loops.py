"""The arm and the pendulum on a cart under a controller with the FMU's own equations, and under linear designs.

    python -m bayesftc.examples.nonlinear_from_fmu.loops    # the arm moves from hanging to standing, with a failing sensor

The controllers know nothing but the FMU. The cost of the next state is the regulator's cost-to-go, from the linearised model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.types import Floats

FMU, SAME_GOALS, DESIGN, LOAD = "model of the FMU", "linear model, same goals", "linear design", "with a load"

Controller = controllers.NonlinearBayesianController | controllers.BayesianController

WEAK = 1e-3
"""Weight of goal and control prior beside the belief, so that the goal has hardly an effect on the estimate."""

PERIOD = 4.0
"""Seconds of the arm's reference."""

ARM: dict[str, Any] = {
    "measured": ["q1", "q2"],
    "actuated": ["torque1", "torque2"],
    "sensors": 4,
    "sensor_std": 0.01,
    "dt": 0.01,
}
ARM_NOISE = {"torque1": 1.0, "torque2": 1.0}
ARM_COST: dict[str, Any] = {"acceptable_error": 0.02, "acceptable_control": 1000.0}

CART: dict[str, Any] = {"measured": ["position", "angle"], "actuated": "force", "sensors": 4, "sensor_std": 0.005}
CART_NOISE = {"torque": 0.02}
CART_COST: dict[str, Any] = {"acceptable_error": 0.1, "acceptable_control": 5.0, "u_min": -20.0, "u_max": 20.0}


def arm_controller(way: str) -> Controller:
    """Return a controller of the arm, of one of the four kinds."""
    if way in {DESIGN, LOAD}:
        load = 1.0 if way == LOAD else None
        return controllers.design(fmus.path("TwoLinkArm"), **ARM, noise=ARM_NOISE, disturbance=load, **ARM_COST)
    model = _model("TwoLinkArm")
    return _with_goals(way, model, [0, 1], ARM_COST, _rest(model))


def cart_controller(way: str, angle: float) -> Controller:
    """Return a controller of the cart that knows the angle in which the pendulum starts."""
    model, start = _model("CartPendulum"), np.array([0.0, angle, 0.0, 0.0])
    if way == DESIGN:
        return replace(
            controllers.design(model.linearised(_rest(model)), goal=[0], **CART_COST),
            initial_mean=tuple(start.tolist()),
        )
    return _with_goals(way, model, [0], CART_COST, start)


def arm_loop(controller: Controller, amplitude: float, faults: Sequence[cosim.Fault] = ()) -> Any:
    """Return the loop: the first joint swings from hanging to twice the amplitude, the second to both sides, twice as fast."""
    w = 2 * np.pi / PERIOD
    reference = [
        cosim.Sine(amplitude, PERIOD, offset=amplitude - np.pi / 2, phase=-np.pi / 2),
        cosim.Sine(amplitude, PERIOD / 2),
    ]
    if controller.goals == 4:
        reference += [cosim.Sine(amplitude * w, PERIOD), cosim.Sine(2 * amplitude * w, PERIOD / 2, phase=np.pi / 2)]
    return cosim.closed_loop(
        cosim.FMU(fmus.path("TwoLinkArm")),
        controller,
        control=["torque1", "torque2"],
        measured=["q1", "q2"],
        sensors=cosim.Sensors(4, 0.01),
        faults=list(faults),
        reference=reference,
    )


def cart_loop(controller: Controller, angle: float) -> Any:
    """Return the loop: from an angle, the pendulum is to stand still at the position 0."""
    return cosim.closed_loop(
        cosim.FMU(fmus.path("CartPendulum"), parameters={"angle_0": angle}),
        controller,
        control="force",
        measured=["position", "angle"],
        sensors=cosim.Sensors(4, 0.005),
        noise={"torque": cosim.Gaussian(std=0.02)},
        reference=[0.0] * controller.goals,
    )


def arm_errors(result: cosim.Result, amplitude: float) -> Floats:
    """Return the errors of both joints over time (2 x steps)."""
    w = 2 * np.pi / PERIOD
    goals = amplitude - np.pi / 2 - amplitude * np.cos(w * result.time), amplitude * np.sin(2 * w * result.time)
    return np.array([result[f"plant.q{i + 1}"] - goal for i, goal in enumerate(goals)])


@cache
def _model(plant: str) -> controllers.NonlinearModel:
    options, noise = {"TwoLinkArm": (ARM, ARM_NOISE), "CartPendulum": (CART, CART_NOISE)}[plant]
    # The FMU's internal step may be longer in the model than in the plant.
    return controllers.NonlinearModel.from_fmu(
        cosim.FMU(fmus.path(plant), parameters={"max_substep": 0.005}), noise=noise, **options
    )


def _rest(model: controllers.NonlinearModel) -> Floats:
    """Return the state in which the plant starts, at rest."""
    return np.array(model.start, dtype=np.float64)


def _with_goals(
    way: str, model: controllers.NonlinearModel, goal: list[int], cost: dict[str, Any], start: Floats
) -> Controller:
    """Return the controller with a goal for each state, whose precision is the linear regulator's cost-to-go."""
    rest = _rest(model)
    linear = model.linearised(rest)
    regulated = controllers.design(linear, goal=goal, **cost)
    P = regulated.regulator.cost_to_go
    covariance = np.asarray(regulated.initial_covariance)
    weight = WEAK / float(np.trace(P @ (covariance + np.asarray(linear.process_covariance))))
    limits: dict[str, Any] = {name: cost[name] for name in ("u_min", "u_max") if name in cost}
    settings: dict[str, Any] = {
        "goal_covariance": np.linalg.inv(P) / weight,
        "control_covariance": cost["acceptable_control"] ** 2 / weight,
        **limits,
    }
    if way == FMU:
        return controllers.NonlinearBayesianController(
            model, initial_mean=tuple(start.tolist()), initial_covariance=covariance, iterations=8, **settings
        )
    about = linear.about(rest, np.zeros(model.controls), np.asarray(linear.C) @ rest) if rest.any() else linear
    if about.constant:
        start, covariance = np.append(start, 1.0), np.pad(covariance, (0, 1))
    return controllers.BayesianController(
        about, initial_mean=tuple(start.tolist()), initial_covariance=covariance, **settings
    )


def main() -> None:
    """Move the arm under all four controllers, with a sensor that freezes, and print the errors."""
    amplitude, fault = 1.5, cosim.Freeze(sensor=0, start=1.0)
    print(f"The arm swings by {2 * amplitude:g} rad; sensor 0 freezes at t = 1 s. RMS error of the joints in rad:")
    for way in (FMU, SAME_GOALS, DESIGN, LOAD):
        result = arm_loop(arm_controller(way), amplitude, [fault]).simulate(2 * PERIOD, seed=1)
        error = np.sqrt((arm_errors(result, amplitude) ** 2).mean())
        print(f"{way:26s} {error:.3f}")


if __name__ == "__main__":
    main()
