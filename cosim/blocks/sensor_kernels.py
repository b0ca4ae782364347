"""Step functions of the sensors, put together from a way to measure and a way to disturb."""

from collections.abc import Callable
from functools import cache
from typing import Any

from bayesftc.cosim.ops import floor, select
from bayesftc.cosim.types import Kernel


def one_to_one(u, matrix, clean):
    """Let sensor i read signal i, and begin again at the first signal where there are more sensors."""
    for i in range(clean.shape[0]):
        clean[i] = u[i % u.shape[0]]


def linear(u, matrix, clean):
    """Compute ``matrix @ u``; a signal with a zero coefficient is not seen, not even where it is missing."""
    for i in range(clean.shape[0]):
        total = 0.0
        for j in range(u.shape[0]):
            total = total + select(matrix[i, j] == 0.0, 0.0, matrix[i, j] * u[j])
        clean[i] = total


@cache
def by_function(function: Kernel) -> Kernel:
    """Return the measurement that a user has written as ``function(u, clean)``."""

    def measure(u, matrix, clean):
        function(u, clean)

    return measure


def independent(factor, noise, i):
    """Return the noise of sensor i; ``factor`` is a column of standard deviations."""
    return factor[i, 0] * noise[i]


def correlated(factor, noise, i):
    """Return the noise of sensor i; ``factor`` is a lower triangle."""
    total = factor[i, 0] * noise[0]
    for j in range(1, i + 1):
        total = total + factor[i, j] * noise[j]
    return total


@cache
def sensors(measure: Kernel, disturbance: Callable[..., Any]) -> Kernel:
    """Return the step function of sensors that measure and are disturbed in the given ways."""

    def sense(u, noise, matrix, factor, bias, resolution, clean, y):
        measure(u, matrix, clean)
        for i in range(y.shape[0]):
            value = clean[i] + bias[i] + disturbance(factor, noise, i)
            y[i] = select(resolution[i] > 0.0, floor(value / resolution[i] + 0.5) * resolution[i], value)

    return sense
