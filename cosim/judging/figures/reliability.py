"""The reliability diagram: of the samples with a fault probability of 30 %, 30 % should be faulty."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesftc.cosim.judging.figures.plotting import BLUE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.judging.probabilities import Reliability


def plot_reliability(reliability: Reliability, figure: Figure, title: str | None = None) -> Figure:
    """Draw the reliability diagram on an empty figure and return it; the lower panel shows the number of samples in each bin.

    There are no intervals, because the samples of one run depend on each other, so that their number means little.
    """
    figure.set_size_inches(5.6, 6.4)
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    above.plot([0, 1], [0, 1], color="0.3", ls=":", lw=1.2, label="perfect calibration")
    above.plot(reliability.predicted, reliability.observed, "o-", color=BLUE, lw=1.5, ms=5, label=reliability.label())
    above.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), ylabel="share of faulty samples")
    above.legend(loc="upper left", frameon=False, fontsize=9)
    filled = reliability.samples > 0
    below.bar(reliability.predicted[filled], reliability.samples[filled], width=0.03, color=BLUE)
    below.set(yscale="log", ylim=(0.8, None), ylabel="samples", xlabel="mean fault probability of a bin")
    for axis in (above, below):
        axis.grid(True, color="0.9", lw=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=9)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    if title:
        figure.suptitle(title, fontsize=10)
    return figure


__all__ = ["plot_reliability"]
