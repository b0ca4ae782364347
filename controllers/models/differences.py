"""The derivative of a plant's equations at an operating point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesftc.controllers.models.pulse_responses import PoorFitWarning
from bayesftc.cosim.base.warnings_shown import warn_user
from bayesftc.cosim.control.differences import slopes
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats


def derivative(f: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Return the derivative of a function at a point; see `bayesftc.cosim.control.differences.slopes`.

    Raises
    ------
    ModelError
        If the function cannot be evaluated near the point.

    Warns
    -----
    PoorFitWarning
        If the slopes on both sides differ: the function has a kink.
    """
    whole, kink = slopes(f, at)
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
