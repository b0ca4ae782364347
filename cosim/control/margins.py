"""Stability margins of a sampled loop, from its transfer function on the unit circle.

python-control searches crossings between the points of a frequency grid. For a sampled loop the limit is often at half of the
sampling frequency, the end of each grid, and a lightly damped mode lies between grid points. So the grid here has both ends,
and points about each pole. Crossings are then refined on the transfer function itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.control.balance import balanced
from bayesftc.cosim.types import Floats

GRID = 4000
"""Number of grid points from 0 to half of the sampling frequency: half of them linearly spaced, half logarithmically."""

ABOUT = np.concatenate([-np.geomspace(100.0, 0.01, 60), np.geomspace(0.01, 100.0, 60)])
"""Grid points about a pole, in units of its distance from the unit circle."""


class Response:
    """The frequency response of a system with one output, from the Schur form of its matrix: quick for many frequencies.

    Parameters
    ----------
    A, C : ndarray
        Matrices of the system.

    Attributes
    ----------
    A : ndarray
        The matrix in balanced units, because the states' units must not decide what counts as a pole.
    poles : ndarray of complex
        Poles of the system.
    """

    def __init__(self, A: Floats, C: Floats):
        from scipy.linalg import schur

        self.A, self._units = balanced(A)
        if len(A):
            self._upper, self._basis = schur(self.A, output="complex")
        else:
            self._upper = self._basis = np.zeros((0, 0), complex)
        self.poles = np.diag(self._upper)
        self._outputs = (C * self._units)[0] @ self._basis

    def inputs(self, B: Floats) -> NDArray[np.complex128]:
        """Return an input matrix of one column for a product with `columns`."""
        scaled: NDArray[np.complex128] = self._basis.conj().T @ (np.ravel(B) / self._units)
        return scaled

    def columns(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return ``C (z I - A)^-1``, a column for each `z`; `product` multiplies them by an input matrix."""
        found = np.zeros((len(self.poles), len(z)), complex)
        for i, pole in enumerate(self.poles):
            found[i] = (self._outputs[i] + product(self._upper[:i, i], found[:i])) / (z - pole)
        return found


def product(row: NDArray[np.complex128], columns: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the product of a row and columns, without the threads of BLAS: with so few numbers each waits for the others."""
    result: NDArray[np.complex128] = np.einsum("i,ij->j", row, columns)
    return result


class Margins(NamedTuple):
    """Stability margins of a stable loop; infinite or NaN if there is no such crossing.

    Attributes
    ----------
    gain : float
        Gain margin: the factor of the loop gain, nearest to 1 on a logarithmic scale, at which the loop is at the limit of
        stability. It is below 1 if a lower gain reaches the limit sooner than a higher gain.
    phase : float
        Phase margin in degrees: the smallest change of phase, in either direction, at which the loop is at the limit. It is
        negative if that is a lead; the delay margin then belongs to another crossover.
    delay : float
        Delay margin in seconds: the shortest additional delay of the plant's input at which the loop is at the limit. The control
        is held from sample to sample, and may change at any time within a sample of the plant. This is exact for a plant in
        continuous time. A plant in discrete time is interpolated between its samples as if it had been sampled from one in
        continuous time. With a pole near 0, such as a delay among its states, or an oscillation of less than four samples, this
        is an approximation, exact for whole samples only.
    gain_crossover, phase_crossover : float
        Frequencies in rad/s of the phase margin, where the gain is 1, and of the gain margin, where the phase is -180 degrees.
    modulus : float
        Smallest distance of the loop transfer function from -1.
    lowest_gain, highest_gain : float
        The loop is stable while its gain is between these factors of the designed one. One of them is the gain margin. The first
        one is 0 if no lower gain is a limit, as for most stable plants, and the second one infinite if no higher gain is.

    Examples
    --------
    >>> from bayesftc import controllers, cosim, fmus
    >>> servo = cosim.FMU(fmus.path("PositionServo"))
    >>> controller = controllers.design(servo, measured="angle", actuated="voltage")
    >>> loop = cosim.closed_loop(servo, controller, control="voltage", measured="angle", reference=1.0)
    >>> margins = loop.linear().margins()
    >>> round(margins.gain, 1), round(margins.phase), round(margins.delay, 2)
    (2.7, 47, 0.17)
    """

    gain: float
    phase: float
    delay: float
    gain_crossover: float
    phase_crossover: float
    modulus: float
    lowest_gain: float = 0.0
    highest_gain: float = float("inf")

    def __repr__(self) -> str:
        return short(self, phase="deg", delay="s", gain_crossover="rad/s", phase_crossover="rad/s")


def margins_of(loop: Any, delay: float = np.nan) -> Margins:
    """Return the margins of a loop.

    Parameters
    ----------
    loop : control.StateSpace
        The transfer function of a sampled loop with one input and one output, for negative feedback.
    delay : float
        Its delay margin in seconds, which depends on the plant between the samples: see `bayesftc.cosim.control.delays`.
    """
    from scipy.optimize import minimize_scalar

    system = Response(loop.A, loop.C)
    A, poles, inputs = system.A, system.poles, system.inputs(loop.B)

    def response(angle: Any) -> Any:
        values = product(inputs, system.columns(np.exp(1j * np.atleast_1d(angle)))) + loop.D[0, 0]
        return values if np.ndim(angle) else complex(values[0])

    grid = unit_grid(poles)
    values = response(grid)
    # At both ends the response is real, except for rounding.
    ends = [a for a in (0.0, np.pi) if not (np.abs(poles - np.exp(1j * a)) < 1e-9).any() and not _is_pole(A, a)]
    real = [a for a in _crossings(lambda a: response(a).imag, grid, values.imag) if 1e-9 < a < np.pi - 1e-9]
    limits = [(a, -1.0 / response(a).real) for a in [*real, *ends] if response(a).real < 0.0]
    phase_crossover, gain = min(limits, key=lambda each: abs(np.log(each[1])), default=(np.nan, np.inf))
    unit = _crossings(lambda a: abs(response(a)) - 1.0, grid, np.abs(values) - 1.0)
    lags = [(a, np.angle(-response(a))) for a in unit if a > 0.0]  # a negative lag is a lead
    gain_crossover, phase = min(lags, key=lambda each: abs(each[1]), default=(np.nan, np.inf))
    nearest = int(np.argmin(np.abs(1.0 + values)))
    around = grid[max(nearest - 1, 0)], grid[min(nearest + 1, len(grid) - 1)]
    least = minimize_scalar(lambda a: abs(1.0 + response(a)), bounds=around, method="bounded", options={"xatol": 1e-12})
    step = float(loop.dt)
    return Margins(
        float(gain),
        float(np.rad2deg(phase)),
        float(delay),
        float(gain_crossover / step),
        float(phase_crossover / step),
        float(min(least.fun, abs(1.0 + values[nearest]), *(abs(1.0 + response(a)) for a in ends), np.inf)),
        float(max((factor for _, factor in limits if factor < 1.0), default=0.0)),
        float(min((factor for _, factor in limits if factor > 1.0), default=np.inf)),
    )


def _is_pole(A: Floats, angle: float) -> bool:
    """Return whether there is a pole at this angle of the unit circle, also a repeated one, which is computed less exactly."""
    return bool(len(A)) and float(np.linalg.cond(np.exp(1j * angle) * np.eye(len(A)) - A)) > 1e15


def unit_grid(poles: NDArray[np.complex128], number: int = GRID) -> Floats:
    """Return angles from 0 to pi, dense where the transfer function changes fast, and not at poles."""
    half = number // 2
    points = [np.linspace(np.pi / half, np.pi, half), np.geomspace(1e-7, np.pi, half)]
    for pole in poles[poles.imag >= 0.0]:
        points.append(np.angle(pole) + max(abs(1.0 - abs(pole)), 1e-7) * ABOUT)
    grid = np.unique(np.concatenate(points))
    return grid[(grid >= 1e-7) & (grid <= np.pi)]


def _crossings(function: Callable[[float], float], grid: Floats, values: Floats) -> list[float]:
    """Return the zeros of a function of the angle, given its values on the grid, without jumps to the other sign."""
    from scipy.optimize import brentq

    zeros = []
    for i in np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0):
        place = brentq(function, grid[i], grid[i + 1], xtol=1e-14, rtol=1e-13)
        if abs(function(place)) <= max(abs(values[i]), abs(values[i + 1])):
            zeros.append(float(place))
    return zeros + [float(a) for a in grid[values == 0.0]]


__all__ = ["Margins", "margins_of"]
