"""Derivatives of a function by differences of its values."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from bayesftc.cosim.blocks.state_space import StateSpace

BENDS = 0.05
"""From this relative difference of the slopes on both sides of a point on, a function bends there."""

SMOOTH = 1e-6
"""Largest bend of a smooth function, relative to its slope over one of the larger steps."""

GROWS = 1.5
"""A slope or bend that grows by more than this while the step shrinks to a tenth shows that the larger step was too large."""

FINE, FINEST, SMALL = 1e-10, 1e-6, 1e-9
"""Smallest step: relative to an element's size, or to 1 for smaller elements; to the size of these; and the least size there."""

ABOVE, MOST = 10.0, 1e-5
"""Growth counts if it is so many times larger than the rounding of the function's value, and than this share of its change with
the largest step: it may be the sum of much larger values, whose rounding looks like growth, or like a kink."""

NEAR, ALIKE, STRAIGHT = 1e-4, 1e-10, 1e-6
"""The search ends from the first relative step on, if two slopes differ by less than the second share of the slope, and bend by
less than the third."""


def slopes(f: Callable[[Floats], Floats], at: Floats) -> tuple[Floats, bool]:
    """Return the derivative of a function at a point by central differences, and whether it has a kink or a jump there.

    Large steps suffer from nonlinearity, small ones from rounding. The best size depends on units and function, so several are
    tried for each element. The step counts that differs least from the next larger one, rounding included. Steps that are larger
    than the range in which the function is smooth do not count: there slope or bend grow as the step shrinks. A step at which the
    function cannot be evaluated does not count either; without any other the derivative is NaN. A feature that is narrow beside
    the larger steps, and small beside a straight line that these see, may be missed: also a dead band of less than a hundredth of
    the largest step.
    """
    here = np.asarray(f(at), dtype=np.float64)
    whole, kink = np.full((len(here), len(at)), np.nan), False
    whole[:, ~np.isfinite(at)] = 0.0  # such a number stays as it is
    for j in np.flatnonzero(np.isfinite(at)):
        whole[:, j], kinks = _slope(f, at, int(j), here)
        kink |= bool(kinks.any())
    return whole, kink


def parted(whole: Floats, n: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return A, B, C and D from the derivatives of n states' changes and of the outputs by states and inputs."""
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def equations(block: StateSpace) -> Callable[[Floats], Floats]:
    """Return a nonlinear plant's dynamics and outputs, one after the other, as a function of states and inputs together."""
    system, n, params = block.system, np.asarray(block.initial).size, dict(block.params or {})

    def both(z: Floats) -> Floats:
        moves, seen = (f(0.0, z[:n], z[n:], params) for f in (system.dynamics, system.output))
        return np.concatenate([np.ravel(moves), np.ravel(seen)]).astype(np.float64)

    return both


def _slope(f: Callable[[Floats], Floats], at: Floats, j: int, here: Floats) -> tuple[Floats, Floats]:
    """Return the derivative by one element, and where the function has a kink or a jump."""
    rows = len(here)
    chosen, least, kinks = np.full(rows, np.nan), np.full(rows, np.inf), np.zeros(rows, bool)
    lost, agree, steepest = np.zeros(rows, bool), np.zeros(rows, bool), np.zeros(rows)
    before: tuple[Floats, Floats] | None = None
    for size in _steps(abs(float(at[j]))):
        above, below = (_value(f, at, j, sign * size) for sign in (1.0, -1.0))
        if above is None or below is None:
            continue
        step = ((at[j] + size) - (at[j] - size)) / 2  # the step after rounding beside the element
        slope, bend = (above - below) / (2 * step), np.abs(above - 2 * here + below) / step
        rounding = 4 * np.finfo(np.float64).eps * np.abs(here) / step
        if before is None:
            noise = MOST * np.maximum(np.abs(above - here), np.abs(below - here))
        else:
            none = (slope == 0) & (before[0] != 0) & (bend <= rounding) & ~lost  # a step without an effect
            lost |= none
            # Rounding hides the effect, or the function is flat, unless larger steps agree: then it has steps, as an encoder.
            hidden = np.abs(before[0]) <= np.maximum(noise / step, ABOVE * rounding)
            only = none & hidden & np.isnan(chosen)
            flat = none & ~hidden & ~agree
            chosen[only], chosen[flat], kinks[flat] = before[0][only], 0.0, False
            least[only | flat] = rounding[only | flat]
            agree |= (np.abs(slope - before[0]) <= BENDS * np.abs(slope)) & (slope != 0)
            grown = _grown(slope, bend, before, np.maximum(noise / step, ABOVE * rounding)) & ~lost
            error = np.where(grown, np.inf, np.abs(slope - before[0]) + rounding)
            least[grown] = np.inf  # the steps before do not count, unless there is no smaller one, as beside a jump
            better = ((error < least) | np.isnan(chosen)) & ~lost
            chosen[better], least[better] = slope[better], error[better]
            # For a smooth function a tenth of the step gives a tenth of the bend.
            sharp = (bend > 0.5 * before[1]) & (bend > BENDS * np.abs(slope))
            # The bend of a drag v|v| beside its zero is constant, and next to nothing.
            sharp &= bend > SMOOTH * steepest
            seen = bend > np.maximum(1e3 * rounding, noise / step)
            kinks[seen] = sharp[seen]
            if (
                size <= NEAR * max(abs(float(at[j])), 1.0)
                and ((error <= ALIKE * np.abs(slope) + rounding) & (bend <= STRAIGHT * np.abs(slope) + rounding)).all()
            ):
                break
        before, steepest = (slope, bend), np.maximum(steepest, np.abs(slope))
    return chosen, kinks | (np.isinf(least) & np.isfinite(chosen))


def _grown(slope: Floats, bend: Floats, before: tuple[Floats, Floats], least: Floats) -> Floats:
    """Return where slope or bend are larger than with a step ten times as large, and than the least that counts."""
    pairs = (np.abs(slope), np.abs(before[0])), (bend, before[1])
    return np.asarray(np.any([now > np.maximum(GROWS * larger, least) for now, larger in pairs], axis=0))


def _steps(size: float) -> list[float]:
    """Return the steps to try for an element of a size, from large to small; it may be small because of its unit."""
    largest = max(size, 1.0)
    smallest = min(FINE * largest, FINEST * max(size, SMALL) if size else np.inf)
    return [float(f"1e-{k}") * largest for k in range(1, 2 + round(np.log10(0.1 * largest / smallest)))]


def _value(f: Callable[[Floats], Floats], at: Floats, j: int, step: float) -> Floats | None:
    moved = at.copy()
    moved[j] += step
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            value = np.asarray(f(moved), dtype=np.float64)
    except (ArithmeticError, ValueError):
        return None
    return value if np.isfinite(value).all() else None
