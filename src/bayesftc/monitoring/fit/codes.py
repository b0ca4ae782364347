"""Values that a sensor records in place of a sample, such as 0 out of range: often repeated exactly, and far from the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.base.recordings.turns import SPAN
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.columns import recorded
from bayesftc.monitoring.fit.moments import median
from bayesftc.monitoring.fit.settings import FIT
from bayesftc.monitoring.recording import Recording, Signal

if TYPE_CHECKING:
    from bayesftc.cosim.judging.signals import Flags


class Code(NamedTuple):
    """A value that seems to stand for a missing sample, and the share of the sensor's samples that have it."""

    value: float
    share: float


def codes(recording: Recording) -> dict[str, Code]:
    """Return the sensors with a value that seems to stand for a missing sample.

    It is the most frequent value of a sensor, sent at several separate times, while the other sensors are far from it. A frozen
    sensor repeats a value as well, but begins with its last good sample, near the others: such a stretch does not count, and
    values of a coarse resolution are near the others, too. Where no other sample of the sensor is near it, a rare value is a code
    as well; far outside of them, also one that is sent in one stretch.
    """
    level = median(recording.y, 1)
    span = float(np.subtract(*np.nanquantile(level, [0.95, 0.05])))
    found = {name: _code(recording.y, i, span) for i, name in enumerate(recording.sensors)}
    return {name: code for name, code in found.items() if code is not None}


def codes_of_angles(signals: Mapping[str, Signal]) -> dict[str, Code]:
    """Return the sensors of an angle with such a value outside of the turn of their other samples.

    A recording has them on the turn of the other sensors, each time with another value.
    """
    if not any(signal.period for signal in signals.values()):
        return {}
    sent = recorded({name: replace(signal, period=0.0) for name, signal in signals.items()})
    found = {}
    for name, code in codes(sent).items():
        samples = sent.y[:, sent.sensors.index(name)]
        turn = SPAN * signals[name].period
        if (
            np.ptp(samples[np.isfinite(samples) & (samples != code.value)])
            <= turn
            < np.nanmax(np.abs(samples - code.value))
        ):
            found[name] = code
    return found


def _code(y: Floats, i: int, span: float) -> Code | None:
    """Return the code of a sensor; None if it has none."""
    others = median(np.delete(y, i, axis=1), 1) if y.shape[1] > 1 else np.full(len(y), np.nan)
    both = np.isfinite(y[:, i]) & np.isfinite(others)
    values, apart = y[both, i], (y[:, i] - others)[both]
    if not len(values):
        return None
    every, counts = np.unique(values, return_counts=True)
    gaps = np.concatenate([[np.inf], np.diff(every), [np.inf]])
    nearest = np.minimum(gaps[:-1], gaps[1:])
    frequent = (counts == counts.max()) & (counts >= FIT.code * len(values))
    likely = frequent | ((counts >= FIT.code_few) & (nearest > FIT.code_span * span))
    for k in sorted(np.flatnonzero(likely), key=lambda k: -counts[k]):
        sent = values == every[k]
        if sent.all():
            continue
        bias = float(np.median(apart[~sent]))
        usual = MAD * float(np.median(np.abs(apart[~sent] - bias)))
        least = max(FIT.code_far * usual, FIT.code_span * span)
        counted, times = _begun_far(sent, np.abs(apart - bias) > least)
        if not times:
            continue
        away = float(np.quantile(np.abs(apart[counted] - bias), 0.1))
        own = float(np.subtract(*np.quantile(values[~sent], [0.995, 0.005])))
        common = bool(frequent[k]) and counted.sum() >= FIT.code * len(values)
        often = times >= (FIT.code_times if common else FIT.code_few)
        alone = common or nearest[k] > least
        outside = min(float(nearest[k]), away) > FIT.code_outside * max(span, own) > 0
        if (often and alone and away > least) or outside:
            return Code(float(every[k]), float(counted.mean()))
    return None


def _begun_far(sent: Flags, far: Flags) -> tuple[Flags, int]:
    """Return where a value is sent in stretches whose first sample is far from the other sensors, and their number."""
    begins = sent & ~np.concatenate([[False], sent[:-1]])
    counted = np.concatenate([[False], far[begins]])[np.cumsum(begins)]
    return sent & counted, int(far[begins].sum())


def without_codes(recording: Recording) -> Recording:
    """Return the recording without the samples that seem to stand for no sample."""
    y = recording.y.copy()
    for name, code in codes(recording).items():
        i = recording.sensors.index(name)
        y[y[:, i] == code.value, i] = np.nan
    return replace(recording, y=y)


__all__ = ["Code", "codes", "codes_of_angles", "without_codes"]
