"""A belief that starts where the first samples exclude it: it looks like a wrong model until it has settled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import behind
from bayesftc.cosim.diagram.wiring import UNLIKELY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesftc.controllers.models.linear import LinearModel
    from bayesftc.cosim.types import Floats


def wrong_start(
    model: LinearModel, controller: Any, samples: Floats, units: Sequence[str | None] = ()
) -> tuple[str, tuple[float, ...]] | None:
    """Return a sentence about a wrong start of a quantity, and belief, first sample and sensor; None if all starts are likely.

    Parameters
    ----------
    model : LinearModel
        The controller's model.
    controller : controller or StateEstimator
        With its belief before the first sample.
    samples : ndarray, steps x m
        The samples.
    units : sequence of str
        The unit of each sensor, if known.
    """
    if getattr(controller, "initial_covariance", None) is None:  # active inference begins with a point
        return None
    C, R = model.matrix("C"), model.matrix("sensor_covariance")
    belief = C @ np.broadcast_to(np.asarray(controller.initial_mean, float), model.states)
    std = np.sqrt(np.diag(C @ np.asarray(controller.initial_covariance, float) @ C.T + R))
    first = samples[np.isfinite(samples).any(axis=1)][:1]
    off = np.abs(first[0] - belief) / std if len(first) else np.zeros(0)
    for group in model.alike:
        there = [i for i in group if i < len(off) and np.isfinite(off[i])]
        if len(there) > 1 and min(off[there]) > UNLIKELY:
            i = there[0]
            name = model.names.sensors[i] if model.names else f"the quantity of sensor {i}"
            unit = behind(units[i]) if units else ""
            return (
                f"The belief starts at {name} = {belief[i]:.4g}{unit}, give or take {std[i]:.2g}{unit}, but its first samples "
                f"are about {first[0][i]:.4g}{unit}. From another start the model may explain the run. States that no sensor "
                "measures then start wrong, too, and take long to settle. Design for the plant where it starts (cosim.StateSpace("
                "system, initial=...)), or give the controller initial_mean=..., or a larger initial_covariance=... (design: "
                "initial_spread=...).",
                (float(belief[i]), float(first[0][i]), float(i)),
            )
    return None


__all__ = ["wrong_start"]
