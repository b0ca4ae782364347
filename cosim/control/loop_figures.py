"""Bode plot and root locus of a loop, drawn by python-control on figures of this package's format."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import control
import numpy as np

from bayesftc.cosim.judging.panels import PANEL, WIDTH, make_panels
from bayesftc.cosim.judging.plotting import BLUE, SENSOR_COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.control.margins import Margins


GAINS = np.concatenate([[0.0], np.logspace(-3.0, 3.0, 4001)])
"""Gains of the root locus, in units of the designed gain."""


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
    """Return the root locus of a loop transfer function near the poles at gain 0 and at the designed gain.

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
    control.root_locus_plot(loop, gains=GAINS, ax=axis, color=BLUE, legend_loc=False)
    for line in axis.lines:
        if line.get_linestyle() != "None":  # dots, because lines would cut the corners where branches meet
            line.set(linestyle="none", marker=".", markersize=2.0)
    circle = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 361))
    (limit,) = axis.plot(circle.real, circle.imag, color="0.5", lw=0.8, ls="--")
    (now,) = axis.plot(poles.real, poles.imag, "s", ms=6, mfc="none", color=SENSOR_COLOURS[0])
    # With fast sampling the poles are near 1. The rest of the plane matters little.
    shown = np.concatenate([poles, loop.poles(), [1.0]])
    low, high, top = shown.real.min(), shown.real.max(), np.abs(shown.imag).max()
    pad = 0.15 * max(high - low, 2.0 * top, 0.02)
    axis.set_xlim(low - pad, high + pad)
    axis.set_ylim(-top - pad, top + pad)
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.set_title("")
    axis.legend(
        [limit, now], ["limit of stability", "poles at the designed gain"], loc="upper left", fontsize=8, frameon=False
    )
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure
