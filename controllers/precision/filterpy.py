"""The SER baseline in its reference form: filterpy's Kalman filter without the ignored sensors (paper, section 5.2.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from filterpy.kalman import KalmanFilter

    from bayesftc.cosim.types import Floats


def reference_filter(A: Floats, B: Floats, Q: Floats, mean: Any, covariance: Floats) -> KalmanFilter:
    """Return filterpy's Kalman filter for a model and an initial belief.

    Parameters
    ----------
    A, B, Q : ndarray, n x n, n x p, n x n
        The model's matrices and its process covariance.
    mean : number or ndarray of n
        Mean of the belief.
    covariance : ndarray, n x n
        Covariance of the belief.
    """
    from filterpy.kalman import KalmanFilter

    n, p = B.shape
    kf = KalmanFilter(dim_x=n, dim_z=1, dim_u=p)  # each update gives H and R of the sensors in use
    kf.F, kf.B, kf.Q = A, B, Q
    kf.x = np.broadcast_to(np.asarray(mean, float), n).reshape(n, 1).copy()
    kf.P = np.array(covariance)
    return kf


def update_by_ser(
    kf: KalmanFilter, sample: Floats, C: Floats, noise: Floats, threshold: float
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Update the belief with the sensors whose innovation is below the threshold; return the ignored present ones.

    Parameters
    ----------
    kf : KalmanFilter
        The filter, with the predicted belief.
    sample : ndarray of m
        Samples; one that is not finite is missing.
    C, noise : ndarray, m x n and m x m
        What the sensors measure, and their covariance; a sensor with an infinite variance is left out.
    threshold : float
        Threshold in standard deviations of the innovation.
    """
    deviation = np.abs(sample - (C @ kf.x)[:, 0])
    present = np.isfinite(sample) & np.isfinite(np.diag(noise))
    with np.errstate(invalid="ignore"):
        ignored: np.ndarray[Any, np.dtype[np.bool_]] = present & (
            deviation > threshold * np.sqrt(np.diag(C @ kf.P @ C.T) + np.diag(noise))
        )
    keep = np.flatnonzero(present & ~ignored)
    R = noise[np.ix_(keep, keep)]
    # filterpy inverts the covariance of all samples of an update, and loses half of its digits where these have other units, as
    # metres and pascals, or much less noise than the belief is wide. Sensors with independent errors may be used in turns.
    alone = not np.any(R - np.diag(np.diag(R)))
    for chosen in [[i] for i in range(len(keep))] if alone else [list(range(len(keep)))]:
        kf.update(sample[keep[chosen]].reshape(-1, 1), R=R[np.ix_(chosen, chosen)], H=C[keep[chosen]])
    return ignored
