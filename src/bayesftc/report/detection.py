"""The quality of fault detection: receiver operating characteristics, delay against false alarms, the reliability diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.campaign.runs.truth import FAULTY
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.report.scores import FAILED, HEALTHY, Found, Level, recorded_scores
from bayesftc.report.svg import INK, error_bars, figure, legend, words
from bayesftc.report.tables import ROWS, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.report.contents import Contents

NOTE = (
    f"Alarms: a fault probability of {ALARM:g} or more. In brackets: the faults of the sensor. Within the two delays half "
    "and 90 % of all faults are found. Blamed while faulty or healthy: share of that time with an alarm. –: nothing to count."
)
LINE = 0.18
"""Height of a line of the legend in inches."""


def why_no_detection(contents: Contents, found: Found) -> str:
    """Return a sentence if a score is recorded and there is a fault, but no level can be judged; else nothing."""
    if found or not recorded_scores(contents):
        return ""
    title = "There are no figures of detection"
    if FAULTY not in contents.store.metadata.signals:
        return (
            f"{title}: this store is of an earlier version, which did not keep the true faults of the sensors. Run the campaign "
            "again in another folder."
        )
    if set(found.without.values()) <= {FAILED, HEALTHY}:
        return ""
    if len(found.without) == 1:
        return f"{title}: {next(iter(found.without.values()))}."
    return f"{title}.{_without(contents, found)}"


def roc_figure(contents: Contents, found: Found) -> tuple[Figure, str]:
    """Return the curves of all levels: detected faults against false alarms, and delay against false alarms."""
    from matplotlib.ticker import NullLocator

    from bayesftc.cosim.statistics import delay_curve, roc

    detection = found.levels
    made, (left, right) = figure(3.2 + LINE * len(detection), 1, 2)
    time = contents.store.time
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    names = {each.score_name for each in detection.values()}
    least = 1.0
    for level, each in detection.items():
        style, curve = contents.drawn()[level], roc(*each.by_seed())
        x, mean = curve.false_positive_rate, curve.true_positive_rate
        left.fill_between(x, curve.lower, curve.upper, color=style.colour, alpha=0.18, lw=0)
        sure = f" ({curve.low:.3f} to {curve.high:.3f})" if curve.low == curve.low else ""
        ranked = f" by {each.score_name}" if len(names) > 1 else ""
        name = "" if level is None else f"{words(contents.name(level), 32, 1)}{ranked}: "
        left.plot(x, mean, color=style.colour, ls=style.line, lw=1.5, label=f"{name}AUC {curve.auc:.3f}{sure}")
        delays = delay_curve(each.score, each.truth, step=step)
        share = delays["false_share"].to_numpy()
        least = min([least, *share[share > 0]])
        look: dict[str, Any] = {"color": style.colour, "ls": style.line, "marker": style.marker}
        right.plot(share, delays["median_delay"], lw=1.5, ms=2.5, **look)
        if each.is_probability:
            at = delay_curve(each.score, each.truth, step=step, thresholds=[ALARM]).iloc[0]
            mark = [float(at["false_share"])], [float(at["median_delay"])]
            right.plot(*mark, ms=8, mfc="none", clip_on=False, zorder=5, **look)  # whole, also at a delay of 0
    left.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    left.set(xlabel="false positive rate", ylabel="true positive rate", xlim=(0, 1), ylim=(0, 1.02))
    right.set_xscale("symlog", linthresh=least)
    decades = np.arange(0, np.log10(least), -1)
    right.set_xticks([0.0, *10.0 ** decades[:: max(1, len(decades) // 3)]])
    right.xaxis.set_minor_locator(NullLocator())
    right.set(xlabel="share of fault-free time with an alarm", ylabel="median detection delay (s)", xlim=(0, 1))
    right.set_ylim(bottom=0)
    legend(left, columns=1)
    seeds = (
        ", band and intervals (95 %) over seeds" if any(len(set(each.seeds)) > 1 for each in detection.values()) else ""
    )
    return made, (
        f"Detection of sensor faults by {' or '.join(sorted(names))}, {_chosen(detection)}. Left: mean of the seeds' curves, "
        f"with the AUC of all samples{seeds}; dotted: detection by chance. Right: delay of alarms over the share of "
        "fault-free time with an alarm, of all sensors together, for all thresholds; a curve ends where most faults are missed."
        + (
            f" Open mark: a fault probability of {ALARM:g}."
            if any(each.is_probability for each in detection.values())
            else ""
        )
        + _missing(detection)
        + _without(contents, found)
    )


def _missing(detection: dict[Any, Level]) -> str:
    """Return how missing samples count, if there are faults of which nothing else is seen."""
    if not any(any(each.seen_as_missing) for each in detection.values()):
        return ""
    return (
        " Missing samples count in none of these figures. A fault whose samples are all missing is seen as missing samples: it "
        "is neither detected nor missed, as in the table of runs."
    )


def alarm_table(contents: Contents, found: Found) -> Table | None:
    """Return how often and how late alarms find the faults of each sensor and of all; None without probabilities."""
    time = contents.store.time
    step, rows = float(time[1] - time[0]) if len(time) > 1 else 1.0, []
    unseen = any(any(each.seen_as_missing) for each in found.levels.values())
    for level, each in found.levels.items():
        count = each.score[0].shape[1] if each.is_probability else 0
        for i in [None, *range(count)] if count > 1 else range(count):
            of = slice(None) if i is None else slice(i, i + 1)
            score, truth = ([run[:, of] for run in runs] for runs in (each.score, each.truth))
            missing = sum(each.seen_as_missing[of])
            name = "all" if i is None else f"{i} ({', '.join(names)})" if (names := contents.faults_of(i)) else str(i)
            row = [] if contents.compared is None else [str(contents.name(level))]
            blamed = np.concatenate([run[:, of] for run in each.blamed])
            rows.append([*row, name, *_alarms(score, truth, blamed, step), *([str(missing)] if unseen else [])])
    if not rows:
        return None
    columns = ["sensor", "faults", "missed", "median delay (s)", "delay of 90 % (s)"]
    columns += ["blamed while faulty", "blamed while healthy"]
    columns += ["seen as missing samples"] * unseen
    columns = [contents.compared, *columns] if contents.compared is not None else columns
    cut = f" The first {ROWS} of {len(rows)} rows are shown." if len(rows) > ROWS else ""
    return Table("Alarms", columns, rows[:ROWS], NOTE + cut)


def _alarms(score: list[Floats], truth: list[Any], healthy: Floats, step: float) -> list[str]:
    """Return faults, the share of missed ones, two delays, and the shares of the time with a fault and without with an alarm."""
    from bayesftc.cosim.statistics import delay_curve

    valid = [np.isfinite(each) for each in score]
    if all((faulty | ~seen).all() for faulty, seen in zip(truth, valid, strict=True)):
        return ["–"] * 6  # no fault-free sample with a score, by which alarms could be judged
    at, share = delay_curve(score, truth, step=step, thresholds=[ALARM]).iloc[0], np.nanmean(healthy)
    if not at["faults"]:
        return ["0", *["–"] * 4, f"{share:.2%}"]
    delays = [
        missed if np.isnan(at[of]) else f"{at[of]:.3g}"
        for of, missed in (("median_delay", "most missed"), ("delay_90", "over 10 % missed"))
    ]
    blamed = np.concatenate(
        [(each >= ALARM)[faulty & seen] for each, faulty, seen in zip(score, truth, valid, strict=True)]
    )
    return [
        f"{at['faults']:.0f}",
        f"{at['missed_share']:.1%}",
        *delays,
        f"{blamed.mean():.1%}" if len(blamed) else "–",
        f"{share:.2%}",
    ]


def _chosen(detection: dict[Any, Level]) -> str:
    """Return which runs the figures are of. Levels may differ: another factor may have learners without a probability."""
    levels = list(detection.values())
    used, of = {len(level.seeds) for level in levels}, max(level.of for level in levels)
    each = " of each" if len(levels) > 1 else ""
    if used == {of}:
        return f"in all {of} complete runs{each}"
    some = str(max(used)) if len(used) == 1 else f"{min(used)} to {max(used)}"
    return f"in {some} of {of} complete runs{each}" + (
        ", drawn at random" if any(level.drawn for level in levels) else "; the others have no such number"
    )


def _without(contents: Contents, found: Found) -> str:
    """Return a sentence for each level without a curve."""
    return "".join(f" {contents.name(level)} has no curves: {why}." for level, why in found.without.items())


def reliability_figure(contents: Contents, found: Found) -> tuple[Figure, str] | None:
    """Return the reliability diagram of all levels whose score is a probability; None without one."""
    from bayesftc.cosim.statistics import calibration

    with_probability = {level: each for level, each in found.levels.items() if each.is_probability}
    if not with_probability:
        return None
    made, (axis,) = figure(3.2 + 2 * LINE * len(with_probability))
    axis.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    for level, each in with_probability.items():
        style, result = contents.drawn()[level], calibration(*each.by_seed(), equal="widths")
        p, share = result.pooled.predicted, result.pooled.observed
        bars = np.nan_to_num(np.clip([share - result.observed_low, result.observed_high - share], 0.0, None))
        name = "" if level is None else f"{words(contents.name(level), 32, 1)}: "
        error_bars(axis, p, share, bars, style, label=name + result.pooled.label())
    whole = (-0.02, 1.02)
    axis.set(xlabel="fault probability", ylabel="share of samples with the fault", xlim=whole, ylim=whole)
    axis.set_aspect("equal")
    legend(axis, columns=1)
    return made, (
        f"Reliability of the fault probability, {_chosen(with_probability)}: samples in ten bins of equal width. On the dotted "
        "line the probability equals the share of samples with a fault, above it faults are more frequent. Intervals (95 %) over "
        "seeds. The calibration error is the mean distance from the line, weighted by the samples of each bin; the "
        "second number is that of the bins from 0.1 to 0.9 alone."
    )
