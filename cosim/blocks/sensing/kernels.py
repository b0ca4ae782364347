"""Step functions of the sensors, each composed of a measurement function and a noise function, and the gate of slow ones."""

from collections.abc import Callable
from functools import cache
from typing import Any

from bayesftc.cosim.blocks.faults.kernels import NAN, due
from bayesftc.cosim.ops import floor, select
from bayesftc.cosim.types import Kernel


def one_to_one(u, matrix, clean):
    """Let sensor i read signal i; if there are more sensors than signals, start again at the first signal."""
    for i in range(clean.shape[0]):
        clean[i] = u[i % u.shape[0]]


def linear(u, matrix, clean):
    """Compute ``matrix @ u``; a signal with a zero coefficient has no effect, not even as NaN."""
    for i in range(clean.shape[0]):
        total = 0.0
        for j in range(u.shape[0]):
            total = total + select(matrix[i, j] == 0.0, 0.0, matrix[i, j] * u[j])
        clean[i] = total


@cache
def by_function(function: Kernel) -> Kernel:
    """Return the measurement function for a user's ``function(u, clean)``."""

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
    """Return the step function of sensors with the given measurement and noise functions."""

    def sense(u, noise, matrix, factor, bias, resolution, clean, y):
        measure(u, matrix, clean)
        for i in range(y.shape[0]):
            value = clean[i] + bias[i] + disturbance(factor, noise, i)
            y[i] = select(resolution[i] > 0.0, floor(value / resolution[i] + 0.5) * resolution[i], value)

    return sense


@cache
def slow(sense: Kernel) -> Kernel:
    """Return the step function of sensors of which each has a sample in every n-th step, given that of sensors with all."""

    def sense_when_due(k, u, noise, matrix, factor, bias, resolution, every, clean, y):
        sense(u, noise, matrix, factor, bias, resolution, clean, y)
        for i in range(y.shape[0]):
            y[i] = select(due(k, every[i]) > 0.5, y[i], NAN)

    return sense_when_due
