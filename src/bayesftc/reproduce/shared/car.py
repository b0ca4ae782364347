"""The cruise control of experiments 2 and 3 as a closed loop on the FMU."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import sqrt

from bayesftc import controllers, cosim, fmus
from bayesftc.reproduce.settings import Car


@cache
def _controller(car: Car, learner: controllers.PrecisionLearner, start_speed: float) -> controllers.BayesianController:
    return controllers.BayesianController(
        model(car), precision=learner, initial_mean=start_speed, initial_covariance=car.initial_variance
    )


@cache
def model(car: Car) -> controllers.LinearModel:
    """Return the controller's model of the car, which is exact as long as no sensor fails."""
    return controllers.LinearModel(
        [[1.0 - car.drag / car.mass * car.step]],
        [[car.step / car.mass]],
        [[1.0]] * car.sensors,
        process_covariance=car.process_variance,
        sensor_covariance=car.sensor_variance,
        dt=car.step,
    )


def closed_loop(
    car: Car,
    learner: controllers.PrecisionLearner,
    faults: Sequence[cosim.Fault],
    reference: cosim.Source,
    start_speed: float,
) -> cosim.Diagram:
    """Return the car under the Bayesian controller; car and belief start at `start_speed` in m/s."""
    plant = cosim.FMU(fmus.path("CruiseControl"), parameters={"v0": start_speed, "m": car.mass, "b": car.drag})
    return cosim.closed_loop(
        plant=plant,
        controller=_controller(car, learner, start_speed),
        control="force",
        measured="v",
        noise={"disturbance": cosim.Gaussian(std=sqrt(car.process_variance))},
        sensors=cosim.Sensors(count=car.sensors, std=sqrt(car.sensor_variance), resolution=car.resolution),
        faults=faults,
        reference=reference,
    )
