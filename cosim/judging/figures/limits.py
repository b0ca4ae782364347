"""Limits of axes that a transient at the start or an extreme sample does not stretch, with marks where a line leaves them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.numbers import MAD
from bayesftc.cosim.judging.figures.panels import drawable
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARE = 0.05
"""Share of the run, its start, in which a line may leave the axis. Later transients are what a user looks at."""
STRETCHED = 3.0
"""An axis is cut if its whole range is so many times the range without the start."""
MARGIN = 0.08
"""Space above and below the lines, as a share of their range."""
WIDE_MARGIN = 0.3
"""The same for lines with samples about them."""
REACH = 3.0
"""Samples count for an axis up to this distance from its lines, in ranges of the lines, or of their noise if that is larger."""
SCATTER = 6.0
"""Range of the noise, in standard deviations."""


def limit_axis(
    axis: Axes,
    time: Floats,
    whole: Sequence[Floats],
    cut: Sequence[Floats],
    what: str = "",
    until: int | None = None,
) -> None:
    """Limit an axis to what a run needs after its start, if a transient there would squeeze the rest; mark what is cut off.

    Parameters
    ----------
    axis : Axes
        The axis, with its lines.
    time : ndarray
        Time in seconds.
    whole : sequence of ndarray
        Lines that are always shown wholly, such as the true value.
    cut : sequence of ndarray
        Lines whose start may be outside, such as the belief.
    what : str
        Name of these lines in the marks; empty if it is clear.
    until : int, optional
        The first row of a loop that is lost, which the axis need not show; then all lines may be outside.
    """
    later = int(np.ceil(SHARE * len(time))) if until is None else 0
    kept = [*(values[:until] for values in whole), *(values[later:until] for values in cut)]
    needed, every = _ends(kept), _ends([*whole, *cut])
    if needed is None or every is None:
        return
    (low, high), (lowest, highest) = needed, every
    if not low < high or highest - lowest < STRETCHED * (high - low):
        return
    space = MARGIN * (high - low)
    low, high = low - space, high + space
    axis.set_ylim(low, high)
    mark_cut(axis, time, cut if until is None else [*whole, *cut], (low, high), what if until is None else "")


def mark_cut(axis: Axes, time: Floats, cut: Sequence[Floats], limits: tuple[float, float], what: str = "") -> None:
    """Mark on an axis with these limits where lines leave it, and say how far they go.

    Parameters
    ----------
    axis : Axes
        The axis.
    time : ndarray
        Time in seconds.
    cut : sequence of ndarray
        The lines.
    limits : tuple of float
        Lower and upper end of the axis.
    what : str
        Name of the lines in the marks.
    """
    low, high = limits
    for ahead, end, height, marker in ((1.0, high, 1.0, "^"), (-1.0, -low, 0.0, "v")):
        outside = np.any([ahead * values > end for values in cut], axis=0)
        if not np.any(outside):
            continue
        furthest = ahead * max(float(np.nanmax(ahead * values)) for values in cut if np.any(ahead * values > end))
        begins = time[outside & ~np.concatenate([[False], outside[:-1]])]
        style: dict[str, Any] = {"transform": axis.get_xaxis_transform(), "clip_on": False, "color": "0.3", "zorder": 6}
        axis.plot(begins, np.full(len(begins), height), ls="none", marker=marker, ms=4, **style)
        side = "bottom" if height == 0.0 else "top"
        axis.annotate(
            f"{what} cut off: {'down' if height == 0.0 else 'up'} to {furthest:.3g}".lstrip(),
            (begins[0], height),
            xycoords=axis.get_xaxis_transform(),
            xytext=(6, 3 if side == "bottom" else -3),
            textcoords="offset points",
            fontsize=7,
            color="0.3",
            va=side,
        )


def limits_with_samples(lines: Sequence[Floats], samples: Sequence[Floats]) -> tuple[float, float]:
    """Return the limits of an axis that contains lines, and the samples except those that would squeeze the lines.

    Parameters
    ----------
    lines : sequence of ndarray
        Such as the true value, the belief and the reference.
    samples : sequence of ndarray
        Of each sensor over time; one that is not finite is missing.
    """
    low, high = _ends(lines) or _middle(samples)
    size = max(high - low, SCATTER * min(map(_noise, samples), default=0.0)) or 0.3 * abs(high) or 1.0
    inside = [values[np.abs(values - 0.5 * (low + high)) <= 0.5 * (high - low) + REACH * size] for values in samples]
    lowest, highest = _ends([*lines, *inside]) or (low, high)
    margin, space = WIDE_MARGIN * size, MARGIN * (highest - lowest)
    return min(low - margin, lowest - space), max(high + margin, highest + space)


def _noise(samples: Floats) -> float:
    """Return the standard deviation of a sensor's noise, from the differences of its samples: a constant offset has none."""
    differences = np.abs(np.diff(samples[np.isfinite(samples)]))
    return MAD * float(np.median(differences)) / 2.0**0.5 if len(differences) else 0.0


def _middle(samples: Sequence[Floats]) -> tuple[float, float]:
    """Return the median of all samples, twice; 0 if there are none."""
    finite = np.concatenate([values[np.isfinite(values)] for values in samples] or [np.zeros(0)])
    middle = float(np.median(finite)) if len(finite) else 0.0
    return middle, middle


def _ends(lines: Sequence[Floats]) -> tuple[float, float] | None:
    """Return the smallest and the largest of all values; None if there are none."""
    finite = drawable(np.concatenate([values[np.isfinite(values)] for values in lines] or [np.zeros(0)]))
    return (float(finite.min()), float(finite.max())) if len(finite) else None


__all__ = ["limit_axis", "limits_with_samples", "mark_cut"]
