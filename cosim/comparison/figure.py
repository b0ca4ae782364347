"""The figure of a comparison: the tracked signals of several loops in the same panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.base.units import with_unit
from bayesftc.cosim.judging.figures.limits import mark_cut
from bayesftc.cosim.judging.figures.panels import PANEL, finish, legend, make_panels
from bayesftc.cosim.judging.figures.plotting import BLUE, LINES, SENSOR_COLOURS
from bayesftc.cosim.judging.signals import LoopSignals
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, *SENSOR_COLOURS)
LOST, ROOM = 20.0, 0.3
"""A loop is lost if it goes so many times as far as the nearest one; space beside the others, as a share of their range."""

BAND = (5.0, 95.0)
"""Percentiles at the edges of the band."""


def plot_comparison(
    runs: Mapping[str, Sequence[LoopSignals]],
    names: Sequence[str],
    figure: Figure | None = None,
    failed: Mapping[str, int] | None = None,
) -> Figure:
    """Return a figure with a panel for each tracked signal.

    Parameters
    ----------
    runs : mapping of str to sequence of LoopSignals
        The complete runs of each loop.
    names : sequence of str
        The tracked signals.
    figure : Figure, optional
        An empty figure to draw on; by default a new one for a file.
    failed : mapping of str to int, optional
        The number of runs of each loop that failed, and are not drawn.
    """
    labels = {loop: _label(loop, len(of_loop), (failed or {}).get(loop, 0)) for loop, of_loop in runs.items()}
    all_runs = [run for of_loop in runs.values() for run in of_loop]
    figure, axes = make_panels([PANEL] * max(len(names), 1), figure)
    for axis, name in zip(axes, names, strict=False):
        bands: dict[str, Floats] = {}
        for i, (loop, of_loop) in enumerate(runs.items()):
            if of_loop:
                values = [_quantity(run, name).truth for run in of_loop]
                bands[loop] = _draw_loop(axis, labels[loop], values, of_loop[0].time, i)
            else:
                axis.plot([], [], LINES[i % len(LINES)], color=COLOURS[i % len(COLOURS)], lw=1.4, label=labels[loop])
        _draw_reference(axis, all_runs, name)
        _leave_out_the_lost(axis, bands, all_runs, name)
        _shade(axis, all_runs)
        legend(axis)
        if all_runs:
            axis.set_ylabel(with_unit(name, _quantity(all_runs[0], name).unit))
    finish(axes, all_runs[0].time if all_runs else np.zeros(0))
    most = max(map(len, runs.values()), default=0)
    which = "the runs that did not fail" if any((failed or {}).values()) else f"{most} runs"
    figure.suptitle(
        f"Median of {which} and band of 90 % of them; shaded: a fault is present",
        fontsize=10,
        x=0.01,
        ha="left",
    )
    return figure


def _label(loop: str, complete: int, failed: int) -> str:
    """Return the name of a loop in the legend, with the number of its runs that are drawn if some failed."""
    return f"{loop}\n({complete} of {complete + failed} runs)" if failed else loop


def _draw_loop(axis: Axes, label: str, values: Sequence[Any], time: Floats, i: int) -> Floats:
    """Draw median and band of a loop, and return lower end, median and upper end of the band."""
    lines = np.asarray(np.nanpercentile(np.array(values), [BAND[0], 50.0, BAND[1]], axis=0))
    low, middle, high = lines
    colour = COLOURS[i % len(COLOURS)]
    axis.fill_between(time, low, high, color=colour, alpha=0.2, lw=0, zorder=2)
    axis.plot(time, middle, LINES[i % len(LINES)], color=colour, lw=1.4, zorder=4, label=label)
    return lines


def _leave_out_the_lost(axis: Axes, bands: Mapping[str, Floats], runs: Sequence[LoopSignals], name: str) -> None:
    """Limit an axis to the loops that follow the reference, if another one goes so far that these would be a flat line."""
    references = [
        quantity.reference for quantity in (_quantity(run, name) for run in runs) if quantity.reference is not None
    ]
    spans = {}
    for loop, band in bands.items():
        finite = np.concatenate([band[np.isfinite(band)], *references[:1]])
        spans[loop] = float(finite.min()), float(finite.max())
    size = min((high - low for low, high in spans.values()), default=0.0)
    if not size:
        return
    lost = [loop for loop, (low, high) in spans.items() if high - low > LOST * size]
    if not lost:
        return
    low, high = (pick(span[i] for loop, span in spans.items() if loop not in lost) for i, pick in enumerate((min, max)))
    limits = low - ROOM * (high - low), high + ROOM * (high - low)
    axis.set_ylim(limits)
    mark_cut(axis, runs[0].time, [line for loop in lost for line in bands[loop]], limits, ", ".join(lost))


def _draw_reference(axis: Axes, runs: Sequence[LoopSignals], name: str) -> None:
    references = [_quantity(run, name).reference for run in runs]
    if references and references[0] is not None:
        style: dict[str, Any] = {"color": "0.6", "lw": 3.0, "zorder": 1, "label": "reference"}
        axis.plot(runs[0].time, references[0], **style)


def _shade(axis: Axes, runs: Sequence[LoopSignals]) -> None:
    """Shade times with faults, darker if more runs have one."""
    faulty = [run.faulty for run in runs]
    if not faulty or any(flags is None for flags in faulty):
        return
    share = np.mean(np.array(faulty, dtype=np.float64), axis=0)
    if share.any():
        time, limits = runs[0].time, axis.get_ylim()
        end = 2.0 * float(time[-1]) - float(time[-2])  # a row lasts until the next one
        axis.imshow(
            share[None, :],
            cmap="Greys",
            vmin=0.0,
            vmax=5.0,
            aspect="auto",
            interpolation="nearest",
            zorder=0,
            extent=(float(time[0]), end, 0.0, 1.0),
            transform=axis.get_xaxis_transform(),
        )
        axis.set_ylim(limits)


def _quantity(run: LoopSignals, name: str) -> Any:
    return next(quantity for quantity in run.quantities if quantity.name == name)


__all__ = ["plot_comparison"]
