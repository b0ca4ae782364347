"""Sensors whose lasting errors stand out in a fitted model, perhaps because a fault lies in the stretch of the fit."""

from __future__ import annotations

import numpy as np

from bayesftc.monitoring.fit.fit import FittedModel
from bayesftc.monitoring.fit.settings import FIT


def lasting_errors(fitted: FittedModel) -> dict[str, float]:
    """Return the standard deviation of each sensor's lasting errors; 0 if it has none."""
    return {
        name: float(sum(float(np.max(e.std)) ** 2 for e in fitted.errors if e.sensors and name in e.sensors)) ** 0.5
        for name in fitted.sensors
    }


def doubtful_sensors(fitted: FittedModel) -> dict[str, float]:
    """Return the sensors whose lasting errors are far above their noise and above those of the others, and both's ratio.

    A fault that lasts for much of the stretch looks like such an error. The model then expects it, so the alarm ends although
    the fault stays. Two sensors share their difference, so none of them stands out.

    Parameters
    ----------
    fitted : FittedModel
        The fitted model.

    Returns
    -------
    dict of str to float
        Lasting errors as a multiple of the noise, by name.
    """
    errors = lasting_errors(fitted)
    return {
        name: error / fitted.sensors[name].std
        for name, error in errors.items()
        if error > FIT.doubtful * fitted.sensors[name].std
        and error > FIT.outstanding * float(np.median([errors[other] for other in errors if other != name]))
    }


__all__ = ["doubtful_sensors", "lasting_errors"]
