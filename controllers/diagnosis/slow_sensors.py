"""Observers of sensors with samples at different rates: which gain and which covariance they have at which step.

The steady filter of a set expects a sample of every sensor in each step. If a sensor is slow, its innovation has the process
noise of several steps, and with the steady gain it is not white: the plant would seem to move more than its model. The filter of
a pattern of samples has its own gain at each phase of the pattern.
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

LONGEST_AGE = 2
"""Ages of a sensor's last sample count up to this multiple of its usual distance between samples; all older ones are one."""

LEAST_STEPS, MOST_STEPS = 600, 2_000
"""Steps within which the filters settle on a pattern of samples, and steps in which rare phases are looked for."""


@dataclass(frozen=True, eq=False)
class PatternFilter:
    """The filters of K sets of sensors at each of U phases: gains (K x U x n x m) and whitening (K x U x m x m)."""

    gain: Floats
    whiten: Floats


@dataclass(frozen=True, eq=False)
class Pattern:
    """The pattern of a recording's samples: steps of one phase have the same sensors present, and last samples of the same ages.

    Attributes
    ----------
    phase : ndarray of int, shape (T,)
        Number of each step's phase.
    present : ndarray of bool, shape (T, m)
        Which sensors have a sample.
    filters : dict of Observers to PatternFilter
        The filters that have been computed.
    """

    phase: NDArray[np.intp]
    present: NDArray[np.bool_]
    filters: dict[Observers, PatternFilter] = field(default_factory=dict, repr=False)

    def of(self, banks: Sequence[Observers]) -> list[PatternFilter]:
        """Return the filters of several models' observers with the same sets."""
        if new := [bank for bank in banks if bank not in self.filters]:
            self.filters.update(zip(new, _settled(new, self), strict=True))
        return [self.filters[bank] for bank in banks]


def pattern_of(y: Floats, sensors: Sequence[int]) -> Pattern | None:
    """Return the pattern of samples (T x m); None if none of these sensors is slow: most have a sample in each step."""
    present = np.isfinite(y)
    distances = [np.diff(np.flatnonzero(present[:, i])) for i in sensors]
    usual = [int(np.median(d)) if len(d) else 1 for d in distances]
    if max(usual, default=1) == 1:
        return None
    steps, parts = np.arange(len(y)), [present[:, list(sensors)]]
    for i, distance in zip(sensors, usual, strict=True):
        last = np.maximum.accumulate(np.where(present[:, i], steps, -len(y)))
        before = np.concatenate([[-len(y)], last[:-1]])
        parts.append(np.minimum(steps - before, LONGEST_AGE * distance)[:, np.newaxis])
    phase = np.unique(np.hstack([part.astype(np.intp) for part in parts]), axis=0, return_inverse=True)[1]
    return Pattern(np.ravel(phase), present)


def _settled(banks: Sequence[Observers], pattern: Pattern) -> list[PatternFilter]:
    """Return the filters of several models' observers, as they are once they have settled on a pattern of samples."""
    each = len(banks[0])
    gains, whitening = (np.concatenate([getattr(bank, name) for bank in banks]) for name in ("gain", "whiten"))
    phases = int(pattern.phase.max()) + 1
    gain, whiten = (np.repeat(steady[:, np.newaxis], phases, axis=1) for steady in (gains, whitening))
    A, C, R = (
        np.repeat([np.asarray(of(bank)) for bank in banks], each, axis=0)
        for of in (
            lambda bank: bank.transition,
            lambda bank: bank.model.matrix("C"),
            lambda bank: bank.model.matrix("sensor_covariance"),
        )
    )
    forward = np.repeat([bank.model.matrix("A") for bank in banks], each, axis=0)
    Q, P = (np.concatenate([getattr(bank, name) for bank in banks]) for name in ("noise", "covariance"))
    chosen = np.zeros((len(P), C.shape[1]))
    for row, sensors in zip(chosen, [sensors for bank in banks for sensors in bank.sensors], strict=True):
        row[list(sensors)] = 1.0
    unseen = set(range(phases))
    for k in range(min(len(pattern.present), MOST_STEPS)):
        if k >= LEAST_STEPS and not unseen:
            break
        there = chosen * pattern.present[k]
        seen = there[:, :, np.newaxis] * C
        noise = R * there[:, :, np.newaxis] * there[:, np.newaxis]
        noise[:, range(len(there.T)), range(len(there.T))] += 1.0 - there
        try:
            root = np.linalg.cholesky(seen @ P @ seen.swapaxes(1, 2) + noise)
        except (
            np.linalg.LinAlgError
        ):  # of a model so far off that the covariance is lost in rounding: as with all samples
            break
        inverse = np.linalg.inv(root)
        scaled = inverse @ (seen @ P)
        phase = pattern.phase[k]
        whiten[:, phase] = inverse * there[:, :, np.newaxis] * there[:, np.newaxis]
        gain[:, phase] = forward @ scaled.swapaxes(1, 2) @ inverse
        P = A @ (P - scaled.swapaxes(1, 2) @ scaled) @ A.swapaxes(1, 2) + Q
        P = (P + P.swapaxes(1, 2)) / 2.0
        unseen.discard(phase)
    return [
        PatternFilter(gain[first : first + each], whiten[first : first + each]) for first in range(0, len(gain), each)
    ]
