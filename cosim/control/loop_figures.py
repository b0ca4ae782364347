"""Bode plot and root locus of a loop, drawn by python-control on figures of this package's format."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import control
import numpy as np
from matplotlib.ticker import FixedLocator, NullLocator

from bayesftc.cosim.control.margins import margins_of
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.figures.panels import PANEL, WIDTH, make_panels, plain
from bayesftc.cosim.judging.figures.plotting import BLUE, SENSOR_COLOURS
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from bayesftc.cosim.control.margins import Margins


GAINS = np.concatenate([[0.0], np.logspace(-3.0, 3.0, 1001)])
"""First gains of the root locus, in units of the designed gain."""
NEAR, LEAST = 0.5, 2
"""Largest distance of a pole or zero from 1 in the enlarged part of the root locus, and least number of poles for such a part."""
FAR = 2.0
"""A zero at this distance from the origin, or a larger one, may be outside the figure."""
STEPS, MOST_TICKS = (45.0, 90.0, 180.0, 360.0), 7
"""Distances of the ticks of a phase in degrees, and how many times such a distance the axis may have."""
MOST_LIMITS = 3
"""Largest number of lines at -180 degrees plus whole turns; if there would be more, as with a large delay, one is drawn."""
TINY = 1e-6
"""Turns by which a phase of 0 degrees may be too large by rounding."""
DOTS, HALVINGS = 400, 12
"""Number of dots across the figure, and most halvings of a distance between two gains for it."""

DECADES = 5.0
"""Most decades of frequency below the Nyquist frequency: an integrator has its pole at zero up to rounding."""


def _frequencies(loop: Any, nyquist: float) -> Any:
    """Return the usual frequencies, without those far below all that a loop of this sample time can do."""
    usual = control.frequency_response(loop).omega
    least = nyquist / 10.0**DECADES
    return np.geomspace(max(float(usual[usual > 0].min(initial=least)), least), nyquist, 1000)


def bode_figure(
    loop: Any,
    margins: Margins | None,
    title: str,
    figure: Figure,
    omega: ArrayLike | None = None,
    Hz: bool = False,
) -> Figure:
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
    omega : array_like, optional
        Frequencies in rad/s, or the lowest and the highest one.
    Hz : bool
        Whether the axis shows Hz instead of rad/s.
    """
    nyquist = np.pi / float(loop.dt)
    unit, turn = ("Hz", 2.0 * np.pi) if Hz else ("rad/s", 1.0)
    frequencies = _frequencies(loop, nyquist) if omega is None else np.asarray(omega, dtype=float)
    if (
        frequencies.ndim != 1
        or len(frequencies) < 2
        or not (np.diff(frequencies) > 0).all()
        or not 0 < frequencies[0] < frequencies[-1] <= nyquist * (1 + 1e-9)
    ):
        raise ModelError(
            f"omega is {omega!r}. Give frequencies in rad/s that grow, from more than 0 to half of the sampling frequency, "
            f"{nyquist:.6g} rad/s, or the lowest and the highest one."
        )
    if len(frequencies) == 2:
        frequencies = np.geomspace(frequencies[0], frequencies[-1], 1000)
    _, axes = make_panels([PANEL, PANEL], figure)
    with np.errstate(divide="ignore"):  # a loop without feedback has a gain of zero
        control.bode_plot(
            loop,
            frequencies,
            ax=np.array(axes)[:, None],
            dB=True,
            deg=True,
            Hz=Hz,
            grid=False,
            color=BLUE,
            lw=1.3,
        )
    low, high = frequencies[[0, -1]]
    for axis in axes:
        if omega is not None:  # else python-control draws half of the sampling frequency, however far away
            axis.set_xlim(low / turn, high / turn)
        axis.grid(visible=True, which="major", color="0.85", lw=0.6)
        axis.grid(visible=True, which="minor", axis="x", color="0.93", lw=0.4)
        axis.set_axisbelow(True)
    axes[0].axhline(0.0, color="0.5", lw=0.8)
    _shift_phase(axes[0].lines[0], axes[1], margins.gain_crossover / turn if margins else np.nan)
    dotted = ""
    if margins is None:
        texts = ["the closed loop is not stable"]
    else:
        texts = [
            f"{name} {value} (at {at / turn:.3g} {unit})" if np.isfinite(at) else f"no {name}: no such crossing"
            for name, value, at in (
                (
                    "gain margin",
                    f"{margins.gain:.3g} = {20.0 * np.log10(margins.gain):.3g} dB{', the lower limit' * (margins.gain < 1.0)}",
                    margins.phase_crossover,
                ),
                (
                    "phase margin",
                    f"{abs(margins.phase):.1f} degrees{' of lead, not of lag' * (margins.phase < 0.0)}",
                    margins.gain_crossover,
                ),
            )
        ]
        for axis, at in zip(axes, (margins.phase_crossover, margins.gain_crossover), strict=True):
            if np.isfinite(at) and low <= at <= high:
                axis.axvline(at / turn, color="0.5", lw=0.8, ls=":")
                dotted = "; dotted: where the margin is read"
    axes[0].set_title(", ".join(texts) + _stable_gains(margins), fontsize=9)
    axes[0].set_ylabel("gain (dB)")
    axes[1].set_ylabel("phase (degrees)")
    dashed = "; dashed: half of the sampling frequency" if high >= nyquist * (1 - 1e-9) else ""
    axes[1].set_xlabel(f"frequency ({unit}){dashed}{dotted}")
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def _stable_gains(margins: Margins | None) -> str:
    """Return a line on the factors of the gain for which the loop is stable; nothing if there are no limits, or no margins."""
    if margins is None or (margins.lowest_gain == 0.0 and margins.highest_gain == np.inf):
        return ""
    low, high = f"{margins.lowest_gain:.3g}", f"{margins.highest_gain:.3g}"
    if margins.lowest_gain == 0.0:
        factors = f"less than {high}"
    elif margins.highest_gain == np.inf:
        factors = f"more than {low}"
    else:
        factors = f"{low} to {high}"
    return f"\nstable while the gain is {factors} times the designed one"


