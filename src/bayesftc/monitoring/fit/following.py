"""Whether each sensor follows the others: a column of another quantity, or of noise, does not move with them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.types import Floats
from bayesftc.monitoring.fit.moments import mean, median
from bayesftc.monitoring.fit.noise import awake
from bayesftc.monitoring.fit.settings import FIT


class _Slope(NamedTuple):
    """How far a sensor moves while others move by 1, as the median over windows, and its standard error."""

    value: float
    error: float

    @property
    def follows(self) -> bool:
        """Whether the sensor certainly moves with the others, if only by a part: it may be slow."""
        return self.value > max(FIT.lags, FIT.sure * self.error)

    @property
    def strange(self) -> bool:
        """Whether it certainly does not."""
        return self.value + FIT.sure * self.error < FIT.follows


def strangers(y: Floats, stretch: slice = slice(None)) -> dict[int, float]:
    """Return the sensors that do not follow the others, and how far each moves while the others move by 1.

    The motion is what two sensors have in common that agree best, in windows of several lengths: a slow sensor follows over long
    times only. Drifts, biases and noise make the slopes of the windows scatter about 1, and a fault in fewer than half of the
    windows does not change their median. A sensor is named only if its slope is certainly small over some time, over none
    certainly large, and if most sensors follow. Of two sensors both are named, as nobody knows which one is wrong. A sensor that
    moves exactly as the others, but by another factor, as one in another unit does, is named as well. So is one that lies at
    another place than the others, such as a control beside frequencies of 50 Hz, unless it certainly follows; its slope is NaN.

    Parameters
    ----------
    y : ndarray, steps x sensors
        Samples.
    stretch : slice
        Steps in which the sensors are healthy: one that follows there has failed later, and is not named.
    """
    y = awake(y)
    if scaled := _scaled(y):
        return scaled
    parts = [windows for samples in {len(of): of for of in (y, y[stretch])}.values() for windows in _windows(samples)]
    strange, following = _strange([(_of_two if y.shape[1] == 2 else _of_several)(x) for x in parts], y.shape[1])
    if not strange and y.shape[1] > 2:
        # The best pair may be of another quantity than most, or noise hides the motion of each.
        strange, following = _strange([_of_most(x) for x in parts], y.shape[1])
    return strange | {i: float("nan") for i in _elsewhere(y) if i not in {*strange, *following}}


def _strange(
    of_windows: list[tuple[tuple[int, ...], dict[int, _Slope]]], sensors: int
) -> tuple[dict[int, float], set[int]]:
    """Return the slopes of the sensors that do not follow, none if most do not, and the sensors that do."""
    slopes: dict[int, list[_Slope]] = {}
    leaders: set[int] = set()
    for leading, found in of_windows:
        leaders |= set(leading)
        for i, slope in found.items():
            slopes.setdefault(i, []).append(slope)
    following = leaders | {i for i, found in slopes.items() if any(slope.follows for slope in found)}
    strange = {
        i: float(np.median([slope.value for slope in found]))
        for i, found in slopes.items()
        if i not in following and any(slope.strange for slope in found)
    }
    return (strange if len(strange) < len(following) or sensors == 2 else {}), following


def _elsewhere(y: Floats) -> list[int]:
    """Return the sensors whose place is far from that of most others; of two such sensors both."""
    middle = median(y, 0)
    spread = MAD * median(np.abs(y - middle), 0)
    distance = np.abs(middle - middle[:, None])
    size = np.maximum(np.abs(middle), np.abs(middle[:, None]))
    near = (distance <= FIT.elsewhere * np.hypot(spread, spread[:, None])) | (distance <= FIT.unlike * size)
    if len(middle) == 2:
        return [] if near.all() else [0, 1]
    group = near[int(near.sum(axis=1).argmax())]
    return np.flatnonzero(~group).tolist() if 2 * group.sum() > len(middle) else []


def _scaled(y: Floats) -> dict[int, float]:
    """Return the sensors that move with all others of a majority, but by another factor, the same in windows of every length.

    A slow sensor also moves less, but later than the others, so that its correlation with them is smaller, and by a factor that
    depends on the length of a window.
    """
    factors = [of for x in _windows(y) if (of := _factors(x)) is not None]
    if not factors:
        return {}
    typical = median(np.log(factors), 0)
    spread = np.nan_to_num(np.abs(np.log(factors) - typical)).max(axis=0)  # NaN where windows do not show a factor
    same = (spread < np.log(FIT.one_factor)) & np.isfinite(typical)
    together = same & (np.abs(typical) < np.log(FIT.another_factor))
    group = np.flatnonzero(together[int(together.sum(axis=1).argmax())])
    if not same[:, group].all() or (len(y.T) > 2 and 2 * len(group) <= len(y.T)):
        return {}
    found = {i: float(np.exp(np.median(typical[i, group]))) for i in range(len(y.T)) if i not in group}
    return {0: found[1], 1: found[1]} if len(y.T) == 2 and found else found


def _factors(x: Floats) -> Floats | None:
    """Return how far each sensor moves while another moves by 1 (sensors x sensors), from the windows that show it.

    None of too few such windows of all pairs; NaN for a pair that does not move together in most of its windows. Of three sensors
    or more, windows in which no two move together tell nothing: the quantity rests.
    """
    sensors = x.shape[2]
    pairs = list(combinations(range(sensors), 2))
    together = [_together(x[:, :, [i, j]]) for i, j in pairs]
    alike = np.array([_correlation(both[:, :, 0], both[:, :, 1]) for both in together])
    moves = alike > FIT.one_motion
    if moves.sum(axis=1).max() < FIT.fewest_windows:
        return None
    moving = moves.any(axis=0) if sensors > 2 else True
    factors = np.eye(sensors)
    for (i, j), both, its, seen in zip(pairs, together, moves, np.isfinite(alike) & moving, strict=True):
        one, other = (_covariance(both[:, :, k], both[:, :, k])[its] for k in (0, 1))
        enough = its.sum() >= max(FIT.fewest_windows, FIT.mostly * seen.sum())
        factors[i, j] = float(np.sqrt(np.median(one / other))) if enough else np.nan
        factors[j, i] = 1.0 / factors[i, j]
    return factors


def _windows(y: Floats) -> Iterator[Floats]:
    """Give the samples in windows of several lengths (windows x steps x sensors)."""
    for parts in FIT.follow_parts:
        if (length := len(y) // parts) >= FIT.least_block:
            yield y[: parts * length].reshape(parts, length, y.shape[1])


def _of_several(x: Floats) -> tuple[tuple[int, ...], dict[int, _Slope]]:
    """Return the two sensors that agree best, and the slopes of the others against what these two have in common."""
    pairs = list(combinations(range(x.shape[2]), 2))
    alike = [_correlation(x[:, :, i], x[:, :, j]) for i, j in pairs]
    typical = [float(np.nanmedian(of)) if np.isfinite(of).any() else -1.0 for of in alike]
    best = int(np.argmax(typical))
    pair, moves = pairs[best], alike[best] > FIT.leads
    found = {}
    for i in range(x.shape[2]):
        if i in pair or moves.sum() < FIT.fewest_windows:
            continue
        sensor, first, second = _together(x[moves][:, :, [i, *pair]]).transpose(2, 0, 1)
        motion = _covariance(first, second)
        own = (_covariance(sensor, first) + _covariance(sensor, second)) / 2
        moving = motion > 0.5 * FIT.leads * np.sqrt(_covariance(first, first) * _covariance(second, second))
        if (slope := _slope(own[moving] / motion[moving])) is not None:
            found[i] = slope
    return (pair if moves.sum() >= FIT.fewest_windows else ()), found


def _of_most(x: Floats) -> tuple[tuple[int, ...], dict[int, _Slope]]:
    """Return most sensors, if each of them certainly moves with each other one, and the slopes of the others against them."""
    sensors = x.shape[2]
    together, motion = np.eye(sensors, dtype=bool), np.zeros((sensors, sensors, len(x)))
    for i, j in combinations(range(sensors), 2):
        alike = _slope(_correlation(x[:, :, i], x[:, :, j]))
        together[i, j] = together[j, i] = alike is not None and alike.value - FIT.sure * alike.error > FIT.lags
        motion[i, j] = motion[j, i] = _covariance(x[:, :, i], x[:, :, j])
    group = np.flatnonzero(together[int(together.sum(axis=1).argmax())])
    if 2 * len(group) <= sensors or not together[np.ix_(group, group)].all():
        return (), {}
    of_group = median(np.array([motion[i, j] for i, j in combinations(group, 2)]), 0)
    moves = of_group > 0.5 * median(of_group, 0)
    slopes = {i: _slope((median(motion[group, i], 0) / of_group)[moves]) for i in range(sensors) if i not in group}
    return tuple(group.tolist()), {i: slope for i, slope in slopes.items() if slope is not None}


def _of_two(x: Floats) -> tuple[tuple[int, ...], dict[int, _Slope]]:
    """Return the slope of two sensors against the one that moves farther, if one of them moves in most windows."""
    noise = np.array([(MAD * np.nanmedian(np.abs(np.diff(column)))) ** 2 / 2 for column in x.reshape(-1, 2).T])
    both = _together(x)
    motion = np.stack([_covariance(both[:, :, i], both[:, :, i]) - noise[i] for i in (0, 1)])
    far = int(np.argmax(np.nan_to_num(median(motion, 1))))
    moves = motion[far] > FIT.outstanding**2 * noise[far]
    if moves.mean() < FIT.mostly:
        return (), {}
    slope = _slope(_covariance(both[:, :, 0], both[:, :, 1])[moves] / motion[far, moves])
    return (), {} if slope is None else {0: slope, 1: slope}


def _together(x: Floats) -> Floats:
    """Return the samples of the steps at which all sensors have one."""
    return np.where(np.isfinite(x).all(axis=2, keepdims=True), x, np.nan)


def _slope(of_windows: Floats) -> _Slope | None:
    """Return the median over the windows, and its standard error; None of too few windows."""
    of_windows = of_windows[np.isfinite(of_windows)]
    if len(of_windows) < FIT.fewest_windows:
        return None
    value = float(np.median(of_windows))
    error = np.sqrt(np.pi / 2 / len(of_windows)) * MAD * float(np.median(np.abs(of_windows - value)))
    return _Slope(value, float(error))


def _covariance(a: Floats, b: Floats) -> Floats:
    """Return the covariance of two sensors in each window; NaN with too few samples at the same steps."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, np.nan), np.where(both, b, np.nan)
    enough = both.sum(axis=1) >= FIT.least_block
    return np.asarray(np.where(enough, mean((a - mean(a)[:, None]) * (b - mean(b)[:, None])), np.nan))


def _correlation(a: Floats, b: Floats) -> Floats:
    """Return the correlation of two sensors in each window, 0 where one of them does not change."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, np.nan), np.where(both, b, np.nan)
    size = np.sqrt(_covariance(a, a) * _covariance(b, b))
    return np.asarray(np.where(size > 0, _covariance(a, b) / np.where(size > 0, size, 1.0), 0.0 * size))


__all__ = ["strangers"]
