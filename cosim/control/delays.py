"""Delays of a sampled loop that are no multiple of its sample time.

Within a sample the delayed input of the plant has two values, one after the other. A plant in continuous time says what each of
them does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesftc.cosim.blocks.linear_system import held
from bayesftc.cosim.control.balance import balanced
from bayesftc.cosim.control.margins import Response, product, unit_grid
from bayesftc.cosim.types import Floats

LEAST_POLE, MOST_ANGLE = 1e-3, np.pi / 2
"""A plant in discrete time is interpolated, except for poles smaller than this, if no other pole has a larger angle than this.

A smaller pole may be a delay, which has no logarithm. A larger angle may be an even faster mode that was sampled too seldom.
"""
FINE = 33
"""Number of points between two of these frequencies if ``1 + L`` is near to 0 there."""
SOON = 1e-9
"""A short delay in samples."""
PARTS = 16
"""Into so many parts a sample is divided in the search for a delay at which the loop is not stable."""
POINTS = 1000
"""Number of frequencies, besides those about the poles, at which the loop is evaluated to count its turns."""
TURNS = 64
"""Number of turns of the phase after which the search ends."""
NEAR = 1.0 / 512
"""Distance in samples between a stable and an unstable delay, from which the limit is computed."""
UNCERTAIN = 1e-3
"""How far the limit may be below the least unstable delay that was found, as a share of this delay."""
OUTSIDE = 1e-9
"""How far outside the unit circle the loop is evaluated, where no pole of an integrator or an undamped mode lies."""


class Matrices(NamedTuple):
    """A linear system in discrete time."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats


@dataclass(frozen=True)
class Held:
    """What the inputs of a plant do to its states within a sample of the controller.

    Parameters
    ----------
    A, B : ndarray
        Matrices of the plant.
    step : float
        Sample time of the controller in seconds.
    steps : int
        Steps of the plant in each sample, for matrices in discrete time. 0 for those in continuous time.
    between : Held, optional
        The plant in continuous time of which those in discrete time may be samples: what it does between two steps.
    """

    A: Floats
    B: Floats
    step: float
    steps: int = 0
    between: Held | None = None

    def reached(self, part: float) -> Floats:
        """Return the effect of inputs of 1 for a part of a sample: a column for each input.

        At the steps of a plant in discrete time it is exact. Between two of them it grows linearly, or as that of `between`.
        """
        if not self.steps:
            return held(self.A, self.B, part * self.step)[1]
        whole, rest = divmod(part * self.steps, 1.0)
        before = repeated(self.A, self.B, int(whole))[1]
        effect = before + rest * (self.A @ before + self.B - before)
        if self.between is None or not rest:
            return effect
        last, following = (self.between.reached((whole + n) / self.steps) for n in (0, 1))
        return effect + self.between.reached(part) - last - rest * (following - last)

    def kept(self, states: NDArray[np.bool_]) -> Held:
        """Return the same for some of the states."""
        between = None if self.between is None else self.between.kept(states)
        return Held(self.A[np.ix_(states, states)], self.B[states], self.step, self.steps, between)


