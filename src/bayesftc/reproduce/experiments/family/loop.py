"""The closed loop of a case of the family."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.types import Floats
from bayesftc.reproduce.experiments.family.cases import PLANTS, Case, Plant
from bayesftc.reproduce.settings import Car
from bayesftc.reproduce.shared.car import model as model_of_car


def family_loop(case: Case, learner: controllers.PrecisionLearner, *, drop_faulty: bool = False) -> cosim.Diagram:
    """Return the loop of a case with a learner; with `drop_faulty`, the faulty sensors' samples are missing."""
    plant = PLANTS[case.plant]
    count = case.sensors * len(plant.measured)
    return cosim.closed_loop(
        cosim.FMU(fmus.path(plant.fmu), parameters={**_start(plant), **case.parameters}),
        _controller(case.plant, case.sensors, _each(case, case.believed or case.std), learner),
        control=plant.actuated,
        measured=plant.measured,
        noise={
            name: cosim.Gaussian(mean=plant.means.get(name, 0.0), std=std)
            for name, std in plant.noise.items()
            if name not in plant.actuated
        },
        sensors=cosim.Sensors(
            count=count,
            std=_each(case, case.std),
            signals=len(plant.measured),
            resolution=tuple(case.resolution * std for std in _nominal(plant, count)),
            matrix=_matrix(plant, count, case.reads),
        ),
        faults=[*case.faults, *(case.missing if drop_faulty else ())],
        reference=plant.references if len(plant.references) > 1 else plant.references[0],
    )


def goal_error(case: Case, result: cosim.Result) -> Floats:
    """Return the goal outputs minus their references over the evaluated time.

    The car's controller steers the state at t_k+1 to the goal at t_k; those of `controllers.design` have a longer horizon.
    """
    values = [result[name] for name in signals_of_goals(case)]
    half = len(values) // 2
    pairs = zip(values[:half], values[half:], strict=True)
    ahead, first = int(not PLANTS[case.plant].accept), int(np.searchsorted(result.time, PLANTS[case.plant].settled))
    return np.array([(output[ahead:] - reference[: len(reference) - ahead])[first:] for output, reference in pairs])


def signals_of_goals(case: Case) -> tuple[str, ...]:
    """Return the names of the goal outputs, and then of their references."""
    goals = PLANTS[case.plant].goals
    references = [f"reference_{i}" for i in range(len(goals))] if len(goals) > 1 else ["reference"]
    return (*(f"plant.{goal}" for goal in goals), *(f"{reference}.y" for reference in references))


def faulty_samples(case: Case, time: Floats) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return whether a fault was present at each sample, of shape (steps, sensors)."""
    truth = np.zeros((len(time), case.sensors * len(PLANTS[case.plant].measured)), bool)
    for gone in case.missing:
        start, stop = gone.times
        truth[(start <= time) & (time < stop), gone.sensor] = True
    return truth


def _start(plant: Plant) -> dict[str, float]:
    """Return the parameters with which the car starts on its reference; the others start at rest."""
    return {} if plant.accept else {"v0": 20.0}


def _nominal(plant: Plant, count: int) -> list[float]:
    return [plant.std[i % len(plant.std)] for i in range(count)]


def _each(case: Case, relative: Sequence[float]) -> tuple[float, ...]:
    """Return the standard deviation of each sensor, from those relative to the plant's."""
    plant = PLANTS[case.plant]
    nominal = _nominal(plant, case.sensors * len(plant.measured))
    return tuple(std * relative[i % len(relative)] for i, std in enumerate(nominal))


def _matrix(plant: Plant, count: int, reads: Mapping[int, tuple[float, ...]]) -> list[list[float]] | None:
    """Return the matrix from the measured outputs to the sensors; None if they are read in turn."""
    if not reads:
        return None
    matrix = np.eye(len(plant.measured))[[i % len(plant.measured) for i in range(count)]]
    for sensor, row in reads.items():
        matrix[sensor] = row
    rows: list[list[float]] = matrix.tolist()
    return rows


def _controller(
    name: str, sensors: int, std: tuple[float, ...], learner: controllers.PrecisionLearner
) -> controllers.BayesianController:
    return replace(_designed(name, sensors, std), precision=learner)


@cache
def _designed(name: str, sensors: int, std: tuple[float, ...]) -> controllers.BayesianController:
    """Return the controller of a plant with fixed precision, for the given standard deviations of its sensors."""
    plant = PLANTS[name]
    if not plant.accept:
        right = model_of_car(Car(sensors=sensors))
        model = replace(right, sensor_covariance=np.diag(np.square(std)))
        return controllers.BayesianController(
            model, controllers.FixedPrecision(), initial_mean=20.0, initial_covariance=1.0
        )
    return controllers.design(
        cosim.FMU(fmus.path(plant.fmu)),
        measured=plant.measured,
        goal=plant.goals,
        actuated=plant.actuated,
        sensors=len(std),
        sensor_std=std,
        noise=plant.noise,
        dt=plant.dt,
        acceptable_error=plant.accept[0],
        acceptable_control=plant.accept[1],
        precision=controllers.FixedPrecision(),
        u_min=plant.limits[0],
        u_max=plant.limits[1],
    )
