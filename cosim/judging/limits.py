"""Limits of axes that a transient at the start does not stretch, with marks where a line leaves them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHARE = 0.05
"""Share of the run, its start, in which a line may leave the axis. Later transients are what a user looks at."""
STRETCHED = 3.0
"""An axis is cut if its whole range is so many times the range without the start."""
MARGIN = 0.08
"""Space above and below the lines, as a share of their range."""


def limit_axis(axis: Axes, time: Floats, whole: Sequence[Floats], cut: Sequence[Floats]) -> None:
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
    """
    later = int(np.ceil(SHARE * len(time)))
    needed, every = _ends([*whole, *(values[later:] for values in cut)]), _ends([*whole, *cut])
    if needed is None or every is None:
        return
    (low, high), (lowest, highest) = needed, every
    if not low < high or highest - lowest < STRETCHED * (high - low):
        return
    space = MARGIN * (high - low)
    low, high = low - space, high + space
    axis.set_ylim(low, high)
    for outside, end, height, marker in (
        (np.any([values > high for values in cut], axis=0), highest, 1.0, "^"),
        (np.any([values < low for values in cut], axis=0), lowest, 0.0, "v"),
    ):
        if not outside.any():
            continue
        begins = time[outside & ~np.concatenate([[False], outside[:-1]])]
        style: dict[str, Any] = {"transform": axis.get_xaxis_transform(), "clip_on": False, "color": "0.3", "zorder": 6}
        axis.plot(begins, np.full(len(begins), height), ls="none", marker=marker, ms=4, **style)
        side = "bottom" if height == 0.0 else "top"
        axis.annotate(
            f"cut off: {'down' if height == 0.0 else 'up'} to {end:.3g}", (begins[0], height),
            xycoords=axis.get_xaxis_transform(), xytext=(6, 3 if side == "bottom" else -3), textcoords="offset points",
            fontsize=7, color="0.3", va=side,
        )  # fmt: skip


def _ends(lines: Sequence[Floats]) -> tuple[float, float] | None:
    """Return the smallest and the largest of all values; None if there are none."""
    finite = np.concatenate([values[np.isfinite(values)] for values in lines] or [np.zeros(0)])
    return (float(finite.min()), float(finite.max())) if len(finite) else None


__all__ = ["limit_axis"]
