"""The true car, road and sensors, which can differ from the controller's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from math import inf, sqrt
from typing import Any

import numpy as np

from bayesftc import controllers, cosim
from bayesftc.cosim.block import Block, Definition
from bayesftc.cosim.elementary import exponential
from bayesftc.cosim.ops import absolute, maximum, minimum, select
from bayesftc.cosim.ports import Port
from bayesftc.reproduce.settings import Car, Models
from bayesftc.reproduce.shared.car import model

GRAVITY = 9.81
"""m/s^2."""


def _look(speed, v):
    v[0] = speed[0]


def _move(force, disturbance, speed, engine, sent, h, mass, drag, quadratic, slope_force, limit, follows):
    last = sent.shape[0] - 1
    sent[last] = force[0]
    v, limited = speed[0], maximum(minimum(sent[0], limit[0]), -limit[0])
    for k in range(last):
        sent[k] = sent[k + 1]
    engine[0] = select(follows[0] >= 1.0, limited, engine[0] + follows[0] * (limited - engine[0]))
    net_force = engine[0] - quadratic[0] * v * absolute(v) - slope_force[0]
    speed[0] = (1.0 - drag[0] / mass[0] * h[0]) * v + h[0] / mass[0] * net_force + disturbance[0]


@dataclass(frozen=True)
class TrueCar(Block):
    """``v <- (1 - b/m h) v + h/m (force - c v |v| - m g sin(slope)) + disturbance``, with limit, delay and lag of the force.

    With the defaults of the arguments after `drag` it equals the FMU ``CruiseControl``, bit for bit.
    """

    start_speed: float  # m/s
    mass: float  # kg
    drag: float  # b, in N s/m
    quadratic_drag: float = 0.0  # c, in N s^2/m^2
    slope: float = 0.0  # of the road, rise over run
    force_limit: float = inf  # N, in both directions
    lag: float = 0.0  # time constant of the force in s
    delay: int = 0  # delay of the force in samples

    checks_finite = True

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Inputs ``force`` (N) and ``disturbance`` (m/s per step)."""
        return (
            Port("force", unit="N", feedthrough=False),
            Port("disturbance", unit="m/s", feedthrough=False, default=0.0),
        )

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Output ``v``, m/s."""
        return (Port("v", unit="m/s"),)

    def define(self, step: Fraction) -> Definition:
        """See `Block.define`."""
        parameters = {
            "h": float(step),
            "mass": self.mass,
            "drag": self.drag,
            "quadratic": self.quadratic_drag,
            "slope_force": self.mass * GRAVITY * self.slope / sqrt(1.0 + self.slope * self.slope),
            "limit": self.force_limit,
            "follows": 1.0 - exponential(-float(step) / self.lag) if self.lag else 1.0,
        }
        state: dict[str, Any] = {"speed": self.start_speed, "engine": 0.0, "sent": np.zeros(self.delay + 1)}
        return Definition(_look, _move, state=state, parameters=parameters)


@dataclass(frozen=True)
class Condition:
    """A difference from the controller's model."""

    text: str  # description
    label: str  # short description for figures
    car: Mapping[str, float] = field(default_factory=dict)  # parameters of `TrueCar` that differ
    noise: float = 1.0  # true standard deviation of the sensors relative to the model's
    ageing: float = 1.0  # the same at the end of the run, up to which the noise grows
    known_limit: bool = False  # whether the controller has the limit of the force


RIGHT = "right"
"""The condition without a difference."""


