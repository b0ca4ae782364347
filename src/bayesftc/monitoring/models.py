"""Models of a monitor that are chosen by name, each with a few parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bayesftc.controllers.models.checks import Matrix, as_covariance, as_matrix, check_number
from bayesftc.controllers.models.linear import LinearModel
from bayesftc.cosim.types import Floats


@dataclass(frozen=True)
class PlantModel:
    """Base of all models of ``[model]``, which describe the state's motion. Each sensor has its own row of C.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from bayesftc import monitoring
    >>> @dataclass(frozen=True)
    ... class Settling(monitoring.PlantModel):  # a quantity that returns to 0 with a time constant of 5 s
    ...     std: float
    ...     def matrices(self, dt):
    ...         return np.array([[np.exp(-dt / 5.0)]]), None, np.array([[self.std * self.std * dt]])
    >>> monitoring.Monitor(0.1, Settling(std=0.2), {"a": monitoring.Sensor(std=0.1)}).model.A.round(3).tolist()
    [[0.98]]
    """

    def matrices(self, dt: float) -> tuple[Floats, Floats | None, Floats]:
        """Return A, B (None: no input has an effect) and the covariance of the process noise per step."""
        raise TypeError(
            f"{type(self).__name__} has no method matrices(dt), which describes the state's motion. Add it."
        )

    def linear(self, dt: Fraction, inputs: int, C: Floats, sensor_covariance: Floats) -> LinearModel:
        """Return the linear model with its sensors."""
        A, B, Q = self.matrices(float(dt))
        B = np.zeros((len(A), max(inputs, 1))) if B is None else B
        return LinearModel(A, B, C, Q, sensor_covariance, dt)


@dataclass(frozen=True)
class RandomWalk(PlantModel):
    """A quantity that changes at random, such as a level or a temperature.

    Parameters
    ----------
    std : float
        Standard deviation of its change in one second.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "ab"}
    >>> model = monitoring.Monitor(0.25, monitoring.RandomWalk(std=0.2), sensors).model
    >>> model.process_covariance.round(4).tolist()  # in one step of 0.25 s
    [[0.01]]
    """

    std: float

    def __post_init__(self) -> None:
        check_number(self, "std", above=0)

    def matrices(self, dt: float) -> tuple[Floats, Floats | None, Floats]:
        """See `PlantModel.matrices`."""
        return np.eye(1), None, np.full((1, 1), self.std * self.std * dt)


@dataclass(frozen=True)
class Integrator(RandomWalk):
    """A quantity whose rate of change is the only input, such as a speed with a measured acceleration.

    Parameters
    ----------
    std : float
        Standard deviation of its change in one second that the input does not explain.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in ("wheel", "radar")}
    >>> inputs = {"acceleration": monitoring.Input()}
    >>> monitoring.Monitor(0.1, monitoring.Integrator(std=0.2), sensors, inputs).model.B.tolist()
    [[0.1]]
    """

    def matrices(self, dt: float) -> tuple[Floats, Floats | None, Floats]:
        """See `PlantModel.matrices`."""
        return np.eye(1), np.full((1, 1), dt), np.full((1, 1), self.std * self.std * dt)


@dataclass(frozen=True)
class ConstantRate(RandomWalk):
    """A quantity whose rate changes at random, such as a position whose speed is not measured.

    Parameters
    ----------
    std : float
        Standard deviation of the rate's change in one second.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "ab"}
    >>> model = monitoring.Monitor(0.5, monitoring.ConstantRate(std=0.2), sensors).model
    >>> model.A.tolist(), model.C.tolist()
    ([[1.0, 0.5], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0]])
    """

    def matrices(self, dt: float) -> tuple[Floats, Floats | None, Floats]:
        """See `PlantModel.matrices`."""
        q = self.std * self.std
        return (
            np.array([[1.0, dt], [0.0, 1.0]]),
            None,
            q * np.array([[dt * dt * dt / 3, dt * dt / 2], [dt * dt / 2, dt]]),
        )


@dataclass(frozen=True)
class Matrices(PlantModel):
    """A linear model given by its matrices, for the monitor's sample time.

    Parameters
    ----------
    A : matrix
        Transition of the state in one step (n x n).
    process_covariance : number, vector or matrix
        Covariance of the process noise per step (n x n).
    B : matrix, optional
        Effect of the inputs (n x p), one column per input.

    Examples
    --------
    >>> from bayesftc import monitoring
    >>> tank = monitoring.Matrices(A=[[0.98]], process_covariance=1e-4, B=[[0.02]])
    >>> sensors = {name: monitoring.Sensor(std=0.1) for name in "ab"}
    >>> monitor = monitoring.Monitor(0.1, tank, sensors, {"heater": monitoring.Input()})
    >>> monitor.model.sizes
    '1 state, 1 control, 2 sensors, dt = 0.1 s'
    """

    A: Sequence[Sequence[float]]
    process_covariance: Matrix
    B: Sequence[Sequence[float]] | None = None

    def matrices(self, dt: float) -> tuple[Floats, Floats | None, Floats]:
        """See `PlantModel.matrices`."""
        A = as_matrix("The model's A", self.A)
        B = None if self.B is None else as_matrix("The model's B", self.B, rows=len(A))
        return A, B, as_covariance("The model's process_covariance", self.process_covariance, len(A), singular=True)


PLANT_MODELS: tuple[type[PlantModel], ...] = (RandomWalk, Integrator, ConstantRate, Matrices)
"""To add a model, write it like those above and add it here."""