def interpolated(A: Floats, B: Floats, step: float, steps: int) -> Held:
    """Return what the inputs of a plant in discrete time do within a sample; exactly, if it is clear which plant was sampled.

    At the plant's own steps it is exact in any case.

    Parameters
    ----------
    A, B : ndarray
        Matrices of a step of the plant.
    step : float
        Sample time of the controller in seconds.
    steps : int
        Steps of the plant in each sample.
    """
    from scipy.linalg import expm, logm, schur, solve_sylvester

    given = Held(A, B, step, steps)
    same, units = balanced(A)
    upper, basis, n = (
        schur(same, sort=lambda real, imaginary: np.hypot(real, imaginary) >= LEAST_POLE) if len(A) else (A, A, 0)
    )
    slow, fast = upper[:n, :n], upper[n:, n:]
    if not n or np.abs(np.angle(np.linalg.eigvals(slow))).max() > MOST_ANGLE:
        return given
    # Other coordinates decouple the states with poles at zero, whose effect grows linearly within a sample.
    other = np.eye(len(A))
    other[:n, n:] = solve_sylvester(slow, -fast, -upper[:n, n:])
    basis = units[:, None] * basis @ other
    inputs: Any = np.linalg.solve(basis, B)
    m = B.shape[1]
    both = np.block([[slow, inputs[:n]], [np.zeros((m, n)), np.eye(m)]])
    scaled, scales = balanced(both)
    rates = logm(scaled)
    if np.iscomplexobj(rates) or not np.allclose(expm(rates), scaled, rtol=0.0, atol=1e-9 * np.abs(scaled).max()):
        return given
    rates = rates * (scales[:, None] / scales) * steps
    a, b = np.zeros_like(A), np.vstack([rates[:n, n:], repeated(fast, inputs[n:], steps)[1]])
    a[:n, :n] = rates[:n, :n]
    return replace(given, between=Held(basis @ a @ np.linalg.inv(basis) / step, basis @ b / step, step))


def repeated(a: Floats, b: Floats, times: int) -> tuple[Floats, Floats]:
    """Return the matrices of several steps with the inputs held."""
    A, B = np.eye(len(a)), np.zeros_like(b)
    for _ in range(times):
        A, B = a @ A, a @ B + b
    return A, B


def late(system: Matrices, delays: Sequence[Fraction], within: Held | None = None) -> Matrices:
    """Return a system whose first inputs act some samples later: the past inputs are further states.

    Parameters
    ----------
    system : Matrices
        The system.
    delays : sequence of Fraction
        Delays in samples.
    within : Held, optional
        What the inputs do within a sample; only for delays that are not whole.
    """
    A, B, C, D = system
    states = len(A)
    for j, delay in enumerate(delays):
        samples, part = divmod(delay, 1)
        if part and within is not None:
            first = np.zeros((len(A), 1))
            first[:states, 0] = within.reached(float(1 - part))[:, j]
            A, B, C, D = _behind(Matrices(A, B, C, D), j, first)
        for _ in range(int(samples)):
            A, B, C, D = _behind(Matrices(A, B, C, D), j, np.zeros((len(A), 1)))
    return Matrices(A, B, C, D)


def _behind(system: Matrices, j: int, first: Floats) -> Matrices:
    """Return a system with the last value of an input as a further state, which acts except for what the present one does."""
    A, B, C, D = system
    n = len(A)
    A, B = np.block([[A, B[:, [j]] - first], [np.zeros((1, n + 1))]]), np.vstack([B, np.eye(1, B.shape[1], j)])
    C, D = np.hstack([C, D[:, [j]]]), D.copy()
    B[:n, [j]], D[:, j] = first, 0.0
    return Matrices(A, B, C, D)


