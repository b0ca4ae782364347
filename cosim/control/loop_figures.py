"""Bode plot and root locus of a loop, drawn by python-control on figures of this package's format."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import control
import numpy as np
from scipy.optimize import brentq

from bayesftc.cosim.judging.panels import PANEL, WIDTH, make_panels
from bayesftc.cosim.judging.plotting import BLUE, SENSOR_COLOURS
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.control.margins import Margins


GAINS = np.concatenate([[0.0], np.logspace(-3.0, 3.0, 1001)])
"""First gains of the root locus, in units of the designed gain."""
DOTS, HALVINGS = 400, 12
"""Number of dots across the figure, and most halvings of a distance between two gains for it."""


def bode_figure(loop: Any, margins: Margins | None, title: str, figure: Figure) -> Figure:
    """Return gain and phase of a loop transfer function over the frequency, with its margins.

    Parameters
    ----------
    loop : control.StateSpace
        The loop transfer function.
    margins : Margins or None
        Margins of the loop; None if it is not stable.
    title : str
        Title of the figure.
    figure : Figure
        An empty figure to draw on.
    """
    _, axes = make_panels([PANEL, PANEL], figure)
    control.bode_plot(loop, ax=np.array(axes)[:, None], color=BLUE, lw=1.3)
    axes[0].axhline(1.0, color="0.5", lw=0.8)
    axes[1].axhline(-180.0, color="0.5", lw=0.8)
    if margins is None:
        texts = ["the closed loop is not stable"]
    else:
        texts = [
            f"{name} {value} (at {at:.3g} rad/s)" if np.isfinite(at) else f"no {name}: no such crossing"
            for name, value, at in (
                ("gain margin", f"{margins.gain:.3g}", margins.phase_crossover),
                ("phase margin", f"{margins.phase:.1f} degrees", margins.gain_crossover),
            )
        ]
        for axis, at in zip(axes, (margins.phase_crossover, margins.gain_crossover), strict=True):
            if np.isfinite(at) and at > 0.0:
                axis.axvline(at, color="0.5", lw=0.8, ls=":")
    axes[0].set_title(", ".join(texts), fontsize=9)
    axes[0].set_ylabel("gain")
    axes[1].set_ylabel("phase (degrees)")
    axes[1].set_xlabel("frequency (rad/s); dashed: half of the sampling frequency")
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def root_locus_figure(loop: Any, poles: Any, title: str, figure: Figure) -> Figure:
    """Return the root locus of a loop transfer function, from gain 0 to where it leaves the unit circle.

    Parameters
    ----------
    loop : control.StateSpace
        The loop transfer function.
    poles : ndarray of complex
        Poles of the closed loop.
    title : str
        Title of the figure.
    figure : Figure
        An empty figure to draw on.
    """
    _, (axis,) = make_panels([0.7 * WIDTH], figure)
    limit = limit_gain(loop)
    # With fast sampling the poles are near 1. The rest of the plane matters little.
    ends = np.zeros(0) if limit is None else roots(loop, np.array([limit]))[0]
    shown = np.concatenate([poles, loop.poles(), ends[np.abs(ends) > 1.0 - 1e-6], [1.0]])
    low, high, top = shown.real.min(), shown.real.max(), np.abs(shown.imag).max()
    pad = 0.15 * max(high - low, 2.0 * top, 0.02)
    axis.set_xlim(low - pad, high + pad)
    axis.set_ylim(-top - pad, top + pad)
    box = complex(low - pad, -top - pad), complex(high + pad, top + pad)
    found = dense_roots(loop, box).ravel()
    # Dots, because lines would cut the corners where branches meet.
    axis.plot(found.real, found.imag, ls="none", marker=".", ms=2.0, color=BLUE)
    start, zeros = loop.poles(), loop.zeros()
    axis.plot(start.real, start.imag, "x", ms=6, color=BLUE)
    axis.plot(zeros.real, zeros.imag, "o", ms=6, mfc="none", color=BLUE)
    angles = np.linspace(0.0, 2.0 * np.pi, 3601)
    (circle,) = axis.plot(np.cos(angles), np.sin(angles), color="0.5", lw=0.8, ls="--")
    (now,) = axis.plot(poles.real, poles.imag, "s", ms=6, mfc="none", color=SENSOR_COLOURS[0])
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    reached = "" if limit is None else f", reached at gain {limit:.3g}"
    axis.legend(
        [circle, now],
        [f"limit of stability{reached}", "poles at the designed gain (1.0)"],
        loc="upper left",
        fontsize=8,
        frameon=False,
    )
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def roots(loop: Any, gains: Floats) -> Any:
    """Return the poles of the closed loop for each gain, a row for each."""
    a, b, c, d = (np.asarray(matrix) for matrix in (loop.A, loop.B, loop.C, loop.D))
    return np.linalg.eigvals(a - (gains / (1.0 + gains * d[0, 0]))[:, None, None] * (b @ c))


def limit_gain(loop: Any) -> float | None:
    """Return the lowest gain above the designed one, 1, at which a stable closed loop loses its stability; None if none does."""
    gains = np.concatenate([[1.0], GAINS[GAINS > 1.0]])
    outside = np.abs(roots(loop, gains)).max(axis=1) >= 1.0
    if outside[0] or not outside.any():
        return None
    above = int(outside.argmax())
    return float(brentq(lambda gain: np.abs(roots(loop, np.array([gain]))).max() - 1.0, gains[above - 1], gains[above]))


def dense_roots(loop: Any, box: tuple[complex, complex]) -> Any:
    """Return the poles for so many gains that those in a box of the plane have small distances from gain to gain.

    Parameters
    ----------
    loop : control.StateSpace
        The loop transfer function.
    box : tuple of complex
        The lower left and the upper right corner.
    """
    low, high = box
    least = max(high.real - low.real, high.imag - low.imag) / DOTS
    gains, found = GAINS, roots(loop, GAINS)
    for _ in range(HALVINGS):
        inside = (low.real < found.real) & (found.real < high.real) & (low.imag < found.imag) & (found.imag < high.imag)
        apart = np.abs(found[:-1, :, None] - found[1:, None, :])
        far = ((apart.min(axis=2) > least) & inside[:-1]).any(axis=1)
        far |= ((apart.min(axis=1) > least) & inside[1:]).any(axis=1)
        if not far.any():
            break
        between = (gains[:-1][far] + gains[1:][far]) / 2
        places = np.flatnonzero(far) + 1
        gains, found = np.insert(gains, places, between), np.insert(found, places, roots(loop, between), axis=0)
    return found
