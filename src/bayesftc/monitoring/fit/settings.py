"""Every choice that a fit makes, beside the reason for it: windows, quantiles, and from where on something counts.

The recorded drive of ``docs/monitor.md`` was looked at while they were made: a wheel that fails while it brakes, at 31.5 s, and a
stretch of five calm seconds (`louder`, `rare`). Other recordings have not been seen.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayesftc.cosim.base.chosen import chosen


@dataclass(frozen=True)
class FitSettings:
    """Variances are compared with variances, lags are in steps."""

    # What a recording must have.
    fewest: int = chosen(200, "samples of each sensor: a variance is then known to a tenth")
    copied: float = chosen(
        0.95, "share of equal samples, of those that change, from which on two columns are the same one"
    )
    still: float = chosen(0.02, "a sensor stands still where no more of its samples change, while of another ...")
    lively: float = chosen(0.2, "... at least this share does; between both a slow sensor may lie")
    far: float = chosen(
        10.0, "times its own noise by which a sensor may differ from others that move less: biases wander"
    )
    far_quantile: float = chosen(0.9, "of the level's distance from its median: how far the others move")
    collide: float = chosen(
        0.1, "share of samples that may fall on the step of a later one: jittering times need short steps"
    )
    # Windows.
    window: int = chosen(16, "lags in a window, so that it has several independent differences")
    least_window: int = chosen(64, "samples in it at least, so that its median is no accident")
    fewest_windows: int = chosen(
        8, "in a recording: with fewer a fault in one would move their median, so they get shorter"
    )
    clip: float = chosen(
        4.5, "standard deviations at which differences are cut: of normal ones one in 150,000 is beyond"
    )
    quiet: int = chosen(64, "steps in which a sensor must change, or it says nothing of its noise: parked, or frozen")
    parts: int = chosen(
        64, "lags reach up to this part of a recording, and it is in as many parts that repeats are counted"
    )
    least_part: int = chosen(20, "samples in which repeats are counted: a share is then known to a tenth")
    # Motion.
    seen: float = chosen(4.0, "standard errors beyond noise from which on a window moves: hardly one does by chance")
    few: float = chosen(0.02, "share of moving windows below which only all windows together can show motion")
    hidden: float = chosen(
        2.0, "standard errors of motion that may hide in noise: a model that expects none follows nothing"
    )
    livelier: float = chosen(0.9, "quantile of the moving windows whose motion the model expects: braking is rare")
    smooth: float = chosen(
        0.7,
        "second differences of a random walk have twice the variance of its first; below this share of it, it has a rate",
    )
    # Noise, and errors that last.
    alike: float = chosen(
        0.75, "share of what they differ from others by, below which two sensors share errors: an axle's do"
    )
    tells: float = chosen(0.3, "of their own errors: what two sensors share counts from here on; less is chance")
    counts: float = chosen(0.5, "of the white noise: errors that last count from here on; less is white noise as well")
    white: float = chosen(
        0.2, "share of white noise that each sensor has at least: by it modes measure offsets and noise"
    )
    lesser: float = chosen(
        0.1, "share that each of two sensors has of what they differ by: their motion hides whose it is"
    )
    long: int = chosen(32, "shortest lags up to which noise is coloured; what lasts longer is a bias that wanders")
    settled: float = chosen(4.0, "shortest lags from which on the noise of the sensors has about its full size")
    louder: float = chosen(2.0, "times the noise in the stretch that counts elsewhere: calm seconds are too quiet")
    # Biases.
    blocks: int = chosen(32, "parts of a recording whose typical differences are compared")
    least_block: int = chosen(16, "steps in one of them, so that its median is no accident")
    certain: float = chosen(4.0, "times what noise makes of it from which on a bias wanders from part to part")
    wanders: float = chosen(0.1, "of the noise: a wandering bias counts from here on; less is not seen beside it")
    usual: float = chosen(0.75, "quantile of how far biases wander in the stretch: sensors are healthy there")
    rare: float = chosen(0.9, "quantile in the whole recording, up to the noise: a fault in a tenth of it does no harm")
    # The model file.
    uncertain: float = chosen(
        3.0, "spreads within which another recording's level begins: the file serves others as well"
    )


FIT = FitSettings()
"""The choices."""