def _shift_phase(gain: Any, axis: Any, at: float) -> None:
    """Shift the phase by whole turns so that it lies above -360 and up to 0 degrees at the gain crossover, and label -180.

    The phase margin is then the distance from the line at -180 degrees. Without a crossover the place counts where the gain is
    nearest to 1.
    """
    (line,) = (each for each in axis.lines if len(each.get_xdata()) == len(gain.get_xdata()))
    frequency, phase = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    known = np.isfinite(phase)
    if not np.isfinite(at):
        at = frequency[known][np.argmin(np.abs(np.asarray(gain.get_ydata())[known]))]
    turns = np.ceil(np.interp(np.log(at), np.log(frequency[known]), phase[known]) / 360.0 - TINY)
    phase = phase - 360.0 * turns
    line.set_ydata(phase)
    low, high = min(float(phase[known].min()), -180.0), max(float(phase[known].max()), -180.0)
    axis.set_ylim(low - 15.0, high + 15.0)
    step = next(
        (step for step in STEPS if high - low <= MOST_TICKS * step),
        360.0 * np.ceil((high - low) / (360.0 * MOST_TICKS)),
    )
    axis.yaxis.set_major_locator(FixedLocator(_at_180(step, low - 15.0, high + 15.0)))
    axis.yaxis.set_minor_locator(NullLocator())
    limits = _at_180(360.0, low, high)
    for limit in limits if len(limits) <= MOST_LIMITS else [-180.0]:
        axis.axhline(limit, color="0.5", lw=0.8)
        axis.annotate(
            f"{limit:.0f}\ndegrees",
            (1.0, limit),
            xycoords=("axes fraction", "data"),
            xytext=(4, 0),
            textcoords="offset points",
            ha="left",
            va="center",
            fontsize=8,
            color="0.3",
        )


def _at_180(step: float, low: float, high: float) -> list[float]:
    """Return all phases in a range that are so many steps from -180 degrees."""
    first, last = np.ceil((low + 180.0) / step), np.floor((high + 180.0) / step)
    return [float(-180.0 + step * k) for k in np.arange(first, last + 1.0)]