def delay_margin(loop: Matrices, reached: Callable[[float], Floats], start: float = 0.0) -> float:
    """Return the shortest additional delay of its input, in samples, at which a stable loop is at the limit of stability.

    For each delay, the number of turns of ``1 + L`` around 0 says whether the closed loop is stable (Nyquist). The turns are
    counted for each part of the first sample. Whole samples more can make the loop unstable only when the phase is -180 degrees
    at a frequency at which the gain is 1: the turns are counted again there.

    Parameters
    ----------
    loop : Matrices
        The loop transfer function without delay, for negative feedback. B and D are what the input does at once, if it is not
        delayed by a part of a sample; without what it does within the sample.
    reached : callable
        What an input of 1 does to the states for a part of a sample.
    start : float
        Delay of the stable loop in samples.
    """
    from functools import cache

    from scipy.optimize import root

    response = Response(loop.A, loop.C)
    angles = unit_grid(response.poles, POINTS)
    columns = response.columns((1.0 + OUTSIDE) * np.exp(1j * angles))
    at_once, whole = response.inputs(loop.B), response.inputs(reached(1.0))

    @cache
    def within(part: float) -> Any:
        return response.inputs(reached(part))

    def turned(delay: float, angles: Any, columns: Any) -> Any:
        """Return ``1 + L`` with a delay."""
        samples, part = divmod(delay, 1.0)
        first = within(1.0 - part) if part else whole + at_once
        values = product(first, columns)
        if part:
            values += np.exp(-1j * angles) * (product(whole - first + at_once, columns) + loop.D[0, 0])
        else:
            values += loop.D[0, 0]
        return 1.0 + np.exp(-1j * samples * angles) * values

    def turns(delay: float) -> float:
        around = turned(delay, angles, columns)
        steps = _steps(around)
        far = np.abs(np.diff(around)) > np.minimum(np.abs(around[:-1]), np.abs(around[1:]))
        fine: Floats = np.linspace(angles[:-1][far], angles[1:][far], FINE)
        z: Any = (1.0 + OUTSIDE) * np.exp(1j * fine.ravel())
        more = turned(delay, fine.ravel(), response.columns(z))
        steps[far] = _steps(more.reshape(fine.shape)).sum(axis=0)
        return float(steps.sum())

    stable = turns(start)

    def lost(delay: float) -> bool:
        return bool(abs(turns(delay) - stable) > 0.5 * np.pi)

    soon = np.ceil(start) + SOON  # what an input does at once it does a sample later as soon as it is delayed
    places = sorted([soon, *(start + i / PARTS for i in range(1, PARTS + 1))])

    def candidates() -> Iterator[float]:
        yield from places
        yield from np.unique(
            np.concatenate([each + _later(turned(each, angles, columns) - 1.0, angles) for each in places])
        )

    low = start
    for high in candidates():
        if lost(high):
            break
        low = high
    else:
        return np.inf
    while high - low > NEAR:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if lost(middle) else (middle, high)
    nearest = float(angles[np.argmin(np.abs(turned(high, angles, columns)))])

    def away(point: Floats) -> Floats:
        angle = point[:1]
        value = complex(turned(float(point[1]), angle, response.columns(np.exp(1j * angle)))[0])
        return np.array([value.real, value.imag])

    found = root(away, [nearest, 0.5 * (low + high)])
    # Very near to the limit the turns are uncertain: of a slow loop, a little outside the unit circle, by many samples.
    if found.success and -max(1.0 / PARTS, UNCERTAIN * high) < found.x[1] - high <= high - low:
        return float(max(found.x[1] - start, 0.0))
    return float(max(low, np.floor(high)) - start)


def _later(values: Any, angles: Floats) -> Floats:
    """Return whole numbers of samples after which a stable loop may not be stable.

    The numbers are interpolated, so that those a little larger are among them. With a gain of 1 or more at half of the sampling
    frequency one more sample is too much: there it turns the sign.
    """
    size = np.abs(values) - 1.0
    i = np.flatnonzero(np.sign(size[:-1]) != np.sign(size[1:]))
    share = size[i] / (size[i] - size[i + 1])
    at = angles[i] + share * (angles[i + 1] - angles[i])
    lags = np.angle(-(values[i] + share * (values[i + 1] - values[i]))) % (2.0 * np.pi)
    samples = ((lags + 2.0 * np.pi * np.arange(TURNS)[:, None]) / at).ravel()
    whole = np.concatenate(
        [np.floor(samples), np.ceil(samples), np.ceil(1.002 * samples), [1.0] if size[-1] >= 0.0 else []]
    )
    return np.unique(whole[whole > 0.0])


def _steps(values: Any) -> Any:
    """Return the angles from each value to the next one."""
    return np.angle(values[1:] * values[:-1].conj())


__all__ = ["Held", "Matrices", "delay_margin", "interpolated", "late", "repeated"]
