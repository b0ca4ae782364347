"""Derivatives of a function of which nothing is known but its values."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from bayesftc.controllers.models.pulse_responses import BENDS, PoorFitWarning
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats

STEPS = 10.0 ** -np.arange(1, 11)
"""Steps that are tried, as shares of an element's size."""


def derivative(f: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Return the derivative of a function at a point by central differences, with a step for each of its elements that suits it.

    The larger a step, the more the function bends; the smaller, the more is lost to rounding. Neither the units of the elements
    nor the function's own tell how large that is, so several are tried, and that counts which differs least from the next larger
    one, what rounding may do included. Where the function cannot be had, a step does not count.

    Raises
    ------
    ModelError
        If it is nowhere to be had beside the point.

    Warns
    -----
    PoorFitWarning
        If the function goes on otherwise on one side than on the other: there is a kink.
    """
    here = np.asarray(f(at), dtype=np.float64)
    whole, kink = np.full((len(here), len(at)), np.nan), False
    for j in range(len(at)):
        least, lost, kinks = np.full(len(here), np.inf), np.zeros(len(here), bool), np.zeros(len(here), bool)
        before: tuple[Floats, Floats] | None = None
        for share in STEPS:
            step = share * max(abs(float(at[j])), 1.0)
            above, below = (_value(f, at, j, sign * step) for sign in (1.0, -1.0))
            if above is None or below is None:
                continue
            step = ((at[j] + step) - (at[j] - step)) / 2  # what is left of it beside the element
            found, bend = (above - below) / (2 * step), np.abs(above - 2 * here + below) / step
            if before is not None:
                rounding = 4 * np.finfo(np.float64).eps * np.abs(here) / step
                lost |= (found == 0) & (before[0] != 0) & (bend <= rounding)  # too small a step to be seen at all
                error = np.abs(found - before[0]) + rounding
                better = (error < least) & ~lost
                whole[better, j], least[better] = found[better], error[better]
                # A smooth function bends by a tenth, if the step is a tenth.
                sharp = (bend > 0.5 * before[1]) & (bend > BENDS * np.abs(found)) & (bend > 1e3 * rounding)
                kinks[better] = sharp[better]
            before = found, bend
        kink |= bool(kinks.any())
    if not np.isfinite(whole).all():
        raise ModelError(
            "The equations cannot be evaluated beside the operating point, or jump there; give another one (at=...)."
        )
    if kink:
        warnings.warn(
            "The equations have a kink at the operating point, where a linear model is right on neither side; give a point "
            "beside it (at=...).",
            PoorFitWarning,
            stacklevel=6,
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
