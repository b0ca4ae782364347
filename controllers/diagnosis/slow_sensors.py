"""Observers of sensors with samples at different rates: which gain and which covariance they have at which step.

The steady filter of a set expects a sample of every sensor in each step. If a sensor is slow, its innovation has the process
noise of several steps, and with the steady gain it is not white: the plant would seem to move more than its model. The filters
here are the Kalman filters of the samples that are there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bayesftc.controllers.estimation.observers import Observers
    from bayesftc.cosim.types import Floats

SAME = 1e-9
"""Covariances that differ by less, relative to their variances, are the same: of a regular pattern few are different."""


@dataclass(frozen=True, eq=False)
class SampleFilter:
    """The filters of K sets of sensors: their different gains (K x U x n x m) and whitening (K x U x m x m).

    ``index`` (T) has the number of those at each step.
    """

    gain: Floats
    whiten: Floats
    index: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Presence:
    """Which samples of a recording are there (T x m), and the filters of the latest models for them."""

    present: NDArray[np.bool_]
    alone: dict[Observers, SampleFilter] = field(default_factory=dict, repr=False)
    together: dict[Observers, SampleFilter] = field(default_factory=dict, repr=False)

    def filters(self, banks: Sequence[Observers]) -> list[SampleFilter]:
        """Return the filters of several models' observers with the same sets; those of one are kept, of many the latest."""
        kept = self.alone if len(banks) == 1 else self.together
        if len(banks) > 1 or banks[0] not in self.alone:
            if len(banks) > 1:
                self.together.clear()
            kept.update(zip(banks, _filters(banks, self.present), strict=True))
        return [kept[bank] for bank in banks]

    def of(self, bank: Observers) -> SampleFilter:
        """Return the filters of one model's observers."""
        return self.together[bank] if bank in self.together else self.filters([bank])[0]


def presence_of(y: Floats, sensors: Sequence[int]) -> Presence | None:
    """Return which samples (T x m) are there if one of these sensors is slow; None if they have samples in most steps."""
    present = np.isfinite(y)
    distances = [np.diff(np.flatnonzero(present[:, i])) for i in sensors]
    return Presence(present) if any(len(d) and np.median(d) > 1 for d in distances) else None


def _filters(banks: Sequence[Observers], present: NDArray[np.bool_]) -> list[SampleFilter]:
    """Return the filters of several models' observers along a recording."""
    each = len(banks[0])

    def of_all(matrices: Sequence[Floats]) -> Floats:
        return np.repeat(matrices, each, axis=0)

    A, forward = of_all([bank.transition for bank in banks]), of_all([bank.model.matrix("A") for bank in banks])
    C, R = (of_all([bank.model.matrix(name) for bank in banks]) for name in ("C", "sensor_covariance"))
    Q, P = (np.concatenate([getattr(bank, name) for bank in banks]) for name in ("noise", "covariance"))
    chosen = np.zeros((len(P), C.shape[1]))
    for row, sensors in zip(chosen, [sensors for bank in banks for sensors in bank.sensors], strict=True):
        row[list(sensors)] = 1.0
    gains: list[Floats] = []
    whitening: list[Floats] = []
    index = np.empty(len(present), dtype=np.intp)
    covariances, after = (
        [P],
        dict[tuple[int, bytes], tuple[int, int]](),
    )  # node and samples: number of the gain, next node
    node, ages, at_ages = 0, np.zeros(present.shape[1], dtype=np.intp), dict[bytes, int]()
    for k, there in enumerate(present):
        ages = np.where(there, 0, ages + 1)
        if (key := (node, there.tobytes())) not in after:
            gain, white, P = _step(A, forward, C, Q, R, covariances[node], chosen * there)
            gains.append(gain)
            whitening.append(white)
            following = at_ages.get(ages.tobytes())
            if following is None or not _same(P, covariances[following]):
                following = at_ages[ages.tobytes()] = len(covariances)
                covariances.append(P)
            after[key] = len(gains) - 1, following
        index[k], node = after[key]
    gain, whiten = np.stack(gains, axis=1), np.stack(whitening, axis=1)
    return [SampleFilter(gain[i : i + each], whiten[i : i + each], index) for i in range(0, len(gain), each)]


def _step(
    A: Floats, forward: Floats, C: Floats, Q: Floats, R: Floats, P: Floats, there: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return gains, whitening and next covariances of N filters, of which `there` (N x m) has the sensors with a sample.

    A filter whose covariance is lost in rounding has NaN from then on.
    """
    seen = there[:, :, np.newaxis] * C
    noise = R * there[:, :, np.newaxis] * there[:, np.newaxis]
    places = np.arange(there.shape[1])
    noise[:, places, places] += 1.0 - there
    root = _roots(seen @ P @ seen.swapaxes(1, 2) + noise)
    inverse = np.linalg.inv(root)
    scaled = inverse @ (seen @ P)
    whiten = inverse * there[:, :, np.newaxis] * there[:, np.newaxis]
    gain = scaled.swapaxes(1, 2) @ inverse
    # Joseph's form: a difference of covariances loses its sign for states of very different sizes.
    move, spread = A @ (np.eye(P.shape[1]) - gain @ seen), A @ gain
    P = move @ P @ move.swapaxes(1, 2) + spread @ noise @ spread.swapaxes(1, 2) + Q
    return forward @ gain, whiten, (P + P.swapaxes(1, 2)) / 2.0


def _roots(S: Floats) -> Floats:
    """Return the Cholesky factors of N matrices; NaN of those without one."""
    try:
        return np.asarray(np.linalg.cholesky(S), dtype=np.float64)
    except np.linalg.LinAlgError:
        roots: Floats = np.full(S.shape, np.nan)
        for i, each in enumerate(S):
            try:
                roots[i] = np.linalg.cholesky(each)
            except np.linalg.LinAlgError:
                continue
        return roots


def _same(P: Floats, other: Floats) -> bool:
    size = np.sqrt(np.abs(np.diagonal(P, axis1=1, axis2=2))) + 1e-300
    apart = np.abs(P - other) / (size[:, :, np.newaxis] * size[:, np.newaxis])
    return bool((np.nan_to_num(apart) <= SAME).all())