def root_locus_figure(loop: Any, poles: Any, title: str, figure: Figure) -> Figure:
    """Return the root locus of a loop transfer function, with the whole unit circle, from gain 0 to where it leaves the circle.

    With fast sampling most poles are near 1: a second panel then enlarges this part of the plane.

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
    limits = limit_gains(loop, poles)
    ends = roots(loop, np.array(limits)).ravel()
    start, zeros = loop.poles(), loop.zeros()
    everything = np.concatenate([poles, start, ends, zeros[np.abs(zeros) < FAR], [1.0, -1.0, 1j, -1j]])
    boxes = [_box(everything, 0.08)]
    near = [points[np.abs(points - 1.0) < NEAR] for points in (poles, start, zeros)]
    if len(near[0]) >= LEAST:
        boxes.append(_box(np.concatenate([*near, [1.0]]), 0.15))
    figure.set_size_inches(0.7 * WIDTH if len(boxes) == 1 else 1.25 * WIDTH, 0.69 * WIDTH)
    figure.set_layout_engine("constrained")
    axes = figure.subplots(1, len(boxes), squeeze=False)[0]
    angles = np.linspace(0.0, 2.0 * np.pi, 3601)
    for axis, box in zip(axes, boxes, strict=True):
        plain(axis)
        found = dense_roots(loop, box).ravel()
        # Dots, because lines would cut the corners where branches meet.
        axis.plot(found.real, found.imag, ls="none", marker=".", ms=2.0, color=BLUE)
        (first,) = axis.plot(start.real, start.imag, "x", ms=6, color=BLUE)
        (last,) = axis.plot(zeros.real, zeros.imag, "o", ms=6, mfc="none", color=BLUE)
        (circle,) = axis.plot(np.cos(angles), np.sin(angles), color="0.5", lw=0.8, ls="--")
        (now,) = axis.plot(poles.real, poles.imag, "s", ms=6, mfc="none", color=SENSOR_COLOURS[0])
        axis.set(xlim=(box[0].real, box[1].real), ylim=(box[0].imag, box[1].imag), aspect="equal")
        axis.set(xlabel="real part", ylabel="imaginary part")
    if len(boxes) > 1:
        low, high = boxes[1]
        axes[0].set_title("the unit circle; the square is enlarged on the right", fontsize=9)
        shown = sum(low.real <= p.real <= high.real and low.imag <= p.imag <= high.imag for p in poles)
        axes[1].set_title(f"enlarged: {shown} of {len(poles)} poles of the loop, near 1", fontsize=9)
        x, y = (
            (low.real, high.real, high.real, low.real, low.real),
            (low.imag, low.imag, high.imag, high.imag, low.imag),
        )
        axes[0].plot(x, y, color="0.3", lw=0.9, zorder=6)
    values = " and ".join(f"{limit:.3g}" for limit in limits)
    reached = f", reached at gain {values}" if limits else ""
    texts = {
        f"limit of stability{reached}": circle,
        "poles at the designed gain (1.0)": now,
        "poles at gain 0": first,
        "zeros: ends for a large gain": last,
    }
    figure.legend(
        [*texts.values()], [*texts], loc="outside lower left", ncols=len(boxes) * 2, fontsize=8, frameon=False
    )
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return figure


def _box(points: Any, margin: float) -> tuple[complex, complex]:
    """Return the corners of a square around points and their mirror images, with a margin as a share of its size."""
    low, high, top = points.real.min(), points.real.max(), np.abs(points.imag).max()
    half = (0.5 + margin) * max(high - low, 2.0 * top, 0.02)
    middle = 0.5 * (low + high)
    return complex(middle - half, -half), complex(middle + half, half)


def roots(loop: Any, gains: Floats) -> Any:
    """Return the poles of the closed loop for each gain, a row for each."""
    a, b, c, d = (np.asarray(matrix) for matrix in (loop.A, loop.B, loop.C, loop.D))
    return np.linalg.eigvals(a - (gains / (1.0 + gains * d[0, 0]))[:, None, None] * (b @ c))


def limit_gains(loop: Any, poles: Any) -> list[float]:
    """Return the gains below and above the designed one, 1, at which a stable closed loop loses its stability, if any."""
    if not len(poles) or np.abs(poles).max() >= 1.0:
        return []
    margins = margins_of(loop)
    return [gain for gain in (margins.lowest_gain, margins.highest_gain) if 0.0 < gain <= GAINS[-1]]


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
