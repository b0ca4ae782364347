"""All choices of a fit with their reasons: windows, quantiles and thresholds.

They were made with the recorded drive of ``docs/tutorials/monitor.md`` in view: a wheel that fails in braking at 31.5 s, and
a stretch of five calm seconds (`louder`, `rare`). Those for codes and for sensors that do not follow were made with simulated
flights of ten minutes at 10 Hz; of the wheels of the recorded drive, healthy and faulty, they name none. The one for turns
(`abrupt`) was made with simulated headings of a ship, 20 minutes at 1 Hz, and those for long stretches (`calm`, `enough`) with
simulated thermometers, 10 days of a sample each minute. The others were not tested on other recordings.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayesftc.cosim.base.chosen import chosen


@dataclass(frozen=True)
class FitSettings:
    """Ratios of noise, motion and errors are ratios of variances; lags are in steps."""

    # Requirements of a recording.
    fewest: int = chosen(200, "samples of each sensor: a variance is then known to a tenth")
    copied: float = chosen(
        0.95, "share of equal samples, among those that change, at which two columns count as copies"
    )
    still: float = chosen(
        0.02, "a sensor stands still if at most this share of its samples changes, while in another ..."
    )
    lively: float = chosen(0.2, "... at least this share changes; a slow sensor may be between the two")
    far: float = chosen(
        10.0, "multiple of its noise by which a sensor may differ from others that move less: biases wander"
    )
    far_quantile: float = chosen(0.9, "quantile of the level's distance from its median: the motion of the others")
    # Rounding errors.
    lasting: float = chosen(3.0, "steps from which on a rounding error is a lasting one: a shorter one is nearly white")
    # Codes of missing samples.
    code: float = chosen(0.02, "least share of a sensor's samples that have the value of a code")
    code_times: int = chosen(
        3, "least number of separate times at which it is sent: a sensor freezes once or twice at most"
    )
    code_far: float = chosen(
        5.0, "multiple of the usual distance from the others by which a code is away from them ..."
    )
    code_span: float = chosen(0.1, "... and share of the span of the quantity: a resolution or a dead zone is smaller")
    code_few: int = chosen(
        5, "least number of samples with a code that lies outside all others: no noise repeats so far away"
    )
    code_outside: float = chosen(
        5.0, "multiple of the span of all other samples by which it lies outside: -9999 for degrees, not a stuck valve"
    )
    # Sensors that do not follow the others.
    follow_parts: tuple[int, ...] = chosen(
        (8, 16, 32, 64), "parts of a recording: a slow sensor follows over long times only, a drift hides motion there"
    )
    leads: float = chosen(
        0.8, "correlation of two sensors from which they move: four times their noise, or common errors"
    )
    follows: float = chosen(0.5, "slope between that of a sensor that follows, 1, and that of one that does not, 0")
    lags: float = chosen(0.3, "slope from which a sensor follows late, if it is certain: a slow one has less than 1")
    sure: float = chosen(4.0, "standard errors of a slope, of few windows and at several lengths")
    mostly: float = chosen(0.6, "share of windows in which one of two sensors must move: more than a fault takes")
    one_motion: float = chosen(
        0.97, "correlation of two sensors that differ by a factor: one that is so slow as to move by .7 has 0.84"
    )
    another_factor: float = chosen(1.25, "factor from which a sensor has another unit or quantity: gains err by less")
    one_factor: float = chosen(1.1, "largest ratio of the factors in windows of several lengths")
    elsewhere: float = chosen(
        100.0, "distance of a sensor's place from that of the others, in their spreads: a bias is seldom as large"
    )
    followed: float = chosen(
        0.2,
        "share of a recording in which a sensor follows the others before it moves away: another quantity never does",
    )
    unlike: float = chosen(
        0.5, "share of its size by which it must differ, too: sensors may be far more precise than true"
    )
    # Windows.
    window: int = chosen(16, "lags in a window, for several independent differences")
    least_window: int = chosen(64, "least samples in a window, for a reliable median")
    fewest_windows: int = chosen(
        8, "least windows in a recording, which get shorter for it: with fewer, a fault in one would change the median"
    )
    clip: float = chosen(
        4.5, "standard deviations at which differences are clipped: one in 150,000 normal ones exceeds it"
    )
    quiet: int = chosen(
        64, "steps in which a sensor must change; if not, it does not show its noise: parked, or frozen"
    )
    parts: int = chosen(
        64,
        "number of parts in which repeats and missing samples are counted; the longest lag is one part of a recording",
    )
    least_part: int = chosen(20, "least samples in such a part: a share is then known to a tenth")
    # Motion.
    seen: float = chosen(
        4.0, "standard errors above noise at which a window counts as moving: rarely exceeded by chance"
    )
    few: float = chosen(0.02, "share of moving windows below which only all windows together can show motion")
    hidden: float = chosen(
        2.0, "standard errors of motion that noise may hide: a model without motion would follow no change"
    )
    livelier: float = chosen(0.9, "quantile of the moving windows whose motion the model has: braking is rare")
    smooth: float = chosen(
        0.7,
        "ratio of the variances of second and first differences: 2 for a random walk; below this value there is a rate",
    )
    abrupt: float = chosen(
        0.3,
        "this ratio, at the lag of the visible second differences, from which the rate may change sooner: turns had 0.38 to 1, "
        "lasting rates below 0.2",
    )
    # Noise and lasting errors.
    alike: float = chosen(
        0.75, "share of the difference from others below which two sensors have common errors, as on an axle"
    )
    tells: float = chosen(0.3, "least ratio of two sensors' common errors to their own; smaller ones are chance")
    counts: float = chosen(0.5, "least ratio of lasting errors to the white noise; smaller ones count as white noise")
    white: float = chosen(
        0.2, "least share of white noise of each sensor: the modes' offsets and noise are multiples of it"
    )
    lesser: float = chosen(
        0.1, "least share of each of two sensors in their difference: their motion hides which of them has it"
    )
    long: int = chosen(
        32, "multiple of the shortest lag up to which noise is coloured; longer errors are a wandering bias"
    )
    rounds: int = chosen(
        3,
        "times that estimates which need each other are made in turn: sensors' sizes and their common shape, a share and the "
        "parts that are usual for it",
    )
    louder: float = chosen(
        2.0, "largest ratio of the noise elsewhere to that in the stretch: calm seconds are too quiet"
    )
    calm: float = chosen(
        0.25, "least ratio of the squared motion in the stretch to that elsewhere, for errors from the stretch alone"
    )
    enough: int = chosen(1000, "least steps of such a stretch: fewer do not tell white noise from errors that last")
    # Biases.
    blocks: int = chosen(32, "parts of a recording whose typical differences are compared")
    least_block: int = chosen(16, "least steps in one part, for a reliable median")
    certain: float = chosen(4.0, "multiple of the variance due to noise at which a bias counts as wandering")
    wanders: float = chosen(0.1, "least ratio of a wandering bias to the noise; smaller ones are not visible beside it")
    usual: float = chosen(0.75, "quantile of the wandering of biases in the stretch: sensors are healthy there")
    rare: float = chosen(
        0.9, "quantile in the whole recording, up to the noise: a fault in a tenth of it has no effect"
    )
    seldom: float = chosen(
        0.84,
        "the same quantile for biases: a fault in a seventh of the recording, in up to 5 of 32 parts, has no effect",
    )
    gain_sure: float = chosen(0.9999, "confidence of a gain's sign")
    gain_alone: float = chosen(0.7, "ratio to the largest gain below which another one is due to that")
    gain_agrees: float = chosen(
        0.5, "largest relative difference of a gain in half of the recording: of a fault in one half, 1 in the other"
    )
    gain_counts: float = chosen(0.1, "least ratio of a gain's differences to the noise: 1 % of a flow had 0.2")
    # A change to the end of the recording.
    explained: float = chosen(
        0.5,
        "share of the motion of two sensors' difference that one change must explain: of errors that wander for a tenth of "
        "the recording it is at most 0.35",
    )
    clearly: float = chosen(
        0.7,
        "this share for the best of the others: 0.75 to 0.95 for faults; of recordings whose errors wander for half of it, "
        "1 in 20 reaches it",
    )
    least_before: int = chosen(4, "least parts of the recording before the change, for a reliable median")
    within: float = chosen(3.0, "standard deviations of the levels before a change within which it has not begun")
    grown: int = chosen(3, "least parts of the recording over which a change has grown: a step lies in two at most")
    # A fault in the stretch.
    doubtful: float = chosen(5.0, "multiple of its noise above which a sensor's lasting errors may be a fault")
    outstanding: float = chosen(3.0, "multiple of the others' lasting errors from which those of one sensor stand out")
    # The model file.
    uncertain: float = chosen(
        3.0,
        "standard deviations of the level that the initial belief covers, so the file fits other recordings as well",
    )


FIT = FitSettings()
"""The choices."""
