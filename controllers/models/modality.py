"""Sensor modalities: groups of sensors that measure the state in one way, such as encoders or a camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import numpy as np

from bayesftc.controllers.models.checks import Matrix, as_covariance, as_matrix, as_numbers, as_vector
from bayesftc.controllers.models.linear_rows import linear_rows
from bayesftc.controllers.models.trial import try_out
from bayesftc.cosim.errors import KernelError, ModelError
from bayesftc.cosim.stepping.differentiation import jacobian
from bayesftc.cosim.types import Floats, Kernel, argument_names


@dataclass(frozen=True, eq=False)
class Modality:
    """Sensors that measure ``y = g(x)`` plus Gaussian noise.

    Parameters
    ----------
    name : str
        Name in error messages.
    size : int, optional
        Number of samples; needed with a `function`.
    function : function, optional
        A step function ``function(x, y)`` that writes the readings y of ideal sensors at the state x.
    matrix : matrix, optional
        In place of the function: a row for each sensor, with a column for each state.
    std : number or vector
        Nominal standard deviation of each sensor's noise.
    covariance : number, vector or matrix, optional
        Nominal covariance of the noise, instead of `std`.
    precision : number or vector
        Weight of each sensor's prediction error while the sensor counts as healthy. It is relative to the other sensors and to
        the state prior, in units that keep the belief's update stable, and need not be an inverse variance.
    jacobian : function, optional
        A step function ``jacobian(x, y_x)`` that writes the derivatives of the function (size x states). By default automatic
        differentiation makes it from the function.

    Raises
    ------
    ModelError
        If neither or both of function and matrix are given, or sizes and signs do not fit.

    Examples
    --------
    >>> from bayesftc import controllers
    >>> encoders = controllers.Modality("encoders", matrix=[[1.0, 0.0], [1.0, 0.0]], std=0.01)
    >>> tachometer = controllers.Modality("tachometer", matrix=[[0.0, 1.0]], std=0.05)
    >>> law = controllers.ProportionalDerivative(gain=4.0, derivative_gain=2.0)
    >>> controller = controllers.UnbiasedActiveInference(
    ...     [encoders, tachometer], law, dt=0.01, belief_rate=20.0, control="law"
    ... )
    >>> controller.online(compiled=False)(y=[0.1, 0.1, 0.0], goal=[1.0]).u.round(2).tolist()
    [3.84]
    """

    name: str
    size: int | None = None
    function: Callable[..., None] | None = None
    matrix: Matrix | None = None
    std: float | Sequence[float] | None = None
    covariance: Matrix | None = None
    precision: float | Sequence[float] = 1.0
    jacobian: Callable[..., None] | None = None

    def __post_init__(self) -> None:
        if (self.function is None) == (self.matrix is None):
            raise ModelError(f"{self._title} needs exactly one of function= and matrix=.")
        if self.matrix is not None:
            if self.jacobian is not None:
                raise ModelError(
                    f"{self._title} has a matrix and a jacobian; leave the jacobian out, as it is the matrix."
                )
            rows = np.atleast_2d(
                as_numbers(
                    f"The matrix of {self._title}",
                    self.matrix,
                    "give a row for each sensor, with a column for each state",
                )
            )
            matrix = as_matrix(f"The matrix of {self._title}", rows)
            if self.size not in {None, len(matrix)}:
                raise ModelError(
                    f"{self._title} has size={self.size}, but its matrix has {len(matrix)} rows; leave size out."
                )
            object.__setattr__(self, "matrix", matrix)
            object.__setattr__(self, "size", len(matrix))
        if isinstance(self.size, bool) or not isinstance(self.size, int | np.integer) or self.size < 1:
            raise ModelError(f"{self._title} has size={self.size!r}; give its number of samples, at least 1.")
        for kind in ("function", "jacobian"):
            function = getattr(self, kind)
            if function is not None and (not isinstance(function, FunctionType) or len(argument_names(function)) != 2):
                raise ModelError(
                    f"{self._title} has {kind}={function!r}; give a plain Python function of two arguments, the state and the "
                    "result that it writes."
                )
        if (self.std is None) == (self.covariance is None):
            raise ModelError(f"{self._title} needs exactly one of std= and covariance=, its nominal noise.")
        nominal: Any = self.covariance
        if nominal is None:
            std = as_vector(f"The std of {self._title}", self.std, self.samples)
            if (std <= 0).any():
                raise ModelError(f"{self._title} has std={std.tolist()}; it must be positive.")
            nominal = std * std
        object.__setattr__(self, "covariance", as_covariance(f"The covariance of {self._title}", nominal, self.samples))
        weights = as_vector(f"The precision of {self._title}", self.precision, self.samples)
        if (weights <= 0).any():
            raise ModelError(f"{self._title} has precision={weights.tolist()}; it must be positive.")
        object.__setattr__(self, "precision", weights)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.size or 0)

    def try_out(self, states: int) -> None:
        """Check that the functions accept that many states and write all of their results.

        Raises
        ------
        ModelError
            If they do not.
        """
        for kind, form, shape in (
            ("function", "function(x, y)", (self.samples,)),
            ("jacobian", "jacobian(x, y_x)", (self.samples, states)),
        ):
            if (function := getattr(self, kind)) is not None:
                try_out(f"The {kind} of {self._title}", function, form, [states], [shape])

    def derivative(self, states: int) -> Kernel | None:
        """Return the step function of the Jacobian; None for a matrix.

        Raises
        ------
        ModelError
            If the function or its Jacobian cannot be computed for that many states.
        """
        if self.matrix is not None:
            if np.asarray(self.matrix).shape[1] != states:
                raise ModelError(
                    f"The matrix of {self._title} has {np.asarray(self.matrix).shape[1]} columns, but there are {states} states; "
                    "give a column for each."
                )
            return None
        assert self.function is not None
        if self.jacobian is not None:
            return self.jacobian
        x, y = argument_names(self.function)
        try:
            return jacobian(self.function, {x: states, y: self.samples}, y, [x])
        except KernelError as error:
            if not isinstance(error.__cause__, IndexError):
                raise KernelError(f"The function of {self._title}: {error}") from None
            raise ModelError(
                f"The function of {self._title} does not fit {states} states and {self.samples} samples: {error.__cause__}."
            ) from None

    def rows(self, states: int) -> Floats:
        """Return the matrix from the state to each sensor's reading (samples x states); NaN in rows that are not linear."""
        if self.matrix is not None:
            return np.asarray(self.matrix, dtype=np.float64)
        assert self.function is not None
        return linear_rows(self.function, self.samples, states)

    def jacobian_at(self, mean: Floats) -> Floats:
        """Return the Jacobian at a state (samples x states)."""
        derivative = self.derivative(len(mean))
        if derivative is None:
            return np.asarray(self.matrix, dtype=np.float64)
        result = np.full((self.samples, len(mean)), np.nan)
        with np.errstate(all="ignore"):
            derivative(np.array(mean, dtype=np.float64), result)
        if not np.isfinite(result).all():
            raise ModelError(
                f"The Jacobian of {self._title} has entries that are NaN or infinite at the initial mean {mean.tolist()}; "
                "give another initial mean, or check the function."
            )
        return result

    @property
    def _title(self) -> str:
        return f"the modality {self.name!r}"


__all__ = ["Modality"]
