"""Errors over time: for each level of the compared factor the median over runs, and the band of the middle 90 %."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.report.svg import figure, legend, words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.report.contents import Contents

POINTS = 250
"""Instants at which quantiles are computed; more would not be visible."""
QUANTILES = (0.05, 0.5, 0.95)
PANELS = 4


def error_bands(contents: Contents) -> tuple[Figure, str] | None:
    """Return a figure of the absolute errors over time, or of the signals if there are no errors; and its caption."""
    errors = contents.errors()[:PANELS]
    names = contents.scalars()[:PANELS]
    if not errors and not names:
        return None
    time = contents.store.time
    stride = max(1, -(-len(time) // POINTS))
    collected = (
        [_gathered(contents, (e.signal, e.reference), e.shift, stride) for e in errors]
        if errors
        else [_gathered(contents, (name,), 0, stride) for name in names]
    )
    if all(np.isfinite(values).any(axis=0).sum() < 2 for values in collected):
        return None  # all runs stopped at the first step
    made, axes = figure(0.5 + 2.3 * len(collected), len(collected), sharex=True)
    for i, (axis, values) in enumerate(zip(axes, collected, strict=True)):
        shift = errors[i].shift if errors else 0
        at = time[shift:][::stride]
        for level, style in contents.drawn().items():
            runs = contents.runs_of(level)["run"].to_numpy()
            low, middle, high = _quantiles(values[runs])
            axis.fill_between(at, low, high, color=style.colour, alpha=0.18, lw=0)
            name = contents.name(level)
            axis.plot(at, middle, color=style.colour, ls=style.line, lw=1.5, label=name and words(name, 32, 1))
        signal = errors[i].signal if errors else names[i]
        axis.set_ylabel(
            words(f"|{signal} error|{contents.unit(signal)}" if errors else f"{signal}{contents.unit(signal)}", 26)
        )
        if errors:
            axis.set_ylim(bottom=0)
    axes[-1].set_xlabel("time (s)")
    axes[-1].set_xlim(float(time[0]), float(time[-1]))
    legend(axes[0])
    if errors:
        formulas = "; ".join(
            f"|{e.signal} − {e.reference}|" + (f" of {e.shift} step before" if e.shift else "") for e in errors
        )
        what = f"Absolute error over time ({formulas})"
    else:
        what = "Signals over time"
    of = f" of each {contents.compared}" if contents.compared else ""
    every = " Failed runs count until they stop." if contents.failed else ""
    return made, (
        f"{what}: at each of {len(time[::stride])} instants the median over all runs{of}, and the band of the middle 90 % of "
        f"them.{every}{contents.undrawn}"
    )


def _gathered(contents: Contents, names: tuple[str, ...], shift: int, stride: int) -> Floats:
    """Return the signal of each run, or its absolute difference from a reference, at every `stride`-th time."""
    rows = len(contents.store.time) - shift
    values = np.full((contents.store.plan.runs, -(-rows // stride)), np.nan)
    for piece, signals in contents.store.pieces_of_signals(names):
        signal = signals[names[0]][:, shift:][:, ::stride]
        if len(names) > 1:
            signal = np.abs(signal - signals[names[1]][:, :rows][:, ::stride])
        values[piece.begin : piece.end] = signal
    return values


def _quantiles(values: Floats) -> Any:
    """Return the quantiles over runs at each time; NaN where no run has a value."""
    ordered = np.sort(values, axis=0)  # NaN comes last
    count = np.isfinite(ordered).sum(axis=0)
    quantiles = []
    for q in QUANTILES:
        place = q * np.maximum(count - 1, 0)
        low = np.floor(place).astype(int)
        high = np.minimum(low + 1, np.maximum(count - 1, 0))
        columns = np.arange(values.shape[1])
        a, b = ordered[low, columns], ordered[high, columns]
        quantiles.append(np.where(count > 0, a + (place - low) * (b - a), np.nan))
    return quantiles