def conditions(settings: Models, car: Car) -> dict[str, Condition]:
    """Return the conditions by name: words of at most five letters, which are the heads of columns."""
    s, times = settings, "times the model's"
    limit = {"force_limit": s.force_limit}

    def mass(factor: float) -> Condition:
        return Condition(f"the mass is {factor:g} {times}", f"mass x {factor:g}", {"mass": factor * car.mass})

    def noise(factor: float) -> Condition:
        return Condition(f"the sensors' sd is {factor:g} {times}", f"sensor noise x {factor:g}", noise=factor)

    drag = f"an additional drag of {s.quadratic_drag:g} N s^2/m^2 times the squared speed"
    worn = f"the sensors' sd grows to {s.ageing:g} {times}"
    lag = f"the force has a lag with a time constant of {s.lag:g} s"
    late, samples = f"the force has a delay of {s.delay:g} s", round(s.delay / car.step)
    limited = f"the actuator is limited to {s.force_limit:g} N in both directions"
    with_limit = "the same, and the controller has the limit"
    return {
        RIGHT: Condition("all is as in the controller's model", "model right"),
        "mass up": mass(s.heavier),
        "mass down": mass(s.lighter),
        "drag": Condition(drag, "further drag", {"quadratic_drag": s.quadratic_drag}),
        "hill": Condition(f"a slope of {s.slope:.0%}", f"hill of {100 * s.slope:g} %", {"slope": s.slope}),
        "sd up": noise(s.noisier),
        "sd down": noise(s.quieter),
        "worn": Condition(worn, f"noise grows to x {s.ageing:g}", ageing=s.ageing),
        "lag": Condition(lag, f"lag of {s.lag:g} s", {"lag": s.lag}),
        "late": Condition(late, f"delay of {s.delay:g} s", {"delay": samples}),
        UNKNOWN_LIMIT: Condition(limited, "force limit, unknown", limit),
        "sat. told": Condition(with_limit, "force limit, known", limit, known_limit=True),
    }


UNKNOWN_LIMIT = "sat."
"""The condition for which no estimate of a disturbance helps: see the page on reproduction."""


def believed(settings: Models, car: Car) -> dict[str, controllers.LinearModel]:
    """Return the controller's models: unchanged, and with an unknown force that is also estimated."""
    return {"as it is": model(car), "with disturbance": disturbed(settings, car, settings.unmodelled_time)}


def disturbed(settings: Models, car: Car, time: float) -> controllers.LinearModel:
    """Return the model with an unknown force, whose random walk reaches its standard deviation within `time` seconds."""
    return model(car).with_disturbance(settings.unmodelled_force * settings.unmodelled_force * car.step / time)


@cache
def _controller(
    believed: controllers.LinearModel,
    learner: controllers.PrecisionLearner,
    start_speed: float,
    variances: tuple[float, ...],
    limit: float,
) -> controllers.BayesianController:
    return controllers.BayesianController(
        believed,
        precision=learner,
        initial_mean=start_speed,
        initial_covariance=np.diag(variances[: believed.states]),
        u_min=-limit,
        u_max=limit,
    )


def loop(
    settings: Models,
    car: Car,
    condition: Condition,
    believed: controllers.LinearModel,
    learner: controllers.PrecisionLearner,
    faults: Sequence[cosim.Fault] = (),
) -> cosim.Diagram:
    """Return the car of a condition with a controller's model; car and belief start on the reference."""
    s, std = settings, sqrt(car.sensor_variance)
    limit = s.force_limit if condition.known_limit else inf
    parameters: dict[str, Any] = {"mass": car.mass, "drag": car.drag, **condition.car}
    # At the end of the run the noise and the added growing noise have the requested standard deviation together.
    growth = std * sqrt(condition.ageing * condition.ageing - 1.0) / s.duration
    ageing = [cosim.NoiseGrowth(slope=growth, sensor=i) for i in range(car.sensors)] if growth else []
    return cosim.closed_loop(
        TrueCar(s.mean_speed, **parameters),
        _controller(
            believed, learner, s.mean_speed, (car.initial_variance, s.unmodelled_force * s.unmodelled_force), limit
        ),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=sqrt(car.process_variance))},
        sensors=cosim.Sensors(count=car.sensors, std=condition.noise * std, resolution=car.resolution),
        faults=[*ageing, *faults],
        reference=cosim.Sine(s.amplitude, s.period, offset=s.mean_speed),
    )
