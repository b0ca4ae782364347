"""Derivatives of a function by differences of its values."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from bayesftc.controllers.models.pulse_responses import BENDS, PoorFitWarning
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

STEPS = np.array([float(f"1e-{k}") for k in range(1, 11)])
"""Steps to try, as shares of an element's size."""

SMOOTH = 1e-6
"""Largest bend of a smooth function, relative to its slope over one of the larger steps."""


def derivative(f: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Return the derivative of a function at a point by central differences, with a suitable step for each element.

    Large steps suffer from nonlinearity, small ones from rounding. The best size depends on units and function, so several are
    tried. The step counts that differs least from the next larger one, rounding included. A step at which the function cannot be
    evaluated does not count.

    Raises
    ------
    ModelError
        If the function cannot be evaluated near the point.

    Warns
    -----
    PoorFitWarning
        If the slopes on both sides differ: the function has a kink.
    """
    here = np.asarray(f(at), dtype=np.float64)
    whole, kink = np.full((len(here), len(at)), np.nan), False
    for j in range(len(at)):
        least, lost, kinks = np.full(len(here), np.inf), np.zeros(len(here), bool), np.zeros(len(here), bool)
        before: tuple[Floats, Floats] | None = None
        steepest = np.zeros(len(here))
        for share in STEPS:
            step = share * max(abs(float(at[j])), 1.0)
            above, below = (_value(f, at, j, sign * step) for sign in (1.0, -1.0))
            if above is None or below is None:
                continue
            step = ((at[j] + step) - (at[j] - step)) / 2  # the step after rounding beside the element
            slope, bend = (above - below) / (2 * step), np.abs(above - 2 * here + below) / step
            if before is not None:
                rounding = 4 * np.finfo(np.float64).eps * np.abs(here) / step
                lost |= (slope == 0) & (before[0] != 0) & (bend <= rounding)  # the step is too small to have an effect
                error = np.abs(slope - before[0]) + rounding
                better = (error < least) & ~lost
                whole[better, j], least[better] = slope[better], error[better]
                # For a smooth function a tenth of the step gives a tenth of the bend.
                sharp = (bend > 0.5 * before[1]) & (bend > BENDS * np.abs(slope)) & (bend > 1e3 * rounding)
                # The bend of a drag v|v| beside its zero is constant, and next to nothing.
                sharp &= bend > SMOOTH * steepest
                kinks[better] = sharp[better]
            before, steepest = (slope, bend), np.maximum(steepest, np.abs(slope))
        kink |= bool(kinks.any())
    if not np.isfinite(whole).all():
        raise ModelError(
            f"The equations cannot be evaluated near the operating point, or jump there. Of state and inputs together it is "
            f"{[float(f'{each:.4g}') for each in at]}; give another one (at=...)."
        )
    if kink:
        warn_user(
            "The equations have a kink at the operating point, where no linear model fits both sides; give another point "
            "(at=...).",
            PoorFitWarning,
        )
    return whole


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
