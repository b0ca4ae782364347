"""The quality of fault detection: receiver operating characteristics, delay against false alarms, the reliability diagram."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.campaign.designs.plan import OK
from bayesftc.cosim.judging.signals import ALARM
from bayesftc.report.svg import INK, error_bars, figure, legend, words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from bayesftc.cosim.types import Floats
    from bayesftc.report.contents import Contents

RUNS = 200
"""Largest number of runs of each level, drawn at random; more would not change the figures visibly."""
LINE = 0.18
"""Height of a line of the legend in inches."""
SCORES = ("fault_probability", "beta")
"""Outputs of a controller that indicate faults, in order of preference."""


@dataclass(frozen=True)
class Level:
    """Scores and truth of some runs of a level of the compared factor."""

    score_name: str  # the signal that ranks samples
    # One array per run, of shape (steps, sensors).
    score: list[Floats]
    truth: list[Any]
    seeds: list[int]  # one per run; runs with the same seed have the same noise
    of: int  # number of runs from which these were drawn

    @property
    def is_probability(self) -> bool:
        """Whether the score is a probability."""
        return self.score_name.endswith(SCORES[0])

    def by_seed(self) -> tuple[list[Floats], list[Any]]:
        """Return scores and truth, with the runs of a seed joined: intervals count seeds, because only these are independent."""
        place: dict[int, list[int]] = {}
        for i, seed in enumerate(self.seeds):
            place.setdefault(seed, []).append(i)
        return tuple(
            [np.concatenate([all_[i] for i in runs]) for runs in place.values()] for all_ in (self.score, self.truth)
        )  # type: ignore[return-value]


def why_no_detection(contents: Contents) -> str:
    """Return a sentence if a score is recorded, but not when each fault was present; else nothing."""
    scores, active = _recorded_scores(contents), _active(contents)
    missing = [name for name in active if name not in contents.store.metadata.signals]
    if not scores or not missing:
        return ""
    one = len(missing) == 1
    named = missing[0] if one else f"{', '.join(missing[:-1])} and {missing[-1]}"
    were, them = ("was", "it") if one else ("were", "them")
    return f"There are no figures of detection, because {named} {were} not recorded. Add {them} to the recorded signals (record)."


def _recorded_scores(contents: Contents) -> list[str]:
    controller = contents.description.get("roles", {}).get("controller")
    return [name for name in (f"{controller}.{score}" for score in SCORES) if name in contents.store.metadata.signals]


def _active(contents: Contents) -> list[str]:
    chains = contents.description.get("roles", {}).get("faults_of_sensors", [])
    return [f"{name}.active" for name in sorted({name for chain in chains for name in chain})]


def read_detection(contents: Contents) -> dict[Any, Level]:
    """Return recorded scores and faults of each level for which these suffice."""
    scores, active = _recorded_scores(contents), _active(contents)
    if not active or not scores or not set(active) <= set(contents.store.metadata.signals):
        return {}
    runs = _read(contents, scores, active, contents.description["roles"]["faults_of_sensors"])
    detection = {}
    for level in contents.drawn():
        for name in scores:
            samples = [(s[name], truth, seed) for s, truth, seed in runs.get(level, ()) if s[name].shape == truth.shape]
            if _suffices(samples):
                score, truth, seeds = (list(column) for column in zip(*samples, strict=True))
                good = int((contents.runs_of(level)["status"] == OK).sum())
                detection[level] = Level(name, score, truth, seeds, good)
                break
    return detection


def _suffices(runs: list[Any]) -> bool:
    """Return whether there are faulty and healthy samples with a score, and at least two different scores."""
    finite = [np.isfinite(score) for score, _, _ in runs]
    if not any(k.any() for k in finite):
        return False
    score = np.concatenate([s[k] for (s, _, _), k in zip(runs, finite, strict=True)])
    truth = np.concatenate([t[k] for (_, t, _), k in zip(runs, finite, strict=True)])
    return bool(truth.any() and not truth.all() and np.ptp(score) > 0)


def _read(
    contents: Contents, scores: list[str], active: list[str], chains: list[list[str]]
) -> dict[Any, list[tuple[dict[str, Floats], Any, int]]]:
    chosen: dict[int, tuple[Any, int]] = {}
    rng = np.random.default_rng(0)
    for level in contents.drawn():
        rows = contents.runs_of(level)
        rows = rows[rows["status"] == OK]
        if len(rows) > RUNS:
            rows = rows.iloc[np.sort(rng.choice(len(rows), RUNS, replace=False))]
        chosen |= {int(run): (level, int(seed)) for run, seed in zip(rows["run"], rows["seed"], strict=True)}
    samples: dict[Any, list[tuple[dict[str, Floats], Any, int]]] = {}
    for piece, signals in contents.store.pieces_of_signals([*scores, *active]):
        for run in range(piece.begin, piece.end):
            if run not in chosen:
                continue
            level, seed = chosen[run]
            of_run = {name: values[run - piece.begin] for name, values in signals.items()}
            rank = {name: of_run[name].reshape(len(of_run[name]), -1).copy() for name in scores}
            columns = [
                np.any([_any(of_run[f"{name}.active"]) for name in chain], axis=0)
                if chain
                else np.zeros(len(rank[scores[0]]), bool)
                for chain in chains
            ]
            samples.setdefault(level, []).append((rank, np.stack(columns, axis=1), seed))
    return samples


def _any(flags: Floats) -> Any:
    return flags.reshape(len(flags), -1).any(axis=1)


def roc_figure(contents: Contents, detection: dict[Any, Level]) -> tuple[Figure, str]:
    """Return the curves of all levels: detected faults against false alarms, and delay against false alarms."""
    from matplotlib.ticker import NullLocator

    from bayesftc.cosim.statistics import delay_curve, roc

    made, (left, right) = figure(3.2 + LINE * len(detection), 1, 2)
    time = contents.store.time
    step = float(time[1] - time[0]) if len(time) > 1 else 1.0
    names = {each.score_name for each in detection.values()}
    least, alarms = 1.0, []
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
            false, missed, delay = (float(at[name]) for name in ("false_share", "missed_share", "median_delay"))
            right.plot(
                [false], [delay], ms=8, mfc="none", clip_on=False, zorder=5, **look
            )  # whole, also at a delay of 0
            alarms.append(
                f"{'' if level is None else f'{contents.name(level)}: '}alarms in {false:.2%} of the fault-free time, "
                f"{missed:.1%} of the faults missed, median delay {_seconds(delay)}{_blamed_most(each)}"
            )
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
            f" At a fault probability of {ALARM:g} (open mark), of all sensors together: {'; '.join(alarms)}."
            if alarms
            else ""
        )
        + _without(contents, detection)
    )


def _blamed_most(level: Level) -> str:
    """Return which of several sensors has the largest share of its fault-free time with an alarm; nothing if none has any."""
    score, healthy = np.concatenate(level.score), ~np.concatenate(level.truth) & ~np.isnan(np.concatenate(level.score))
    samples, blamed = healthy.sum(axis=0), (healthy & (score >= ALARM)).sum(axis=0)
    if score.shape[1] < 2 or not blamed.any():
        return ""
    shares = blamed / np.maximum(samples, 1)
    worst = int(shares.argmax())
    return f" (sensor {worst} is blamed most while healthy: {shares[worst]:.2%} of its fault-free time)"


def _seconds(delay: float) -> str:
    return "unknown" if delay != delay else f"{delay:.3g} s"


def _chosen(detection: dict[Any, Level]) -> str:
    used, of = (max(numbers) for numbers in zip(*((len(d.seeds), d.of) for d in detection.values()), strict=True))
    each = " of each" if len(detection) > 1 else ""
    return f"in {used} of {of} runs{each}, drawn at random" if used < of else f"in all {of} complete runs{each}"


def _without(contents: Contents, detection: dict[Any, Level]) -> str:
    missing = [str(contents.name(level)) for level in contents.drawn() if level not in detection]
    return f" Without different scores: {', '.join(missing)}." if missing and len(contents.levels()) > 1 else ""


def reliability_figure(contents: Contents, detection: dict[Any, Level]) -> tuple[Figure, str] | None:
    """Return the reliability diagram of all levels whose score is a probability; None without one."""
    from bayesftc.cosim.statistics import calibration

    with_probability = {level: each for level, each in detection.items() if each.is_probability}
    if not with_probability:
        return None
    made, (axis,) = figure(3.2 + LINE * len(with_probability))
    axis.plot([0, 1], [0, 1], color=INK, lw=0.8, ls=":")
    for level, each in with_probability.items():
        style, result = contents.drawn()[level], calibration(*each.by_seed(), equal="widths")
        p, share = result.pooled.predicted, result.pooled.observed
        bars = np.nan_to_num(np.clip([share - result.observed_low, result.observed_high - share], 0.0, None))
        name = "" if level is None else f"{words(contents.name(level), 32, 1)}: "
        label = f"{name}calibration error {result.pooled.calibration_error:.3f}"
        error_bars(axis, p, share, bars, style, label=label)
    whole = (-0.02, 1.02)
    axis.set(xlabel="fault probability", ylabel="share of samples with the fault", xlim=whole, ylim=whole)
    axis.set_aspect("equal")
    legend(axis, columns=1)
    return made, (
        f"Reliability of the fault probability, {_chosen(with_probability)}: samples in ten bins of equal width. On the dotted "
        "line the probability equals the share of samples with a fault, above it faults are more frequent. Intervals (95 %) over "
        "seeds. The calibration error is the mean distance from the line, weighted by the samples of each bin."
    )
